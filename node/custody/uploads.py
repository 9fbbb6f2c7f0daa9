"""What robots brought, and whether they may bring more. Must never let a refused upload leave a byte behind.

The account is in the store: how much of each robot is staged is counted over its clips, what it brought a day is a row
that is written before the clip's. So it survives a restart, and a crash in between counts a clip too much, not too little.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from consensus.errors import BlockRobotError
from consensus.upload_quotas import DAY_MS, MIB_BYTES, UploadQuotas

USAGE_KEPT_DAYS = 8


@dataclass(frozen=True, slots=True)
class Use:
    """So many clips, of so many bytes of ciphertext and keys together."""

    count: int = 0
    size_bytes: int = 0

    def __add__(self, other: Use) -> Use:
        return Use(self.count + other.count, self.size_bytes + other.size_bytes)


@dataclass(frozen=True, slots=True)
class DayUse:
    """What a robot (33 bytes) brought on one day, counted from 1970."""

    day: int
    robot: bytes
    size_bytes: int


class UploadAccount(Protocol):
    """Where a custodian keeps the account of uploads; a part of its store."""

    async def use_by_robot(self, status: str) -> dict[bytes, Use]:
        """Return what is held of each robot's clips with this status; those fetched from custodians have no robot (b"")."""
        ...

    async def add_use(self, use: DayUse) -> None:
        """Add to what a robot brought on a day, and forget days more than `USAGE_KEPT_DAYS` before it."""
        ...

    async def day_uses(self) -> list[DayUse]:
        """Return what each robot brought on each day that is still kept, by day and robot."""
        ...


@dataclass(frozen=True, slots=True)
class UploadTerms:
    """Who uploads, and under which quotas; the chain says whose any robot's key is.

    `organisation_of` names its organisation, `handle_of` the robot itself, whatever keys it has had.
    """

    robot: bytes
    quotas: UploadQuotas
    organisation_of: Callable[[bytes], str]
    handle_of: Callable[[bytes], bytes]


def find_day(timestamp_ms: int) -> int:
    """Return the day of a block's time."""
    return timestamp_ms // DAY_MS


def _refuse(whose: str, what: str, limit: str, setting: str, retry_after_s: int) -> BlockRobotError:
    detail = f"{whose} {what} the quota of {limit} ({setting})."
    return BlockRobotError("UPLOAD_QUOTA_EXCEEDED", detail, retry_after_s=retry_after_s)


def require_quota(
    size_bytes: int,
    terms: UploadTerms,
    staged: Mapping[bytes, Use],
    days: Sequence[DayUse],
    timestamp_ms: int,
    in_flight: Mapping[bytes, Use] = MappingProxyType({}),
) -> None:
    """Refuse an upload that any quota does not allow beside those `in_flight`. Raises UPLOAD_QUOTA_EXCEEDED."""
    organisation, today = terms.organisation_of(terms.robot), find_day(timestamp_ms)
    known = sorted({*staged, *in_flight, *(use.robot for use in days)})
    robots = {robot: terms.organisation_of(robot) for robot in known if robot}
    colleagues = {terms.robot, *(robot for robot, name in robots.items() if name == organisation)}
    handle = terms.handle_of(terms.robot)
    own = {terms.robot, *(robot for robot in robots if handle and terms.handle_of(robot) == handle)}
    until_tomorrow_s = ((today + 1) * DAY_MS - timestamp_ms) // 1000 + 1
    for kind, whose, counted in (
        ("robot", "The robot's uploads", own),
        ("organisation", "The uploads of the organisation's robots", colleagues),
    ):
        coming = sum((in_flight.get(robot, Use()) for robot in counted), Use(1, size_bytes))
        held = sum((staged.get(robot, Use()) for robot in counted), coming)
        day_bytes = coming.size_bytes + sum(use.size_bytes for use in days if use.day == today and use.robot in counted)
        count_name, mib_name, day_name = (
            f"{kind}_{rest}" for rest in ("staged_max_count", "staged_max_mib", "day_max_mib")
        )
        most_count, most_mib, most_day_mib = (getattr(terms.quotas, name) for name in (count_name, mib_name, day_name))
        if held.count > most_count:
            raise _refuse(whose, "that are not recorded yet reach", f"{most_count} clips", count_name, 5)
        if held.size_bytes > most_mib * MIB_BYTES:
            raise _refuse(whose, "that are not recorded yet reach", f"{most_mib} MiB", mib_name, 5)
        if day_bytes > most_day_mib * MIB_BYTES:
            raise _refuse(whose, "of today reach", f"{most_day_mib} MiB a day", day_name, until_tomorrow_s)


async def require_quota_of(
    account: UploadAccount,
    size_bytes: int,
    terms: UploadTerms | None,
    timestamp_ms: int,
    in_flight: Mapping[bytes, Use] = MappingProxyType({}),
) -> int:
    """Return the day for which an upload counts; without `terms` nothing is asked. Raises UPLOAD_QUOTA_EXCEEDED."""
    if terms is not None:
        staged, days = await account.use_by_robot("staged"), await account.day_uses()
        require_quota(size_bytes, terms, staged, days, timestamp_ms, in_flight)
    return find_day(timestamp_ms)

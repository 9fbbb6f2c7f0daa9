"""What robots uploaded, and quotas on more.

A day's use is written before its clip, so a crash overcounts rather than undercounts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from consensus.errors import BlockRobotError
from consensus.limits import DAY_MS, MIB_BYTES
from consensus.state.settings import UploadQuotas

USAGE_KEPT_DAYS = 8


@dataclass(frozen=True, slots=True)
class Use:
    """Number of clips, and their bytes of ciphertext and keys together."""

    count: int = 0
    size_bytes: int = 0

    def __add__(self, other: Use) -> Use:
        return Use(self.count + other.count, self.size_bytes + other.size_bytes)


@dataclass(frozen=True, slots=True)
class DayUse:
    """What a robot (33 bytes) uploaded on one day since 1970."""

    day: int
    robot: bytes
    size_bytes: int


class UploadAccount(Protocol):
    """Where a custodian keeps the account of uploads; part of its store."""

    async def use_by_robot(self, status: str) -> dict[bytes, Use]:
        """Return use by robot of clips with this status; b"" for clips from custodians."""
        ...

    async def add_use(self, use: DayUse) -> None:
        """Add to a robot's day, and drop days over `USAGE_KEPT_DAYS` earlier."""
        ...

    async def day_uses(self) -> list[DayUse]: ...


@dataclass(frozen=True, slots=True)
class UploadTerms:
    """Who uploads under which quotas: `organisation_of` and `handle_of` (stable across keys)."""

    robot: bytes
    quotas: UploadQuotas
    organisation_of: Callable[[bytes], str]
    handle_of: Callable[[bytes], bytes]


def find_day(timestamp_ms: int) -> int:
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
    """Raise UPLOAD_QUOTA_EXCEEDED if a quota forbids the upload beside those `in_flight`."""
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

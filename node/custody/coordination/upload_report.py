"""A custodian's upload report: use, trend, free space; it names no people."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
import structlog
from msgspec import UNSET
from prometheus_client import CollectorRegistry, Gauge, generate_latest

from consensus.errors import BlockRobotError
from consensus.limits import MIB_BYTES
from consensus.state.settings import UploadQuotas
from node.custody.coordination.custody_answers import RobotUploads, UploadReport
from node.custody.uploads.upload_usage import USAGE_KEPT_DAYS, DayUse, UploadAccount, Use, find_day
from node.limits.disk_reserve import DiskReserve

log = structlog.get_logger(__name__)

LIMIT_CODES = frozenset(
    {
        "UPLOAD_QUOTA_EXCEEDED",
        "DISK_RESERVE_REACHED",
        "VISIT_NOT_OPEN",
        "EMPTY_FRAME_NOT_APPROVED",
        "BACKGROUND_NOT_A_PICTURE",
    }
)
"""What a robot is refused that brings too much, or what no visit asks for."""
OF_THE_CHAIN_CODES = frozenset({"VISIT_NOT_OPEN", "EMPTY_FRAME_NOT_APPROVED"})
"""A custodian that does not know all of the chain yet says so of what is well."""
LATELY_S = 600
TREND_DAYS = USAGE_KEPT_DAYS - 1
"""The trend is the mean of so many whole days before today, or of as many as there are; on the first day today's."""


ROBOTS_IN_METRICS_MAX_COUNT = 32
"""So many robots have lines of their own in the metrics, those that brought most; the others are one sum."""
OTHER_ROBOTS = "others"


class RefusedUploads:
    """Counts each robot's refused uploads, in all and recently, without logging each."""

    def __init__(
        self, clock_s: Callable[[], float] | None = None, *, has_followed: Callable[[], bool] = lambda: True
    ) -> None:
        """`clock_s`: monotonic seconds; default is the event loop's. `has_followed`: the custodian knows the chain."""
        self._clock_s = clock_s or (lambda: asyncio.get_running_loop().time())
        self._has_followed = has_followed
        self.counts: Counter[bytes] = Counter()
        self._lately: Counter[tuple[bytes, str]] = Counter()
        self._before: Counter[tuple[bytes, str]] = Counter()
        self._since_s = 0.0

    def lately(self, robot: bytes) -> dict[str, int]:
        """By code, in the last one to two `LATELY_S`."""
        self._turn()
        counts = ((code, self._lately[robot, code] + self._before[robot, code]) for code in sorted(LIMIT_CODES))
        return {code: count for code, count in counts if count}

    def _turn(self) -> None:
        passed_s = self._clock_s() - self._since_s
        if passed_s < LATELY_S:
            return
        self._before = self._lately if passed_s < 2 * LATELY_S else Counter()
        self._lately, self._since_s = Counter(), self._clock_s()

    @contextmanager
    def noted(self, robot: bytes) -> Iterator[None]:
        try:
            yield
        except BlockRobotError as error:
            if error.code in LIMIT_CODES and (error.code not in OF_THE_CHAIN_CODES or self._has_followed()):
                self._turn()
                self._lately[robot, error.code] += 1
                self.counts[robot] += 1
                if self.counts[robot].bit_count() == 1:
                    log.warning("uploads_refused", robot=robot.hex(), code=error.code, count=self.counts[robot])
            raise


def _trend(days: list[DayUse], today: int) -> int:
    past = [use for use in days if today - TREND_DAYS <= use.day < today]
    if not past:
        return sum(use.size_bytes for use in days if use.day == today)
    return sum(use.size_bytes for use in past) // (today - min(use.day for use in past))


async def describe_uploads(
    account: UploadAccount,
    timestamp_ms: int,
    quotas: UploadQuotas,
    organisation_of: Callable[[bytes], str],
    refused: RefusedUploads,
    reserve: DiskReserve | None,
    *,
    counts_held: bool,
) -> UploadReport:
    """Return uploads by organisation and robot, quotas and room.

    Confirmed clips appear only if `counts_held`: that sums over all holdings.
    """
    staged = await account.use_by_robot("staged")
    held = await account.use_by_robot("confirmed") if counts_held else {}
    days, today = await account.day_uses(), find_day(timestamp_ms)
    rows = []
    for robot in sorted({*staged, *held, *(use.robot for use in days), *refused.counts}):
        own = [use for use in days if use.robot == robot]
        waiting, kept = staged.get(robot, Use()), held.get(robot, Use())
        rows.append(
            RobotUploads(
                organisation=organisation_of(robot) if robot else "",
                robot=robot.hex(),
                staged_clips=waiting.count,
                staged_bytes=waiting.size_bytes,
                held_clips=kept.count if counts_held else UNSET,
                held_bytes=kept.size_bytes if counts_held else UNSET,
                today_bytes=sum(use.size_bytes for use in own if use.day == today),
                bytes_a_day=_trend(own, today),
                refused=refused.counts[robot],
                refused_lately=refused.lately(robot),
            )
        )
    rows.sort(key=lambda row: (row.organisation, row.robot))
    a_day = _trend(days, today)
    left_bytes = None if reserve is None else reserve.free_bytes - reserve.reserve_bytes
    return UploadReport(
        uploads=rows,
        quotas=msgspec.structs.asdict(quotas),
        bytes_a_day=a_day,
        disk_free_bytes=None if reserve is None else reserve.free_bytes,
        disk_reserve_bytes=None if reserve is None else reserve.reserve_bytes,
        uploads_paused=reserve is not None and reserve.is_reached,
        days_until_reserve=None if left_bytes is None or not a_day else max(0, round(left_bytes / a_day, 1)),
    )


def render_uploads(report: UploadReport) -> bytes:
    registry, labels = CollectorRegistry(), ("robot", "organisation")
    gauge_texts = {
        "staged_bytes": "Bytes of a robot's clips that are not recorded yet.",
        "staged_clips": "Their number.",
        "today_bytes": "Bytes that a robot uploaded on this day (UTC, by block times).",
        "refused": "Uploads that were refused to a robot since the custodian's start.",
    }
    gauges = {
        name: Gauge(f"blockrobot_uploads_{name}", text, labels, registry=registry) for name, text in gauge_texts.items()
    }
    rows = [row for row in report.uploads if row.robot]
    rows.sort(key=lambda row: (-row.today_bytes - row.staged_bytes, -row.refused, row.robot))
    for place, row in enumerate(rows):
        is_named = place < ROBOTS_IN_METRICS_MAX_COUNT
        named = (row.robot, row.organisation) if is_named else (OTHER_ROBOTS, "")
        for name, gauge in gauges.items():
            gauge.labels(*named).inc(getattr(row, name))
    bytes_of = Gauge(
        "blockrobot_upload_quota_bytes", "What may be uploaded, by setting.", ("quota",), registry=registry
    )
    count_of = Gauge("blockrobot_upload_quota_clips", "How many clips, by setting.", ("quota",), registry=registry)
    for name, value in report.quotas.items():
        if name.endswith("_mib"):
            bytes_of.labels(name).set(value * MIB_BYTES)
        else:
            count_of.labels(name).set(value)
    if report.disk_free_bytes is not None and report.disk_reserve_bytes is not None:
        free, kept = (f"blockrobot_custody_disk_{what}_bytes" for what in ("free", "reserve"))
        Gauge(free, "Free space of its disk, or of its clips'.", registry=registry).set(report.disk_free_bytes)
        Gauge(kept, "What of it is kept back.", registry=registry).set(report.disk_reserve_bytes)
    return generate_latest(registry)

"""Records by day, robot, sensor and time, by robot clock in the reader's zone."""

from __future__ import annotations

import collections
import datetime
import re
import zoneinfo
from collections.abc import Iterable, Mapping, Sequence

from clients.sdk.terminal.json_answers import Answer, Hex
from clients.wallet.answers.record_answers import VisitRightsRow
from clients.wallet.ledger.record_filter import Filter
from clients.wallet.ledger.robot_names import RobotNames, robot_label
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.page.wallet_snapshot import Snapshot, VisitPart
from clients.wallet.presentation.visit_status_text import rights_lines, rights_row
from consensus.errors import BlockRobotError
from consensus.records.metadata import NOTICE_SENSOR

_ZONE = re.compile(r"[A-Za-z0-9_+\-]{1,40}(/[A-Za-z0-9_+\-]{1,40}){0,2}", re.ASCII)
KINDS = {"depth": "depth", "rgb": "picture", "audio": "sound", "emotion": "label", NOTICE_SENSOR: "notice"}


def read_zone(name: str) -> datetime.tzinfo | None:
    """None: the machine's (also without tzdata). Raises REQUEST_INVALID."""
    if not name:
        return None
    if not _ZONE.fullmatch(name):
        raise BlockRobotError("REQUEST_INVALID", f"{name[:40]!r} is no name of a time zone.")
    try:
        return zoneinfo.ZoneInfo(name)
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
        return None


def recordings(entries: Iterable[RecordEntry]) -> list[RecordEntry]:
    """Notices of withheld frames are left out."""
    return [entry for entry in entries if entry.metadata.sensor != NOTICE_SENSOR]


def kinds_json(entries: Iterable[RecordEntry]) -> dict[str, int]:
    """Remaining items per kind (`depth`, `picture`, `sound`, `label`), descending."""
    counts: collections.Counter[str] = collections.Counter()
    for entry in recordings(entries):
        counts[kind_of(entry)] += entry.pictures_left_count
    return {kind: count for kind, count in counts.most_common() if count}


def kind_of(entry: RecordEntry) -> str:
    return KINDS.get(entry.metadata.sensor, "picture")


def select(snapshot: Snapshot, wanted: Filter) -> list[tuple[VisitPart, RecordEntry]]:
    """In time order."""
    found = [(part, entry) for part in snapshot.visits for entry in part.report.records if wanted.takes(entry)]
    return sorted(found, key=lambda pair: (pair[1].metadata.started_at_ms, pair[1].record_id))


class RecordShown(Answer, frozen=True, kw_only=True):
    """A record of a list."""

    record_id: Hex
    visit: Hex
    robot: Hex
    robot_called: str
    status: str
    sensor: str
    kind: str
    started_at_ms: int
    ended_at_ms: int
    frames: int
    erased_frames: list[int]
    index_in_visit: int
    expires_at_ms: int
    withheld: Mapping[str, int]
    restricted: bool
    denied: bool
    shared: int
    verdict: str | None
    verdict_at_ms: int | None
    height: int


def show_record(part: VisitPart, entry: RecordEntry, now_ms: int, names: RobotNames) -> RecordShown:
    meta, state = entry.metadata, entry.state
    verdict = part.verdicts.get(entry.record_id)
    return RecordShown(
        record_id=entry.record_id.hex(),
        visit=entry.visit.owner.hex(),
        robot=entry.visit.robot.hex(),
        robot_called=robot_label(entry.visit.robot, names),
        status=state.status,
        sensor=meta.sensor,
        kind=kind_of(entry),
        started_at_ms=meta.started_at_ms,
        ended_at_ms=meta.ended_at_ms,
        frames=entry.pictures_count,
        erased_frames=list(state.erased_frames),
        index_in_visit=meta.index_in_visit,
        expires_at_ms=state.expires_at_ms,
        withheld=dict(meta.withheld),
        restricted=part.report.rights.restricts(entry.record_id),
        denied=bool(part.report.rights.breach_id),
        shared=sum(share.shows(entry.record_id, now_ms) for share in part.shares),
        verdict=None if verdict is None else verdict.verdict,
        verdict_at_ms=None if verdict is None else verdict.time_ms,
        height=state.height,
    )


class RobotShown(Answer, frozen=True, kw_only=True):
    """A robot."""

    robot: Hex
    called: str


class DayShown(Answer, frozen=True, kw_only=True):
    """A day that has records."""

    day: str
    records: int
    notices: int
    pictures: int
    withheld: int
    erased: int
    unsure: int
    corrupted: int
    first_ms: int
    last_ms: int
    robots: list[Hex]
    sensors: list[str]


class VisitShown(Answer, frozen=True, kw_only=True):
    """A visit and its gaps."""

    visit: Hex
    robot: Hex
    closed: bool
    first_ms: int
    records: int
    pictures: int
    missing_records: int
    erased_records: int
    unreadable_records: int
    needs_former_words: bool
    rights: VisitRightsRow
    rights_lines: list[str]


class DaysShown(Answer, frozen=True, kw_only=True):
    """A calendar."""

    zone: str
    days: list[DayShown]
    robots: list[RobotShown]
    sensors: list[str]
    visits: list[VisitShown]


def show_days(snapshot: Snapshot, wanted: Filter, zone_name: str, language: str | None = None) -> DaysShown:
    """Newest first, with visits' problems. `language` None: current."""
    days: dict[str, list[tuple[VisitPart, RecordEntry]]] = {}
    for part, entry in select(snapshot, wanted):
        days.setdefault(wanted.began(entry).date().isoformat(), []).append((part, entry))
    everything = [entry for part in snapshot.visits for entry in part.report.records]
    return DaysShown(
        zone=zone_name,
        days=[_show_day(day, found) for day, found in sorted(days.items(), reverse=True)],
        robots=[
            RobotShown(robot=robot.hex(), called=robot_label(robot, snapshot.robot_names))
            for robot in sorted(snapshot.robots_asked)
        ],
        sensors=sorted({entry.metadata.sensor for entry in recordings(everything)}),
        visits=[show_visit(part, language) for part in snapshot.visits],
    )


def _show_day(day: str, found: Sequence[tuple[VisitPart, RecordEntry]]) -> DayShown:
    entries = [entry for _, entry in found]
    verdicts = [part.verdicts.get(entry.record_id) for part, entry in found]
    return DayShown(
        day=day,
        records=len(recordings(entries)),
        notices=len(entries) - len(recordings(entries)),
        pictures=sum(entry.pictures_left_count for entry in entries),
        withheld=withheld_count(entries),
        erased=sum(len(entry.state.erased_frames) for entry in entries),
        unsure=sum(verdict is None for verdict in verdicts),
        corrupted=sum(verdict is not None and verdict.verdict == "corrupted" for verdict in verdicts),
        first_ms=min(entry.metadata.started_at_ms for entry in entries),
        last_ms=max(entry.metadata.ended_at_ms for entry in entries),
        robots=sorted({entry.visit.robot.hex() for entry in entries}),
        sensors=sorted({entry.metadata.sensor for entry in entries}),
    )


def withheld_count(entries: Iterable[RecordEntry]) -> int:
    return sum(count for entry in entries for _, count in entry.metadata.withheld)


def show_visit(part: VisitPart, language: str | None = None) -> VisitShown:
    report = part.report
    times = [entry.metadata.started_at_ms for entry in report.records]
    return VisitShown(
        visit=report.visit.owner.hex(),
        robot=report.visit.robot.hex(),
        closed=report.closed,
        first_ms=min(times, default=report.visit.bucket_ms),
        records=len(recordings(report.records)),
        pictures=sum(entry.pictures_left_count for entry in report.records),
        missing_records=report.missing_count,
        erased_records=len(report.erased_ids),
        unreadable_records=len(report.unreadable_ids),
        needs_former_words=report.needs_former_words,
        rights=rights_row(report.rights),
        rights_lines=rights_lines(report.rights, language),
    )

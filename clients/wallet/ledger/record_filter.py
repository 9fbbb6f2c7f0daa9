"""Which records a command is about: named, or filtered by day, time, robot, sensor, visit; in pages."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass

from clients.wallet.ledger.id_prefix import RECORD, VISIT, resolve_id_prefix
from clients.wallet.ledger.visit_audit import audit_visit
from clients.wallet.ledger.visit_scan import resolve_record
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.text_catalogue import refusal
from pages.time_format import format_time, local_time

_DAY_MINUTES = 24 * 60


@dataclass(frozen=True, slots=True)
class Filter:
    """Days (ISO 8601) and minutes of a zone (None: this machine's), robots by their keys' beginnings; empty means all.

    `minutes` is half-open and may pass midnight.
    """

    days: tuple[str, str] | None = None
    minutes: tuple[int, int] | None = None
    robots: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    visit: str = ""
    from_ms: int = 0
    until_ms: int = 0
    zone: datetime.tzinfo | None = None

    @property
    def narrows(self) -> bool:
        return self != Filter(zone=self.zone)

    def began(self, entry: RecordEntry) -> datetime.datetime:
        return local_time(entry.metadata.started_at_ms, self.zone)

    def takes(self, entry: RecordEntry) -> bool:
        start_ms = entry.metadata.started_at_ms
        if (
            (self.robots and not entry.visit.robot.hex().startswith(self.robots))
            or (self.sensors and entry.metadata.sensor not in self.sensors)
            or (self.visit and entry.visit.owner.hex() != self.visit)
            or start_ms < self.from_ms
            or (self.until_ms and start_ms >= self.until_ms)
        ):
            return False
        if self.days is None and self.minutes is None:
            return True
        began, (first, end) = self.began(entry), self.minutes or (0, _DAY_MINUTES)
        if self.days is not None and not self.days[0] <= str(began.date()) <= self.days[1]:
            return False
        minute = began.hour * 60 + began.minute
        return first <= minute < end if first < end else minute >= first or minute < end


@dataclass(frozen=True, slots=True)
class Shown:
    """A visit with its overall number and shown records."""

    number: int
    report: VisitReport
    records: tuple[RecordEntry, ...]


@dataclass(frozen=True, slots=True)
class Page:
    """One page of matching records."""

    visits: tuple[Shown, ...]
    number: int
    pages_count: int
    matching_count: int
    records_count: int

    @property
    def shown_count(self) -> int:
        return sum(len(each.records) for each in self.visits)


def select(reports: Sequence[VisitReport], wanted: Filter, page: int = 1, per_page: int = 0) -> Page:
    """`per_page` 0: all; nothing beyond the last page. Visits with missing or unreadable records are always shown."""
    rows: list[tuple[int, RecordEntry | None]] = []
    for place, report in enumerate(reports):
        taken = [entry for entry in report.records if wanted.takes(entry)]
        if not taken and (not wanted.narrows or report.missing_count or report.unreadable_ids):
            rows.append((place, None))
        rows += [(place, entry) for entry in taken]
    pages_count = max(1, -(-len(rows) // per_page)) if per_page else 1
    part = rows[(page - 1) * per_page : page * per_page] if per_page else rows
    visits = tuple(
        Shown(place + 1, reports[place], tuple(entry for at, entry in part if at == place and entry is not None))
        for place in dict.fromkeys(at for at, _ in part)
    )
    matching = sum(entry is not None for _, entry in rows)
    return Page(visits, page, pages_count, matching, sum(len(report.records) for report in reports))


async def choose_records(
    opened: Wallet, record_ids: tuple[str, ...], visits: tuple[str, ...] = ()
) -> list[RecordEntry]:
    """None named: all except denied visits'. Raises RECORD_NOT_FOUND, VISIT_NOT_FOUND, NAME_TOO_SHORT, NAME_AMBIGUOUS,
    CLIP_ERASED.
    """
    reports = await opened.records()
    await refuse_erased(opened, reports, record_ids)
    entries = {entry.record_id.hex(): entry for report in reports for entry in report.records}
    if not record_ids and not visits:
        return [entry for report in reports if not report.rights.breach_id for entry in report.records]
    whole = {find_visit(reports, start).visit.owner for start in visits}
    chosen = {name: entry for name, entry in entries.items() if entry.visit.owner in whole}
    names = [resolve_record(list(entries), record_id) for record_id in record_ids]
    return list({**{name: entries[name] for name in names}, **chosen}.values())


def find_visit(reports: Sequence[VisitReport], start: str) -> VisitReport:
    """Raises VISIT_NOT_FOUND, NAME_TOO_SHORT, NAME_AMBIGUOUS."""
    return reports[resolve_id_prefix(VISIT, [report.visit.owner.hex() for report in reports], start)]


async def refuse_erased(opened: Wallet, reports: Sequence[VisitReport], record_ids: Sequence[str]) -> None:
    """Raises CLIP_ERASED, with the time, for a name that only an erased record has; NAME_AMBIGUOUS if several have it."""
    there = [entry.record_id.hex() for report in reports for entry in report.records]
    erased = {record_id.hex(): report for report in reports for record_id in report.erased_ids}
    for start in filter(None, map(str.lower, record_ids)):
        found = [name for name in erased if name.startswith(start)]
        if not found or any(known.startswith(start) for known in there):
            continue
        name = list(erased)[resolve_id_prefix(RECORD, list(erased), start)]
        trail = await audit_visit(opened, erased[name].visit)
        asked = [
            entry.time_ms
            for entry in trail
            if entry.kind == "erasure_requested" and entry.record_id == bytes.fromhex(name) and not entry.data["frames"]
        ]
        shown = max(start, name[:12], key=len)
        if asked:
            raise refusal("CLIP_ERASED", "erased_by_you", name=shown, moment=format_time(asked[0]))
        raise refusal("CLIP_ERASED", "erased_in_time", name=shown)

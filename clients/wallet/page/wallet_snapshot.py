"""Proven snapshot of a person's data, served offline; refresh reuses visits whose mark is unchanged."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from clients.wallet.consent.notice_reading import Notices, NoticeView
from clients.wallet.ledger.robot_names import RobotNames, read_robot_names
from clients.wallet.ledger.visit_audit import AuditEntry, audit_visit, findings_of
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.records.erasure import ErasureReport
from clients.wallet.records.erasure_status import ErasureProgress, describe_erasure, read_erasures
from clients.wallet.sharing.outgoing_shares import Share, SharingClient
from clients.wallet.text_catalogue import refusal

NOTICE_EVERY_MS = 30_000


@dataclass(frozen=True, slots=True)
class Verdict:
    """The owner's last finding on a record."""

    verdict: str
    time_ms: int
    height: int


@dataclass(frozen=True, slots=True)
class VisitPart:
    """A visit with all data; `mark` changes with it."""

    mark: tuple[Any, ...]
    report: VisitReport
    trail: tuple[AuditEntry, ...]
    shares: tuple[Share, ...]
    erasures: tuple[ErasureReport, ...]
    verdicts: dict[bytes, Verdict] = field(default_factory=dict)

    @property
    def corrupted_ids(self) -> list[bytes]:
        return [record_id for record_id, found in self.verdicts.items() if found.verdict == "corrupted"]

    @property
    def is_alarming(self) -> bool:
        """Anything missing, unreadable or altered."""
        return bool(self.report.missing_count or self.report.unreadable_ids or self.corrupted_ids)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Visits, oldest first, and the notice. `read_at_ms` is local time."""

    visits: tuple[VisitPart, ...] = ()
    notice: NoticeView | None = None
    notice_at_ms: int = 0
    read_at_ms: int = 0
    entries: dict[bytes, RecordEntry] = field(default_factory=dict)
    robot_names: RobotNames = field(default_factory=dict)

    def part_of(self, owner: bytes) -> VisitPart:
        """Raises NOT_FOUND."""
        for part in self.visits:
            if part.report.visit.owner == owner:
                return part
        raise refusal("NOT_FOUND", "no_visit")

    def entry(self, record_id: bytes) -> RecordEntry:
        """Raises NOT_FOUND."""
        entry = self.entries.get(record_id)
        if entry is None:
            raise refusal("NOT_FOUND", "no_record")
        return entry

    def same_as(self, other: Snapshot) -> bool:
        mine, others = ([(part.report.visit.owner, part.mark) for part in each.visits] for each in (self, other))
        return mine == others and self.notice_key == other.notice_key and self.robot_names == other.robot_names

    @property
    def robots_asked(self) -> set[bytes]:
        return {part.report.visit.robot for part in self.visits}

    @property
    def notice_key(self) -> tuple[str, int] | None:
        return None if self.notice is None else (self.notice.organisation, self.notice.version)

    def erasures(self, now_ms: int) -> list[ErasureProgress]:
        """Oldest first, with overdue custodians."""
        found = [describe_erasure(report, now_ms) for part in self.visits for report in part.erasures]
        return sorted(found, key=lambda each: each.asked_at_ms)

    def shares(self) -> list[Share]:
        found = [share for part in self.visits for share in part.shares]
        return sorted(found, key=lambda share: (share.grant.row.time, share.grant.grant_id))


async def read_snapshot(wallet: Wallet, before: Snapshot, now_ms: int, *, fresh: bool = False) -> Snapshot:
    """Read all, reusing unchanged visits unless `fresh`. Raises NOT_REGISTERED, MEMBERSHIP_ENDED, PROOF_*,
    NODE_UNREACHABLE.
    """
    known = {} if fresh else {part.report.visit.owner: part for part in before.visits}
    parts = []
    for visit in await wallet.scan():
        mark = await wallet.visit_mark(visit)
        part = known.get(visit.owner)
        if part is None or part.mark != mark or part.report.visit != visit:
            trail = tuple(await audit_visit(wallet, visit, wallet.trail_count_of(mark)))
            report = await wallet.visit_report(visit, None if part is None else part.report)
            kinds = {entry.kind for entry in trail}
            shares = await SharingClient(wallet).shares_of(visit) if "granted" in kinds else []
            erasures = await read_erasures(wallet, visit) if "erasure_requested" in kinds else []
            part = VisitPart(mark, report, trail, tuple(shares), tuple(erasures), find_verdicts(trail))
        parts.append(part)
    notice, notice_at_ms = before.notice, before.notice_at_ms
    is_member = not wallet.store.content.left and not wallet.member_gone
    if is_member and (fresh or notice is None or now_ms - notice_at_ms >= NOTICE_EVERY_MS):
        notice, notice_at_ms = await Notices(wallet).current(), now_ms
    entries = {entry.record_id: entry for part in parts for entry in part.report.records}
    robots = {part.report.visit.robot for part in parts}
    names = before.robot_names
    if fresh or not robots <= before.robots_asked:
        names = await read_robot_names(wallet, (part.report.visit for part in parts))
    return Snapshot(tuple(parts), notice, notice_at_ms, now_ms, entries, names)


def find_verdicts(trail: tuple[AuditEntry, ...]) -> dict[bytes, Verdict]:
    return {
        record_id: Verdict(verdict, entry.time_ms, entry.height)
        for entry in trail
        for record_id, verdict, _ in findings_of(entry)
    }

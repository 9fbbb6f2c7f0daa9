"""What was shared with this user, with later changes (Art. 19), and problems of their own visits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clients.wallet.ledger.visit_audit import AuditEntry, Finding, audit_visit, findings_of
from clients.wallet.ledger.wallet import VisitReport, Wallet
from clients.wallet.sharing.incoming_shares import (
    IncomingShare,
    IncomingShares,
    UnreadableGrant,
)
from clients.wallet.store.keystore import ReceivedGrant
from consensus.errors import BlockRobotError


@dataclass(frozen=True, slots=True)
class Inbox:
    """Grants received, and problems of own visits. `looks` (others' access) and `changed` (records found altered) are
    oldest first; `unread` grants have errors.
    """

    shares: tuple[IncomingShare, ...]
    alarms: tuple[VisitReport, ...]
    reads_new: bool
    faded: tuple[ReceivedGrant, ...] = ()
    looks: tuple[AuditEntry, ...] = ()
    changed: tuple[tuple[AuditEntry, Finding], ...] = ()
    unread: tuple[UnreadableGrant, ...] = ()


async def read_inbox(opened: Wallet) -> Inbox:
    """Raises NOT_REGISTERED; former members still see known grants."""
    receiving = IncomingShares(opened)
    shares = await receiving.inbox()
    try:
        reports = await opened.records()
    except BlockRobotError as error:
        if error.code != "MEMBERSHIP_ENDED":
            raise
        reports = []
    alarms = tuple(each for each in reports if each.missing_count or each.unreadable_ids)
    events = [entry for report in reports for entry in await audit_visit(opened, report.visit)]
    events.sort(key=lambda entry: (entry.height, entry.index))
    return Inbox(
        tuple(shares),
        alarms,
        receiving.reads_new,
        tuple(receiving.faded),
        tuple(entry for entry in events if entry.kind == "access_requested" and "grant" in entry.data),
        tuple((entry, finding) for entry in events for finding in findings_of(entry) if finding[1] == "corrupted"),
        tuple(receiving.unread),
    )


def copies_left(share: IncomingShare, records: Sequence[bytes]) -> list[Path]:
    """Return local folders still holding pictures of these records."""
    places = [Path(copy.folder) / copy.record_id.hex() for copy in share.received.copies if copy.record_id in records]
    return [place for place in places if place.exists()]

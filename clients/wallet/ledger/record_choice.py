"""Which records a command is about."""

from __future__ import annotations

from clients.wallet.ledger.visit_scan import resolve_record
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.presentation.linking_notice import print_linking_notice


async def choose_records(opened: Wallet, record_ids: tuple[str, ...]) -> list[RecordEntry]:
    """Return named records, or all except denied visits'. Raises NOT_FOUND."""
    reports = await opened.records()
    reports = [report for report in reports if record_ids or not report.standing.breach_id]
    entries = {entry.record_id.hex(): entry for report in reports for entry in report.records}
    if not record_ids:
        return list(entries.values())
    return [entries[resolve_record(list(entries), record_id)] for record_id in record_ids]


def warn_of_linked_visits(entries: list[RecordEntry], *, as_json: bool) -> list[RecordEntry]:
    """Warn that acting on several visits links them; return the records."""
    if not as_json:
        print_linking_notice(len({entry.visit.owner for entry in entries}))
    return entries

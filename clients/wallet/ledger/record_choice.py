"""Which records a command is about."""

from __future__ import annotations

from clients.wallet.ledger.visit_scan import find_record
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.present.linking_notice import tell_linked


async def choose_records(opened: Wallet, record_ids: tuple[str, ...]) -> list[RecordEntry]:
    """Return named records, or all except denied visits'. Raises NOT_FOUND."""
    reports = await opened.records()
    reports = [report for report in reports if record_ids or not report.standing.breach_id]
    entries = {entry.record_id.hex(): entry for report in reports for entry in report.records}
    if not record_ids:
        return list(entries.values())
    return [entries[find_record(list(entries), record_id)] for record_id in record_ids]


def tell_visits_linked(entries: list[RecordEntry], *, as_json: bool) -> list[RecordEntry]:
    """Warn that acting on several visits links them; return the records."""
    if not as_json:
        tell_linked(len({entry.visit.owner for entry in entries}))
    return entries

"""Checkers: custodians keep what the chain says, and nothing that it calls erased."""

from __future__ import annotations

from network.sim.history import ClipTaken, CustodyAudit, History, NodeRestored, NodeStarted, Violation

NOTHING_KEPT_RECORDS_COUNT = 9
"""So many records without a single clip are no accident: then the run has tried nothing of custody."""


def check_chain_equals_store(history: History) -> list[Violation]:
    """A store equals the chain at its checkpoint, never ahead.

    At the end it has every clip that a robot gave it or another honest custodian has.
    """
    found: list[Violation] = []
    for item in history.observations:
        if item.node in history.byzantine:
            continue
        if isinstance(item, NodeStarted) and item.custody_height > item.height:
            text = f"the store followed block {item.custody_height}, and the ledger ends at {item.height}"
            found.append(Violation("chain_equals_store", item.at_ms, item.node, text))
        elif isinstance(item, CustodyAudit):
            found += [Violation("chain_equals_store", item.at_ms, item.node, text) for text in _differences(item)]
    audits = [audit for audit in history.of(CustodyAudit) if audit.node not in history.byzantine]
    return found + _not_fetched(audits) + _not_kept(history, audits)


def _not_fetched(audits: list[CustodyAudit]) -> list[Violation]:
    return [
        Violation(
            "chain_equals_store",
            audit.at_ms,
            audit.node,
            f"the clip of record {record_id.hex()[:8]} is missing, and node {other.node} has it",
        )
        for audit in audits
        for other in audits
        if other.checkpoint == audit.checkpoint
        for record_id in sorted(set(audit.missing) & set(other.confirmed))
    ]


def _not_kept(history: History, audits: list[CustodyAudit]) -> list[Violation]:
    taken: dict[int, set[bytes]] = {}
    for item in history.observations:
        if isinstance(item, ClipTaken):
            taken.setdefault(item.node, set()).add(item.record_id)
        elif isinstance(item, NodeRestored):
            taken.pop(item.node, None)
    found = []
    for audit in audits:
        due = (taken.get(audit.node, set()) & set(audit.chain_recorded)) - {*audit.chain_erased, *audit.confirmed}
        found += [
            Violation(
                "chain_equals_store",
                audit.at_ms,
                audit.node,
                f"the clip of record {record_id.hex()[:8]} was taken from its robot, and is not kept",
            )
            for record_id in sorted(due)
        ]
    records = max((len(audit.chain_recorded) for audit in audits), default=0)
    if records >= NOTHING_KEPT_RECORDS_COUNT and not history.of(ClipTaken):
        text = f"{records} records are on the chain, and no custodian was given the clip of any"
        found.append(Violation("chain_equals_store", audits[0].at_ms, -1, text))
    return found


def _differences(audit: CustodyAudit) -> list[str]:
    found: list[str] = []
    if audit.checkpoint >= 0 and audit.checkpoint_id != audit.chain_id_at:
        found.append(f"the checkpoint {audit.checkpoint} names another block than the chain")
    known, recorded = {*audit.confirmed, *audit.missing, *audit.erased}, set(audit.chain_recorded)
    found += [
        f"record {record_id.hex()[:8]} is kept, and the chain does not know it"
        for record_id in sorted({*audit.confirmed, *audit.missing} - recorded)
    ]
    found += [
        f"record {record_id.hex()[:8]} is on the chain, and the store does not know it"
        for record_id in sorted(recorded - known - set(audit.chain_erased))
    ]
    found += [
        f"access request {access_id.hex()[:8]} is on one side only"
        for access_id in sorted(set(audit.granted) ^ set(audit.chain_granted))
    ]
    return found


def check_erased_means_erased(history: History) -> list[Violation]:
    """No custodian can open erased or expired records."""
    found: list[Violation] = []
    for audit in history.of(CustodyAudit):
        if audit.node in history.byzantine:
            continue
        for record_id in sorted({*audit.confirmed, *audit.missing} & set(audit.chain_erased)):
            text = f"record {record_id.hex()[:8]} is erased on the chain, and still kept"
            found.append(Violation("erased_means_erased", audit.at_ms, audit.node, text))
        if audit.keys_left:
            text = f"{audit.keys_left} keys of erased frames still open them"
            found.append(Violation("erased_means_erased", audit.at_ms, audit.node, text))
    return found

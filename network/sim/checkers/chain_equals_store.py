"""A custodian's store says what the chain says up to its checkpoint, no more and no less, and never runs ahead of it."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import CustodyAudit, History, NodeStarted


def check_chain_equals_store(history: History) -> list[Violation]:
    """Check the checkpoint at every start, and the content in the final audit."""
    found: list[Violation] = []
    for item in history.observations:
        if item.node in history.byzantine:
            continue
        if isinstance(item, NodeStarted) and item.custody_height > item.height:
            text = f"the store followed block {item.custody_height}, and the ledger ends at {item.height}"
            found.append(Violation("chain_equals_store", item.at_ms, item.node, text))
        elif isinstance(item, CustodyAudit):
            found += [Violation("chain_equals_store", item.at_ms, item.node, text) for text in _differences(item)]
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

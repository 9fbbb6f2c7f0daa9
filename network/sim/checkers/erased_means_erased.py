"""Checker: no custodian can open erased or expired records."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import CustodyAudit, History


def check_erased_means_erased(history: History) -> list[Violation]:
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

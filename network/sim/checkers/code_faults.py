"""No exception goes uncaught, no frames without end, no honest core halts, no start is refused without good reason."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import CodeFault, History, NodeRefusedStart

EXPECTED_REFUSALS = frozenset({"JOURNAL_UNWRITABLE", "JOURNAL_OUTDATED"})
"""A full disk, and a journal put back from a backup: such a node must not take part, and says so."""


def check_code_faults(history: History) -> list[Violation]:
    """Return each fault that the stage noted, and each start that an honest node refused unexpectedly."""
    found = [Violation("code_faults", fault.at_ms, fault.node, fault.text) for fault in history.of(CodeFault)]
    found += [
        Violation("code_faults", refused.at_ms, refused.node, f"refused to start: {refused.code}")
        for refused in history.of(NodeRefusedStart)
        if refused.node not in history.byzantine and refused.code not in EXPECTED_REFUSALS
    ]
    return found

"""Checker: no uncaught exceptions, endless frames, halted honest cores, unjustified start refusals."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import CodeFault, History, NodeRefusedStart

EXPECTED_REFUSALS = frozenset({"JOURNAL_UNWRITABLE", "JOURNAL_OUTDATED"})
"""A full disk, and a journal put back from a backup: such a node must not take part, and says so."""


def check_code_faults(history: History) -> list[Violation]:
    found = [Violation("code_faults", fault.at_ms, fault.node, fault.text) for fault in history.of(CodeFault)]
    found += [
        Violation("code_faults", refused.at_ms, refused.node, f"refused to start: {refused.code}")
        for refused in history.of(NodeRefusedStart)
        if refused.node not in history.byzantine and refused.code not in EXPECTED_REFUSALS
    ]
    return found

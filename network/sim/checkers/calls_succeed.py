"""Checker: clients' legitimate calls succeed, or fail only as permitted."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, History


def check_calls_succeed(history: History) -> list[Violation]:
    return [
        Violation("calls_succeed", told.at_ms, told.node, f"call {told.txid.hex()[:8]} failed with {told.code}")
        for told in history.of(Acknowledged)
        if told.node not in history.byzantine and not told.ok and told.code not in told.excused
    ]

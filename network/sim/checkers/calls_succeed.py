"""Checker: clients' legitimate calls succeed, or fail only as permitted."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, History


def check_calls_succeed(history: History) -> list[Violation]:
    return [
        Violation("calls_succeed", answer.at_ms, answer.node, f"call {answer.txid.hex()[:8]} failed with {answer.code}")
        for answer in history.of(Acknowledged)
        if answer.node not in history.byzantine and not answer.ok and answer.code not in answer.excused
    ]

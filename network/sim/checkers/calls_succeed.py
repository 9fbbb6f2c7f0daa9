"""What clients ask for is theirs to ask for: it succeeds, or fails as it may."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, History


def check_calls_succeed(history: History) -> list[Violation]:
    """Look at what clients were told of their calls, by honest nodes."""
    return [
        Violation("calls_succeed", told.at_ms, told.node, f"call {told.txid.hex()[:8]} failed with {told.code}")
        for told in history.of(Acknowledged)
        if told.node not in history.byzantine and not told.ok and told.code not in told.excused
    ]

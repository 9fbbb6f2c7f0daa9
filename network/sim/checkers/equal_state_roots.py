"""Checker: equal states at equal heights, and equal client reads."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import BlockFinalized, ExecutionDiffered, History, NodeStarted, ValueRead


def check_equal_state_roots(history: History) -> list[Violation]:
    roots: dict[int, bytes] = {}
    values: dict[tuple[bytes, bytes], bytes] = {}
    found = [Violation("equal_state_roots", item.at_ms, item.node, item.text) for item in history.of(ExecutionDiffered)]
    for item in history.observations:
        if item.node in history.byzantine or not isinstance(item, BlockFinalized | NodeStarted | ValueRead):
            continue
        if roots.setdefault(item.height, item.state_root) != item.state_root:
            text = f"another state root after block {item.height}"
            found.append(Violation("equal_state_roots", item.at_ms, item.node, text))
        if isinstance(item, ValueRead):
            place = (item.state_root, item.key)
            if values.setdefault(place, item.digest) != item.digest:
                text = f"another value under {item.key!r} after block {item.height}"
                found.append(Violation("equal_state_roots", item.at_ms, item.node, text))
    return found

"""No two blocks are final at one height, in anybody's eyes, ever. Must never ask which of two was right."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, BlockFinalized, History, NodeStarted


def check_agreement(history: History) -> list[Violation]:
    """Compare every block that a node called final, held at a start, or told a client about, by height."""
    final: dict[int, bytes] = {}
    found: list[Violation] = []
    for item in history.observations:
        if isinstance(item, BlockFinalized | NodeStarted | Acknowledged) and item.node not in history.byzantine:
            known = final.setdefault(item.height, item.block_id)
            if known != item.block_id:
                text = f"two blocks are final at height {item.height}: {known.hex()[:8]} and {item.block_id.hex()[:8]}"
                found.append(Violation("agreement", item.at_ms, item.node, text))
    return found

"""No two blocks are final at one height, and no epoch has two schedules, in anybody's eyes, ever."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, BlockFinalized, EpochBegan, History, NodeStarted


def check_agreement(history: History) -> list[Violation]:
    """Compare every block that a node called final, held at a start, or told a client about, by height.

    And every epoch that a node was in, by number: where it begins, and with which producers.
    """
    epochs: dict[int, tuple[bytes, tuple[bytes, ...]]] = {}
    final: dict[int, bytes] = {}
    found: list[Violation] = []
    for item in history.observations:
        if isinstance(item, BlockFinalized | NodeStarted | Acknowledged) and item.node not in history.byzantine:
            known = final.setdefault(item.height, item.block_id)
            if known != item.block_id:
                text = f"two blocks are final at height {item.height}: {known.hex()[:8]} and {item.block_id.hex()[:8]}"
                found.append(Violation("agreement", item.at_ms, item.node, text))
        elif isinstance(item, EpochBegan) and item.node not in history.byzantine:
            beginning = (item.boundary, item.producers)
            if epochs.setdefault(item.epoch, beginning) != beginning:
                text = f"epoch {item.epoch} begins at another block or has other producers"
                found.append(Violation("agreement", item.at_ms, item.node, text))
    return found

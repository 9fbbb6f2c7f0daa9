"""Checker: one final block per height and one schedule per epoch, everywhere."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, BlockFinalized, EpochBegan, History, NodeStarted


def check_agreement(history: History) -> list[Violation]:
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

"""Once all is healed and at most f nodes are faulty, new blocks become final within a stated number of rounds."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import BlockFinalized, Ended, Healed, History

ROUNDS_PER_FAULTY = 3
ROUNDS_AT_LEAST = 12


def rounds_allowed(faulty: int) -> int:
    """Return within how many rounds after healing every honest node stores a new final block."""
    return ROUNDS_AT_LEAST + ROUNDS_PER_FAULTY * faulty


def check_liveness(history: History) -> list[Violation]:
    """Look for each honest node's first new block after the healing, and for the end that all of them reach."""
    found: list[Violation] = []
    for healed in history.of(Healed):
        allowed = rounds_allowed(len(history.byzantine))
        first = _first_after(history, healed)
        for node in healed.honest:
            block = first.get(node)
            if block is None:
                found.append(Violation("liveness", healed.at_ms, node, "nothing became final after all was healed"))
            elif block.epoch == healed.epoch and block.round > healed.round + allowed:
                text = f"the first new block after round {healed.round} is of round {block.round}, not within {allowed}"
                found.append(Violation("liveness", block.at_ms, node, text))
    for ended in history.of(Ended):
        if not ended.settled:
            text = f"not all was answered and stored everywhere in the end: heights {ended.heights}"
            found.append(Violation("liveness", ended.at_ms, -1, text))
    return found


def _first_after(history: History, healed: Healed) -> dict[int, BlockFinalized]:
    first: dict[int, BlockFinalized] = {}
    for block in history.of(BlockFinalized):
        if block.at_ms >= healed.at_ms and block.stored and block.height > healed.height:
            first.setdefault(block.node, block)
    return first

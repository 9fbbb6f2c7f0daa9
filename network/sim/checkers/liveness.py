"""Checker: after healing, with at most f faulty, blocks finalize within bounded rounds."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import BlockFinalized, Ended, Healed, History, TimeoutSent, VoteSent

ROUNDS_PER_FAULTY = 3
ROUNDS_AT_LEAST = 12


def rounds_allowed(faulty: int) -> int:
    """Return the rounds after healing for every honest node to store a new final block."""
    return ROUNDS_AT_LEAST + ROUNDS_PER_FAULTY * faulty


def check_liveness(history: History) -> list[Violation]:
    found: list[Violation] = []
    for healed in history.of(Healed):
        allowed = rounds_allowed(len(history.byzantine))
        first = _first_after(history, healed)
        for node in healed.honest:
            block = first.get(node)
            if block is None:
                found.append(Violation("liveness", healed.at_ms, node, "nothing became final after all was healed"))
            elif (taken := _rounds_between(history, healed, block)) > allowed:
                text = f"the first new block after round {healed.round} took {taken} rounds, not {allowed} at most"
                found.append(Violation("liveness", block.at_ms, node, text))
    for ended in history.of(Ended):
        if not ended.settled:
            text = f"not all was answered and stored everywhere in the end: heights {ended.heights}"
            found.append(Violation("liveness", ended.at_ms, -1, text))
        if not ended.reached:
            text = f"the rounds that were asked for were not played in time: rounds {ended.rounds}"
            found.append(Violation("liveness", ended.at_ms, -1, text))
    return found


def _rounds_between(history: History, healed: Healed, block: BlockFinalized) -> int:
    if block.epoch <= healed.epoch:
        return block.round - healed.round
    last = {healed.epoch: healed.round, block.epoch: block.round}
    for observation in history.observations:
        if observation.at_ms > block.at_ms:
            break
        if not isinstance(observation, VoteSent | TimeoutSent) or observation.node in history.byzantine:
            continue
        if healed.epoch <= observation.epoch < block.epoch:
            last[observation.epoch] = max(last.get(observation.epoch, 0), observation.round)
    return sum(last.values()) - healed.round


def _first_after(history: History, healed: Healed) -> dict[int, BlockFinalized]:
    first: dict[int, BlockFinalized] = {}
    for block in history.of(BlockFinalized):
        if block.at_ms >= healed.at_ms and block.stored and block.height > healed.height:
            first.setdefault(block.node, block)
    return first

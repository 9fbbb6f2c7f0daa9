"""Checker: an honest node votes once per round, never after its timeout.

A node restored from a backup may repeat a timeout differently: a certificate counts one per producer, and no rule
depends on which (R40).
"""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import History, NodeRestored, TimeoutSent, VoteSent


def check_no_double_vote(history: History) -> list[Violation]:
    votes: dict[tuple[int, int, int], bytes] = {}
    timeouts: dict[tuple[int, int, int], int] = {}
    restored: set[int] = set()
    found: list[Violation] = []
    for item in history.observations:
        if isinstance(item, NodeRestored):
            restored.add(item.node)
        elif isinstance(item, VoteSent) and item.node not in history.byzantine:
            place = (item.node, item.epoch, item.round)
            if place not in votes and place in timeouts:
                text = f"voted in round {item.round} after giving it up"
                found.append(Violation("no_double_vote", item.at_ms, item.node, text))
            if votes.setdefault(place, item.block_id) != item.block_id:
                text = f"voted for two blocks in round {item.round} of epoch {item.epoch}"
                found.append(Violation("no_double_vote", item.at_ms, item.node, text))
        elif isinstance(item, TimeoutSent) and item.node not in history.byzantine:
            place = (item.node, item.epoch, item.round)
            is_other = timeouts.setdefault(place, item.high_qc_round) != item.high_qc_round
            if is_other and item.node not in restored:
                text = f"gave up round {item.round} with two different words"
                found.append(Violation("no_double_vote", item.at_ms, item.node, text))
    return found

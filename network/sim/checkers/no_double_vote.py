"""An honest node votes once in a round, over all its lives, and casts no vote in a round that it gave up."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import History, TimeoutSent, VoteSent


def check_no_double_vote(history: History) -> list[Violation]:
    """Compare all votes and timeouts that left a node, by epoch and round. The same vote may be sent again."""
    votes: dict[tuple[int, int, int], bytes] = {}
    timeouts: dict[tuple[int, int, int], int] = {}
    found: list[Violation] = []
    for item in history.observations:
        if isinstance(item, VoteSent) and item.node not in history.byzantine:
            place = (item.node, item.epoch, item.round)
            if place not in votes and place in timeouts:
                text = f"voted in round {item.round} after giving it up"
                found.append(Violation("no_double_vote", item.at_ms, item.node, text))
            if votes.setdefault(place, item.block_id) != item.block_id:
                text = f"voted for two blocks in round {item.round} of epoch {item.epoch}"
                found.append(Violation("no_double_vote", item.at_ms, item.node, text))
        elif isinstance(item, TimeoutSent) and item.node not in history.byzantine:
            place = (item.node, item.epoch, item.round)
            if timeouts.setdefault(place, item.high_qc_round) != item.high_qc_round:
                text = f"gave up round {item.round} with two different words"
                found.append(Violation("no_double_vote", item.at_ms, item.node, text))
    return found

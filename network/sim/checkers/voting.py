"""Checkers: an honest node never contradicts itself, over all its lives."""

from __future__ import annotations

from network.sim.history import History, NodeRestored, ProposalSent, TimeoutSent, Violation, VoteSent


def check_no_double_vote(history: History) -> list[Violation]:
    """One vote per round, never after its timeout.

    A node restored from a backup may repeat a timeout differently: a certificate counts one per producer, and no rule
    depends on which (R40).
    """
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


def check_no_double_proposal(history: History) -> list[Violation]:
    """One proposed block per round."""
    proposals: dict[tuple[int, int, int], bytes] = {}
    found: list[Violation] = []
    for item in history.of(ProposalSent):
        if item.node in history.byzantine:
            continue
        known = proposals.setdefault((item.node, item.epoch, item.round), item.block_id)
        if known != item.block_id:
            text = f"proposed two blocks in round {item.round} of epoch {item.epoch}"
            found.append(Violation("no_double_proposal", item.at_ms, item.node, text))
    return found


def check_only_forward(history: History) -> list[Violation]:
    """New messages never return to earlier rounds (R13)."""
    seen: set[tuple[str, int, int, int]] = set()
    last: dict[tuple[int, int], int] = {}
    found: list[Violation] = []
    for item in history.observations:
        if not isinstance(item, VoteSent | TimeoutSent | ProposalSent) or item.node in history.byzantine:
            continue
        word = (type(item).__name__, item.node, item.epoch, item.round)
        if word in seen:
            continue
        seen.add(word)
        before = last.get((item.node, item.epoch), 0)
        if item.round < before:
            text = f"spoke of round {item.round} of epoch {item.epoch} anew, after a word of round {before}"
            found.append(Violation("only_forward", item.at_ms, item.node, text))
        last[item.node, item.epoch] = max(before, item.round)
    return found

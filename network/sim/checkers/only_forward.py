"""Checker: an honest node's new messages never return to earlier rounds (R13)."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import History, ProposalSent, TimeoutSent, VoteSent


def check_only_forward(history: History) -> list[Violation]:
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

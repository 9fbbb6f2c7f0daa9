"""Checker: an honest node proposes one block per round, over all its lives."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import History, ProposalSent


def check_no_double_proposal(history: History) -> list[Violation]:
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

"""Invariants of every history: each checker is a function from history to violations.

`CHECKERS` names them. A checker knows only the history, not the tested code's intent.
"""

from __future__ import annotations

from collections.abc import Callable

from network.sim.checkers.agreement import check_agreement, check_equal_state_roots
from network.sim.checkers.calls import check_calls_succeed, check_durability, check_exactly_once
from network.sim.checkers.custody import (
    check_chain_equals_store,
    check_copies,
    check_erased_means_erased,
    check_erasures_confirmed,
)
from network.sim.checkers.liveness import check_code_faults, check_finality_under_flood, check_liveness
from network.sim.checkers.voting import check_no_double_proposal, check_no_double_vote, check_only_forward
from network.sim.history import History, Violation

Checker = Callable[[History], list[Violation]]

CHECKERS: dict[str, Checker] = {
    "agreement": check_agreement,
    "durability": check_durability,
    "no_double_vote": check_no_double_vote,
    "no_double_proposal": check_no_double_proposal,
    "only_forward": check_only_forward,
    "equal_state_roots": check_equal_state_roots,
    "exactly_once": check_exactly_once,
    "calls_succeed": check_calls_succeed,
    "chain_equals_store": check_chain_equals_store,
    "erased_means_erased": check_erased_means_erased,
    "copies": check_copies,
    "erasures_confirmed": check_erasures_confirmed,
    "liveness": check_liveness,
    "finality_under_flood": check_finality_under_flood,
    "code_faults": check_code_faults,
}

__all__ = ["CHECKERS", "Checker", "Violation"]

"""Invariants of every history: each checker is a function from history to violations.

`CHECKERS` names them. A checker knows only the history, not the tested code's intent.
"""

from __future__ import annotations

from collections.abc import Callable

from network.sim.checkers.agreement import check_agreement
from network.sim.checkers.calls_succeed import check_calls_succeed
from network.sim.checkers.chain_equals_store import check_chain_equals_store
from network.sim.checkers.code_faults import check_code_faults
from network.sim.checkers.durability import check_durability
from network.sim.checkers.equal_state_roots import check_equal_state_roots
from network.sim.checkers.erased_means_erased import check_erased_means_erased
from network.sim.checkers.exactly_once import check_exactly_once
from network.sim.checkers.finality_under_flood import check_finality_under_flood
from network.sim.checkers.liveness import check_liveness
from network.sim.checkers.no_double_proposal import check_no_double_proposal
from network.sim.checkers.no_double_vote import check_no_double_vote
from network.sim.checkers.only_forward import check_only_forward
from network.sim.checkers.violation import Violation
from network.sim.history import History

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
    "liveness": check_liveness,
    "finality_under_flood": check_finality_under_flood,
    "code_faults": check_code_faults,
}

__all__ = ["CHECKERS", "Checker", "Violation"]

"""Mutants of what a node does before it computes: cheap checks first, and no source for long."""

from __future__ import annotations

import contextlib

import pytest

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from node.mempool import transaction_intake
from node.mempool.mempool import Mempool
from tests.sim.mutants.mutant import Mutant
from tests.sim.mutants.schedules import EXPIRED_FLOOD

EVERYTHING_US = 10**9
LOOK_US = 20


def check_signatures_first(patch: pytest.MonkeyPatch) -> None:
    """Signatures are checked before anything else, also of what is long over, all of a source at once, and for a look's
    price."""
    require_timely = Mempool._require_timely

    def require(self: Mempool, transaction: Transaction, now_ms: int) -> None:
        with contextlib.suppress(BlockRobotError):
            transaction.verify_sender()
        require_timely(self, transaction, now_ms)

    patch.setattr(Mempool, "_require_timely", require)
    patch.setattr(transaction_intake, "SLICE_MAX_US", EVERYTHING_US)
    patch.setattr(transaction_intake, "TRANSACTION_SCREENING_US", LOOK_US)


FLOODING = (
    Mutant(
        "check signatures first",
        "cheap first",
        check_signatures_first,
        EXPIRED_FLOOD,
        frozenset({"finality_under_flood"}),
    ),
)

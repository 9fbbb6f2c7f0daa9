"""A journal that was put back from a backup, beside a ledger that knows better."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from node.journal_age import require_newest_journal
from tests.unit.node.hand_made_chain import make_chain, make_genesis, prove

GENESIS = make_genesis()
CHAIN = make_chain(GENESIS, 8)
PROOF = prove(GENESIS, CHAIN, 6)
"""Block 6 and its child of round 7, each certified by producers 0, 1 and 2; producer 3 proposed the child."""


@pytest.mark.parametrize("index", [0, 1, 2, 3])
def test_a_journal_that_ends_below_ones_own_signature_is_refused(index: int) -> None:
    assert CHAIN[7].header.producer == 3
    with pytest.raises(BlockRobotError, match=r"JOURNAL_OUTDATED.*round 7.*round 6"):
        require_newest_journal(PROOF, index, 6)


@pytest.mark.parametrize("index", [0, 1, 2, 3])
def test_a_journal_that_knows_all_that_was_signed_is_taken(index: int) -> None:
    for last_voted_round in (7, 8, 1_000):
        require_newest_journal(PROOF, index, last_voted_round)


def test_who_signed_nothing_may_have_an_empty_journal() -> None:
    require_newest_journal(prove(GENESIS, CHAIN, 4), 3, 0)
    require_newest_journal(PROOF, None, 0)

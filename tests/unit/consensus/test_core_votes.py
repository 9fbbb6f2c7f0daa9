"""R4, R5: what a producer votes for."""

from __future__ import annotations

import pytest

from consensus.chain.epoch_settings import ChainSettings
from consensus.chain.messages import Proposal, Vote
from consensus.limits import UNFINALIZED_BLOCKS_MAX_COUNT
from consensus.protocol.effects import Broadcast, ExecuteBlock, Persist
from consensus.protocol.events import BlockExecuted, ProposalReceived
from tests.unit.consensus.one_core import GENESIS, NOW_MS, TRANSACTION, OneCore, of_type, said


def test_a_valid_proposal_is_executed_journalled_and_then_voted_for():
    node = OneCore()
    block = node.block(1, transactions=(TRANSACTION,))
    first = node.handle(ProposalReceived(proposal=Proposal(block=block), sender=1, now_ms=NOW_MS))
    assert [effect.block for effect in of_type(first, ExecuteBlock)] == [block]
    assert said(first, Vote) == []
    second = node.handle(BlockExecuted(block_id=block.block_id, valid=True, now_ms=NOW_MS))
    assert isinstance(second[0], Persist)
    assert second[1] == Broadcast(node.vote(3, block))
    assert node.core.last_voted_round == 1


def test_a_block_that_does_not_execute_gets_no_vote_nor_does_one_after_an_unforeseen_fault():
    node = OneCore()
    assert said(node.receive(node.block(1), valid=False), Vote) == []
    assert node.core.last_voted_round == 0
    node = OneCore()
    block = node.block(1)
    node.handle(ProposalReceived(proposal=Proposal(block=block), sender=1, now_ms=NOW_MS))
    effects = node.handle(BlockExecuted(block_id=block.block_id, valid=True, now_ms=NOW_MS, fault=True))
    assert said(effects, Vote) == []
    assert node.core.halted == ""


def test_of_two_proposals_of_one_round_only_the_first_gets_a_vote_even_if_the_second_is_certified():
    node = OneCore()
    first, second = node.block(1), node.block(1, transactions=(TRANSACTION,))
    assert len(said(node.receive(first), Vote)) == 1
    assert said(node.receive(second), Vote) == []
    node = OneCore()
    first, second = node.block(1), node.block(1, transactions=(TRANSACTION,))
    node.receive(first)
    node.notice(node.qc(second, (0, 1, 2)))
    assert said(node.receive(second), Vote) == []


def test_no_vote_after_a_timeout_of_the_round_whenever_it_came():
    """A TC of the round would say that this producer helped no block of it: the schedule that chaos does not find."""
    node = OneCore()
    node.work()
    node.fire("round")
    assert node.core.last_voted_round == 1
    assert said(node.receive(node.block(1)), Vote) == []
    node = OneCore()
    block = node.block(1)
    node.handle(ProposalReceived(proposal=Proposal(block=block), sender=1, now_ms=NOW_MS))
    node.fire("round")
    assert said(node.handle(BlockExecuted(block_id=block.block_id, valid=True, now_ms=NOW_MS)), Vote) == []
    node = OneCore()
    node.work()
    node.fire("round")
    assert said(node.restarted().receive(node.block(1)), Vote) == []
    node = OneCore()
    late = node.block(1)
    node.notice(node.qc(GENESIS), node.tc(1))
    assert node.core.round == 2
    assert said(node.receive(late), Vote) == []


def test_a_block_after_a_lost_round_needs_the_tc_of_that_very_round():
    node = OneCore()
    assert said(node.receive(node.block(2)), Vote) == []
    assert said(node.receive(node.block(2, tc=node.tc(1))), Vote) == [node.vote(3, node.block(2, tc=node.tc(1)))]
    node = OneCore()
    assert said(node.receive(node.block(4, tc=node.tc(2))), Vote) == []
    node.notice(node.core.high_qc, node.tc(3))
    assert node.core.round == 4
    assert said(node.receive(node.block(4, tc=node.tc(2), timestamp_ms=NOW_MS)), Vote) == []
    assert len(said(node.receive(node.block(4, tc=node.tc(3))), Vote)) == 1


def test_a_block_gets_a_vote_only_on_the_highest_qc_named_in_its_tc():
    """R5: one signer of the TC knew the QC of round 1; a block on genesis would leave it behind."""
    node = OneCore(0)
    one = node.block(1)
    node.receive(one)
    node.notice(node.qc(one))
    forgetful = node.block(3, tc=node.tc(2, 0, 0, 1))
    assert said(node.receive(forgetful), Vote) == []
    faithful = node.block(3, one, tc=node.tc(2, 0, 0, 1))
    assert said(node.receive(faithful), Vote) == [node.vote(0, faithful)]
    node = OneCore(0)
    node.receive(one)
    three = node.block(3, one, tc=node.tc(2, 0, 1, 1))
    assert said(node.receive(three), Vote) == [node.vote(0, three)]


@pytest.mark.parametrize(("ahead_ms", "votes"), [(5_000, 1), (5_001, 0)])
def test_a_timestamp_too_far_ahead_gets_no_vote(ahead_ms, votes):
    node = OneCore()
    assert len(said(node.receive(node.block(1, timestamp_ms=NOW_MS + ahead_ms)), Vote)) == votes


def test_a_block_from_a_fast_clock_is_followed_once_it_is_certified():
    node = OneCore()
    one = node.block(1, timestamp_ms=NOW_MS + 60_000)
    node.receive(one)
    node.now_ms += 60_000
    two = node.block(2, one)
    assert said(node.receive(two), Vote) == [node.vote(3, two)]


def test_above_64_unfinalized_blocks_only_an_empty_one_gets_a_vote():
    """Every second round is lost, so no two certified blocks are of consecutive rounds and nothing becomes final."""
    node = OneCore(settings=ChainSettings(blocks_per_turn=256))
    full = UNFINALIZED_BLOCKS_MAX_COUNT
    blocks = node.chain(*range(1, 2 * full, 2))
    for block in blocks:
        node.receive(block)
    assert node.core.finalized.height == 0
    tc = node.tc(2 * full, blocks[-1].header.round)
    assert said(node.receive(node.block(2 * full + 1, blocks[-1], tc=tc, transactions=(TRANSACTION,))), Vote) == []
    node.notice(node.qc(blocks[-1]), node.tc(2 * full + 1, blocks[-1].header.round))
    tc = node.tc(2 * full + 1, blocks[-1].header.round)
    assert len(said(node.receive(node.block(2 * full + 2, blocks[-1], tc=tc)), Vote)) == 1


def test_a_follower_never_votes():
    node = OneCore(None)
    effects = node.receive(node.block(1))
    assert of_type(effects, ExecuteBlock)
    assert said(effects, Vote) == []

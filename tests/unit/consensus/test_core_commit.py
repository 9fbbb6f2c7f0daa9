"""R8: what is final."""

from __future__ import annotations

from consensus.chain.light_client import verify_finality
from consensus.chain.messages import Proposal
from consensus.protocol.effects import BlockCertified, BuildBlock, CommitBlocks, FetchBlocks, Halt
from consensus.protocol.events import BlockExecuted, BlocksFetched, ProposalReceived
from tests.sim.named_chain import CHAIN_ID
from tests.unit.consensus.one_core import GENESIS, TRANSACTION, OneCore, committed, of_type


def test_a_block_is_final_by_a_child_of_the_next_round_and_by_none_of_a_later_one():
    node = OneCore()
    one, two = node.chain(1, 2)
    node.receive(one)
    assert committed(node.receive(two)) == []
    assert committed(node.vote_from(0, two)) == []
    assert committed(node.vote_from(1, two)) == [one]
    assert node.core.finalized_id == one.block_id
    # The schedule that chaos does not find: rounds 1 and 3 are certified, but another branch may live in round 2.
    node = OneCore()
    one, three = node.chain(1, 3)
    node.receive(one)
    node.receive(three)
    assert committed(node.notice(node.qc(three))) == []
    assert node.core.finalized.height == 0


def test_the_commit_comes_with_a_proof_that_a_light_client_accepts():
    node = OneCore()
    one, two = node.chain(1, 2)
    node.receive(one)
    node.receive(two)
    commit = of_type(node.notice(node.qc(two)), CommitBlocks)[0]
    assert verify_finality(commit.proof, node.schedule, CHAIN_ID, GENESIS.block_id) == one.header


def test_a_conflicting_branch_may_still_win_after_a_certified_pair_with_a_gap():
    """Rounds 1 and 3 are certified on one branch; rounds 4 and 5 grow from round 2 and become final. Who had committed
    round 1 at round 3 would now hold a block that is not on the final chain.
    """
    node = OneCore()
    one = node.block(1)
    two = node.block(2, tc=node.tc(1))
    three = node.block(3, one, tc=node.tc(2, 1))
    for block in (one, two, three):
        node.receive(block)
    assert committed(node.notice(node.qc(three))) == []
    four = node.block(4, two, tc=node.tc(3, 2))
    five = node.block(5, four)
    node.receive(four)
    node.receive(five)
    assert committed(node.notice(node.qc(five))) == [two, four]
    assert node.core.halted == ""


def test_ancestors_across_a_gap_become_final_with_a_consecutive_pair_also_of_late_blocks():
    node = OneCore()
    one, three, four = node.chain(1, 3, 4)
    for block in (one, three, four):
        node.receive(block)
    assert committed(node.notice(node.qc(four))) == [one, three]
    # R8: every consecutive pair of the branch counts, not only the one at its end.
    node = OneCore()
    one, two, four = node.chain(1, 2, 4)
    node.notice(node.qc(four))
    node.receive(four)
    node.receive(two)
    assert committed(node.receive(one)) == [one]


def test_a_pair_is_found_when_its_block_arrives_after_the_certificates():
    node = OneCore()
    one, two, three = node.chain(1, 2, 3)
    node.receive(one)
    node.notice(node.qc(two))
    node.notice(node.qc(three))
    assert node.core.finalized.height == 0
    assert committed(node.receive(two)) == [one]
    assert committed(node.receive(three)) == [two]


def test_a_block_is_final_only_once_it_was_executed_here():
    node = OneCore()
    one, two = node.chain(1, 2)

    for block in (one, two):
        node.handle(ProposalReceived(proposal=Proposal(block=block), sender=1, now_ms=node.now_ms))
    assert committed(node.notice(node.qc(two))) == []
    assert committed(node.handle(BlockExecuted(block_id=one.block_id, valid=True, now_ms=node.now_ms))) == [one]


def test_each_certified_block_is_reported_once():
    node = OneCore()
    one = node.block(1)
    node.receive(one)
    effects = node.notice(node.qc(one)) + node.notice(node.qc(one, (1, 2, 3))) + node.vote_from(0, one)
    assert of_type(effects, BlockCertified) == [BlockCertified(block_id=one.block_id)]


def test_a_lost_branch_is_dropped_when_the_other_is_final():
    node = OneCore()
    lost = node.block(1, transactions=(TRANSACTION,))
    two = node.block(2, tc=node.tc(1))
    three = node.block(3, two)
    for block in (lost, two, three):
        node.receive(block)
    node.notice(node.qc(three))
    assert node.core.finalized_id == two.block_id
    assert node.core.block(lost.block_id) is None
    assert node.core.certified_branch() == [three.block_id]


def test_a_single_producer_finalizes_alone():
    node = OneCore(0, count=1)

    node.now_ms += 10
    order = of_type(node.work(), BuildBlock)[0]
    child = of_type(node.built(order, (TRANSACTION,)), BuildBlock)[0]
    final = committed(node.built(child))
    assert [block.transactions for block in final] == [(TRANSACTION,)]


def test_two_contradicting_final_blocks_halt_the_node():
    """More than f producers lie: every vote here is genuine, yet two branches are certified in consecutive rounds."""
    node = OneCore()
    one, two = node.chain(1, 2)
    other = node.block(3, tc=node.tc(2, 0))
    end = node.block(4, other)
    for block in (one, two, other, end):
        node.receive(block)
    assert committed(node.notice(node.qc(two))) == [one]
    fetch = of_type(node.notice(node.qc(end)), FetchBlocks)[0]
    assert fetch.block_id == end.block_id
    effects = node.handle(BlocksFetched(blocks=(other, end), now_ms=node.now_ms))
    assert node.core.halted != ""
    assert of_type(effects, Halt)
    assert node.receive(node.block(5, end)) == []

"""R21 to R24, R27: boundaries, closing blocks, the end of an epoch and the beginning of the next."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.block import certificate_of, genesis_certificate
from consensus.chain.epoch_settings import ChainSettings
from consensus.chain.light_client import verify_finality
from consensus.chain.messages import CertificateNotice, Timeout, Vote
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.protocol.core import Core
from consensus.protocol.effects import BuildBlock, CancelTimer, CommitBlocks, ExecuteBlock, Halt, Persist, SetTimer
from consensus.protocol.events import BlocksFetched, FinalizedElsewhere, PeerConnected, TimeoutReceived, VoteReceived
from tests.sim.named_chain import CHAIN_ID
from tests.unit.consensus.one_core import GENESIS, TRANSACTION, OneCore, Peers, committed, of_type, said, told


def closed(node: OneCore):
    """Bring a node to the end of its epoch: a boundary, a closing block, both certified."""
    boundary = node.boundary(1)
    closing = node.closing(2, boundary)
    node.receive(boundary)
    node.receive(closing)
    return boundary, closing, node.notice(node.qc(closing))


def test_a_boundary_is_final_by_a_certified_closing_block_which_is_dropped():
    node = OneCore()
    boundary, _, effects = closed(node)
    commit = of_type(effects, CommitBlocks)[0]
    assert commit.blocks == (boundary,)
    assert commit.proof.through == ()
    assert verify_finality(commit.proof, node.schedule, CHAIN_ID, GENESIS.block_id) == boundary.header
    assert certificate_of(commit.proof) == node.qc(boundary)
    assert node.core.finalized_id == boundary.block_id
    assert node.core.has_ended


def test_a_boundary_over_a_lost_round_is_proven_through_closing_blocks():
    node = OneCore()
    boundary = node.boundary(1)
    three = node.closing(3, boundary, tc=node.tc(2, 1))
    four = node.closing(4, three)
    for block in (boundary, three, four):
        assert committed(node.receive(block)) == []
    commit = of_type(node.notice(node.qc(four)), CommitBlocks)[0]
    assert commit.blocks == (boundary,)
    assert commit.proof.through == (three.header_bytes,)
    assert verify_finality(commit.proof, node.schedule, CHAIN_ID, GENESIS.block_id) == boundary.header
    assert certificate_of(commit.proof) == node.qc(boundary)


def test_the_shortest_proof_is_taken_when_several_pairs_are_certified_at_once():
    node = OneCore()
    boundary = node.boundary(1)
    closing = [node.closing(2, boundary)]
    for number in (3, 4, 5):
        closing.append(node.closing(number, closing[-1]))
    node.notice(node.qc(closing[-1]))
    effects = node.executed(node.handle(BlocksFetched(blocks=(boundary, *closing), now_ms=node.now_ms)))
    commits = of_type(effects, CommitBlocks)
    assert [commit.blocks for commit in commits] == [(boundary,)]
    assert commits[0].proof.through == ()
    assert commits[0].proof.child_header_bytes == closing[0].header_bytes


def test_blocks_before_the_boundary_are_final_with_it_and_a_commit_below_does_not_end_the_epoch():
    node = OneCore()
    one = node.block(1)
    boundary = node.boundary(2, one)
    node.receive(one)
    node.receive(boundary)
    assert committed(node.notice(node.qc(boundary))) == [one]
    assert not node.core.has_ended
    assert node.core.is_busy
    node = OneCore()
    one = node.block(1)
    boundary = node.block(3, one, tc=node.tc(2, 1), next_schedule_hash=sha256(b"next"))
    four = node.closing(4, boundary)
    for block in (one, boundary, four):
        node.receive(block)
    assert committed(node.notice(node.qc(four))) == [one, boundary]


def test_a_certified_boundary_can_be_abandoned_for_another_branch():
    """The quorum that gave round 2 up did not know the boundary's certificate; what it may extend is genesis."""
    node = OneCore(2)
    boundary = node.boundary(1)
    node.receive(boundary)
    node.notice(node.qc(boundary))
    other = node.block(3, GENESIS, tc=node.tc(2, 0), transactions=(TRANSACTION,))
    after = node.block(4, other)
    assert said(node.receive(other), Vote)
    node.receive(after)
    assert committed(node.notice(node.qc(after))) == [other]
    assert not node.core.has_ended
    assert not node.core.halted
    assert of_type(node.receive(node.block(5, after)), ExecuteBlock)


def test_other_certified_branches_between_boundary_and_commit_break_no_promise():
    """A block certified after the boundary but before the certified pair was given up, not contradicted (R18)."""
    node = OneCore()
    boundary = node.boundary(1)
    other = node.block(3, GENESIS, tc=node.tc(2, 0))
    five = node.closing(5, boundary, tc=node.tc(4, 1))
    six = node.closing(6, five)
    node.receive(boundary)
    node.receive(other)
    node.notice(node.qc(other))
    for block in (five, six):
        node.receive(block)
    assert committed(node.notice(node.qc(six))) == [boundary]
    node.receive(other)
    assert node.core.halted == ""


# What may stand on a boundary


@pytest.mark.parametrize(
    "changes",
    [
        {"is_closing": False},
        {"state_root": sha256(b"another state")},
        {"next_schedule_hash": sha256(b"again"), "is_closing": False},
    ],
    ids=str,
)
def test_nothing_but_closing_blocks_with_the_same_state_follow_a_boundary(changes):
    node = OneCore()
    boundary = node.boundary(1)
    node.receive(boundary)
    effects = node.receive(node.closing(2, boundary, **changes))
    assert of_type(effects, ExecuteBlock) == []
    assert said(effects, Vote) == []


def test_nothing_but_closing_blocks_follow_a_closing_block():
    node = OneCore()
    boundary = node.boundary(1)
    two = node.closing(2, boundary)
    node.receive(boundary)
    node.receive(two)
    assert said(node.receive(node.block(3, two)), Vote) == []
    assert node.core.round == 3


def test_only_a_boundary_is_followed_by_closing_blocks():
    node = OneCore()
    assert said(node.receive(node.closing(1, GENESIS)), Vote) == []
    node = OneCore(2)
    one = node.block(1, transactions=(TRANSACTION,))
    node.receive(one)
    order = of_type(node.notice(node.qc(one)), BuildBlock)[0]
    assert not order.closing
    node, boundary, *_ = next_node()
    assert said(node.receive(node.closing(1, boundary)), Vote) == []


def test_a_block_or_quorum_beside_the_boundary_halts_the_node():
    node = OneCore()
    boundary = node.boundary(1)
    node.receive(boundary)
    ignoring = node.block(2, boundary)
    node.receive(ignoring)
    assert of_type(node.notice(node.qc(ignoring)), Halt)
    # R18 across epochs: the boundary is final, whatever the new producers certify.
    node, boundary, _, two, _ = next_node()
    beside = node.block(1, two, qc=node.root_qc, parent_id=boundary.block_id, height=3)
    node.notice(node.qc(beside))
    assert of_type(node.receive(beside), Halt)


def test_a_leader_closes_after_a_certified_boundary_at_once():
    node = OneCore(2)
    boundary = node.boundary(1)
    node.receive(boundary)
    order = of_type(node.notice(node.qc(boundary)), BuildBlock)[0]
    assert order.closing
    assert order.empty
    block = node.built(order)
    assert [vote.round for vote in said(block, Vote)] == [2]


# After the end


def test_after_the_end_nothing_is_signed():
    node = OneCore(0)
    boundary, closing, _ = closed(node)
    three = node.closing(3, closing)
    effects = node.receive(three)
    effects += node.notice(node.qc(three))
    for peer in (0, 1):
        effects += node.timeout_from(peer, 4, node.qc(three))
    effects += node.fire("round") + node.fire("resend") + node.work()
    assert said(effects, Vote) == []
    assert said(effects, Timeout) == []
    assert of_type(effects, Persist) == []
    assert committed(effects) == []
    assert of_type(effects, SetTimer) == []
    assert node.core.finalized_id == boundary.block_id


def test_at_the_end_all_timers_stop():
    node = OneCore()
    effects = closed(node)[2]
    assert {effect.kind for effect in of_type(effects, CancelTimer)} >= {
        "round",
        "resend",
        "heartbeat",
        "propose",
        "fetch",
        "ask",
    }


def test_after_the_end_a_laggard_is_still_answered_and_served():
    node = OneCore()
    boundary, closing, _ = closed(node)
    notice = told(node.timeout_from(1, 2, node.qc(boundary)), 1, CertificateNotice)[0]
    assert notice.qc == node.qc(closing)
    assert told(node.handle(PeerConnected(index=0, now_ms=node.now_ms)), 0, CertificateNotice)
    assert node.core.branch(closing.block_id, 0) == [boundary, closing]


def test_a_boundary_that_sync_installed_ends_the_epoch_too():
    node = OneCore()
    boundary = node.boundary(1)
    node.handle(FinalizedElsewhere(head=boundary, qc=node.qc(boundary), now_ms=node.now_ms))
    assert node.core.has_ended
    assert said(node.receive(node.closing(2, boundary)), Vote) == []


# The next epoch


def next_node(index: int | None = 3, **options):
    """A core of epoch 1, which began on a boundary of height 3 and round 7."""
    before = Peers()
    one, two = before.chain(1, 2)
    boundary = before.block(7, two, tc=before.tc(6, 2), transactions=(TRANSACTION,), next_schedule_hash=sha256(b"next"))
    return OneCore(index, epoch=1, root=boundary, **options), boundary, before, two, one


def test_the_next_epoch_begins_at_round_one_and_takes_no_block_of_the_epoch_before():
    node, boundary, *_ = next_node(1)
    assert (node.core.epoch, node.core.round, node.core.leader) == (1, 1, 1)
    assert not node.core.has_ended
    order = of_type(node.work(), BuildBlock)[0]
    assert (order.epoch, order.round, order.height, order.closing) == (1, 1, 4, False)
    assert order.parent_id == boundary.block_id
    assert order.qc == genesis_certificate(boundary.block_id, 1)
    node, _, before, *_ = next_node()
    one = node.block(1)
    signature = before.block(1).signature
    assert node.receive(msgspec.structs.replace(one, signature=signature)) == []
    # R9: the boundary's own round, 7, means nothing here: two rounds were lost, not minus five.
    node, *_ = next_node(2)
    node.work()
    effects = node.notice(node.root_qc, node.tc(2, 0))
    assert [timer.delay_ms for timer in of_type(effects, SetTimer) if timer.kind == "round"] == [4 * 500]


def test_blocks_of_the_next_epoch_are_voted_for_and_final():
    node, boundary, *_ = next_node()
    one = node.block(1)
    two = node.block(2, one)
    assert one.header.height == boundary.header.height + 1
    assert [vote.epoch for vote in said(node.receive(one), Vote)] == [1]
    node.receive(two)
    effects = node.notice(node.qc(two))
    assert committed(effects) == [one]
    proof = of_type(effects, CommitBlocks)[0].proof
    assert verify_finality(proof, node.schedule, CHAIN_ID, boundary.block_id) == one.header


def test_words_of_the_epoch_before_do_not_count():
    node, boundary, before, two, _ = next_node()
    closing = before.closing(8, boundary)
    votes = [before.vote(index, closing) for index in range(4)]
    timeouts = [before.timeout(index, 8, before.qc(boundary)) for index in range(4)]
    effects = []
    for vote in votes:
        effects += node.handle(VoteReceived(vote=vote, now_ms=node.now_ms))
    for index, timeout in enumerate(timeouts):
        effects += node.handle(TimeoutReceived(timeout=timeout, sender=index, now_ms=node.now_ms))
    effects += node.receive(closing)
    effects += node.notice(before.qc(closing))
    effects += node.notice(before.qc(two), before.tc(8, 7))
    assert effects == []
    assert node.core.round == 1


def test_words_of_the_epoch_before_cannot_be_dressed_up():
    node, _, before, *_ = next_node()
    one = node.block(1)
    node.receive(one)
    effects = []
    for index in range(3):
        vote = msgspec.structs.replace(before.vote(index, one), epoch=1)
        effects += node.handle(VoteReceived(vote=vote, now_ms=node.now_ms))
        timeout = msgspec.structs.replace(before.timeout(index, 1), epoch=1, qc=node.root_qc)
        effects += node.handle(TimeoutReceived(timeout=timeout, sender=index, now_ms=node.now_ms))
    assert effects == []
    qc = node.qc(one)
    old_votes = msgspec.structs.replace(before.qc(one), epoch=1)
    assert node.notice(old_votes) == []
    assert node.notice(qc) != []


def test_the_next_epoch_keeps_its_words_over_a_restart_and_none_of_the_journal_before():
    old = OneCore()
    old.receive(old.block(1))
    boundary = old.boundary(2, old.block(1))
    old.receive(boundary)
    assert old.core.last_voted_round == 2
    node = OneCore(3, epoch=1, root=boundary, journal=old.journal)
    assert (node.core.last_voted_round, node.core.round) == (0, 1)
    assert said(node.receive(node.block(1)), Vote)
    node, boundary, *_ = next_node()
    one = node.block(1)
    vote = said(node.receive(one), Vote)
    again = OneCore(3, epoch=1, root=boundary, journal=node.journal)
    assert vote[0] in said(again.started, Vote)
    assert said(again.receive(node.block(1, transactions=(TRANSACTION,))), Vote) == []


def test_a_core_needs_a_certificate_of_its_own_epoch():
    _, boundary, before, *_ = next_node()
    with pytest.raises(AssertionError, match="another epoch"):
        Core(
            ChainSettings(),
            CHAIN_ID,
            Schedule(1, before.schedule.producers),
            None,
            finalized=boundary,
            finalized_qc=before.qc(boundary),
            round_zero_id=boundary.block_id,
        )


def test_the_certificate_that_sync_brings_for_a_boundary_is_of_no_use_in_the_next_epoch():
    node, boundary, before, *_ = next_node()
    node.handle(FinalizedElsewhere(head=boundary, qc=before.qc(boundary), now_ms=node.now_ms))
    assert node.core.round == 1
    assert node.core.high_qc == node.root_qc


def test_leaderless_seats_vote_but_are_refused_as_leaders():
    peers = Peers()
    schedule = Schedule(0, peers.schedule.producers, leaderless=(1,))
    core = Core(
        ChainSettings(),
        CHAIN_ID,
        schedule,
        peers.keys[1],
        finalized=GENESIS,
        finalized_qc=peers.root_qc,
        round_zero_id=GENESIS.block_id,
    )
    assert (core.index, core.leader) == (1, 2)


def test_a_boundary_refuses_to_be_proven_by_an_ordinary_child():
    peers = Peers()
    boundary = peers.boundary(1)
    node = OneCore()
    proof = of_type(closed(node)[2], CommitBlocks)[0].proof
    child = peers.block(2, boundary)
    false = msgspec.structs.replace(proof, child_header_bytes=child.header_bytes, child_qc=peers.qc(child))
    with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
        verify_finality(false, node.schedule, CHAIN_ID, GENESIS.block_id)

"""R14 to R18: what counts as a block, missing blocks, sync, limits, halting."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.block import Block, IndexedSignature, QuorumCertificate
from consensus.chain.messages import Proposal, Vote, sign_block
from consensus.limits import ORPHAN_BLOCKS_MAX_COUNT
from consensus.primitives.hashing import sha256
from consensus.protocol.effects import TIMER_FETCH, CancelTimer, ExecuteBlock, FetchBlocks, Halt, SetTimer
from consensus.protocol.events import BlocksFetched, FinalizedElsewhere, ProposalReceived, VoteReceived
from tests.sim.named_chain import make_transaction
from tests.unit.consensus.one_core import NOW_MS, TRANSACTION, OneCore, committed, of_type, said


def proposed(node, block):
    return node.handle(ProposalReceived(proposal=Proposal(block=block), sender=1, now_ms=NOW_MS))


@pytest.mark.parametrize(
    "changes",
    [
        {"version": 1},
        {"chain_id": sha256(b"another chain")},
        {"epoch": 1},
        {"producer": 2},
        {"height": 2},
        {"height": -1},
        {"round": -3},
        {"round": 2},
        {"timestamp_ms": 5},
        {"gas_used": 500_001},
        {"gas_used": -1},
        {"state_root": b"short"},
        {"parent_id": sha256(b"another parent")},
        {"transactions_root": sha256(b"other transactions")},
        {"next_schedule_hash": b"short"},
        {"is_closing": True},
        {"is_closing": True, "next_schedule_hash": sha256(b"a schedule")},
        {"is_closing": True, "receipts_root": sha256(b"receipts")},
        {"is_closing": True, "gas_used": 1},
        {"qc": QuorumCertificate(epoch=0, round=-1, block_id=bytes(32), votes=())},
    ],
    ids=str,
)
def test_a_block_with_a_wrong_field_is_never_executed(changes):
    node = OneCore()
    effects = proposed(node, node.block(1, **changes))
    assert of_type(effects, ExecuteBlock) == []
    assert node.core.halted == ""


def test_a_block_that_its_leader_did_not_sign_is_never_executed():
    node = OneCore()
    block = node.block(1)
    assert proposed(node, msgspec.structs.replace(block, signature=node.block(2).signature)) == []
    node = OneCore()
    other = (node.schedule.leader(1) + 1) % len(node.keys)
    block = node.block(1, producer=other)
    signature = sign_block(node.keys[other], node.chain_id, node.schedule.epoch, 1, block.block_id)
    assert of_type(proposed(node, msgspec.structs.replace(block, signature=signature)), ExecuteBlock) == []
    assert proposed(OneCore(), Block(header_bytes=b"\x93", signature=bytes(64), transactions=())) == []


def test_a_swapped_body_is_refused_and_the_true_block_still_counts():
    """The id covers the header only: a relay must not be able to make a good block look bad."""
    node = OneCore()
    true = node.block(1, transactions=(TRANSACTION,))
    swapped = msgspec.structs.replace(true, transactions=(make_transaction(2),))
    garbage = msgspec.structs.replace(true, transactions=(b"\xff",))
    assert proposed(node, swapped) == []
    assert proposed(node, garbage) == []
    assert said(node.receive(true), Vote) == [node.vote(3, true)]


def test_a_qc_with_a_forged_or_repeated_vote_is_refused():
    node = OneCore()
    one = node.block(1)
    node.receive(one)
    good = node.qc(one)
    forged = IndexedSignature(index=2, signature=bytes(64))
    for votes in (
        (*good.votes[:2], forged),
        (good.votes[0], good.votes[0], good.votes[1]),
        (good.votes[1], good.votes[0], good.votes[2]),
        good.votes[:2],
        (*good.votes, IndexedSignature(index=3, signature=node.vote(3, one).signature)),
    ):
        bad = QuorumCertificate(epoch=0, round=1, block_id=one.block_id, votes=votes)
        node.notice(bad)
        assert of_type(proposed(node, node.block(2, one, qc=bad)), ExecuteBlock) == []
    assert node.core.round == 1


def test_votes_that_are_forged_or_out_of_range_count_for_nothing():
    node = OneCore()
    one = node.block(1)
    node.receive(one)
    genuine = node.vote(0, one)
    for vote in (
        msgspec.structs.replace(genuine, signature=bytes(64)),
        msgspec.structs.replace(genuine, index=4),
        msgspec.structs.replace(genuine, index=-1),
        msgspec.structs.replace(genuine, epoch=1),
        msgspec.structs.replace(genuine, round=10_000),
        msgspec.structs.replace(genuine, round=-5),
        msgspec.structs.replace(genuine, block_id=b""),
    ):
        node.handle(VoteReceived(vote=vote, now_ms=NOW_MS))
    assert len(node.core._votes) == 1
    node.vote_from(0, one)
    node.vote_from(1, one)
    assert node.core.high_qc.block_id == one.block_id


def test_a_second_block_of_a_round_is_kept_only_once_it_is_certified():
    node = OneCore()
    first, second = node.block(1), node.block(1, transactions=(TRANSACTION,))
    node.receive(first)
    node.receive(second)
    assert node.core.block(second.block_id) is None
    effects = node.notice(node.qc(second))
    assert of_type(effects, FetchBlocks)[0].block_id == second.block_id
    node.handle(BlocksFetched(blocks=(second,), now_ms=NOW_MS))
    assert node.core.block(second.block_id) == second


def test_a_qc_without_its_block_asks_its_signers_and_asks_again():
    node = OneCore()
    one = node.block(1)
    effects = node.notice(node.qc(one, (0, 1, 3)))
    assert of_type(effects, FetchBlocks) == [FetchBlocks(block_id=one.block_id, above_height=0, producers=(0, 1))]
    assert SetTimer(kind=TIMER_FETCH, round=2, delay_ms=500) in effects
    assert of_type(node.work(), FetchBlocks) == []
    assert len(of_type(node.fire(TIMER_FETCH), FetchBlocks)) == 1
    assert CancelTimer(kind=TIMER_FETCH) in node.receive(one)


def test_a_proposal_whose_parent_is_missing_waits_for_it():
    node = OneCore()
    one, two = node.chain(1, 2)
    effects = proposed(node, two)
    assert of_type(effects, ExecuteBlock) == []
    assert of_type(effects, FetchBlocks)[0].block_id == one.block_id
    effects = node.executed(node.handle(BlocksFetched(blocks=(one,), now_ms=NOW_MS)))
    assert [effect.block for effect in of_type(effects, ExecuteBlock)] == [one, two]
    assert said(effects, Vote) == [node.vote(3, two)]


def test_fetched_blocks_are_checked_like_any_others():
    node = OneCore()
    one = node.block(1)
    node.notice(node.qc(one))
    node.handle(BlocksFetched(blocks=(msgspec.structs.replace(one, signature=bytes(64)),), now_ms=NOW_MS))
    assert node.core.block(one.block_id) is None


def test_a_long_gap_is_filled_in_pieces():
    node = OneCore()
    blocks = node.chain(*range(1, 31))
    asked = of_type(node.notice(node.qc(blocks[-1])), FetchBlocks)
    final = []
    while asked:
        answer = tuple(block for block in blocks if block.header.height > asked[-1].above_height)[:10]
        effects = node.executed(node.handle(BlocksFetched(blocks=answer, now_ms=NOW_MS)))
        final += committed(effects)
        asked = of_type(effects, FetchBlocks)
    assert final == blocks[:-1]


def test_orphans_are_bounded():
    node = OneCore()
    blocks = node.chain(*range(1, ORPHAN_BLOCKS_MAX_COUNT + 20))
    for block in reversed(blocks[1:]):
        proposed(node, block)
    assert len(node.core._tree.orphans) == ORPHAN_BLOCKS_MAX_COUNT


def test_blocks_that_sync_stored_become_the_new_head_and_waiting_blocks_connect():
    node = OneCore()
    blocks = node.chain(*range(1, 6))
    proposed(node, blocks[4])
    event = FinalizedElsewhere(head=blocks[3], qc=node.qc(blocks[3]), now_ms=NOW_MS)
    effects = node.executed(node.handle(event))
    assert node.core.finalized_id == blocks[3].block_id
    assert committed(effects) == []
    assert said(effects, Vote) == [node.vote(3, blocks[4])]


def test_sync_keeps_what_is_above_its_head_and_an_older_head_changes_nothing():
    node = OneCore()
    one, two = node.chain(1, 2)
    node.receive(one)
    node.receive(two)
    node.handle(FinalizedElsewhere(head=one, qc=node.qc(one), now_ms=NOW_MS))
    assert node.core.finalized_id == one.block_id
    assert node.core.block(two.block_id) == two
    node = OneCore()
    one, two, three = node.chain(1, 2, 3)
    for block in (one, two, three):
        node.receive(block)
    node.notice(node.qc(three))
    node.handle(FinalizedElsewhere(head=one, qc=node.qc(one), now_ms=NOW_MS))
    assert node.core.finalized_id == two.block_id


def test_a_block_that_does_not_execute_halts_the_node_only_if_it_is_certified():
    node = OneCore()
    one = node.block(1)
    node.receive(one, valid=False)
    effects = node.notice(node.qc(one, (0, 1, 2)))
    assert len(of_type(effects, Halt)) == 1
    assert node.work() == []
    node = OneCore()
    node.receive(node.block(1), valid=False)
    assert node.core.halted == ""
    two = node.block(2, tc=node.tc(1))
    assert said(node.receive(two), Vote) == [node.vote(3, two)]


def test_nobody_builds_on_a_refused_block():
    node = OneCore()
    one, two = node.chain(1, 2)
    node.receive(one, valid=False)
    effects = proposed(node, two)
    assert of_type(effects, ExecuteBlock) == []
    assert node.core.halted != ""


def test_a_block_whose_time_does_not_move_on_is_refused():
    node = OneCore()
    one = node.block(1)
    node.receive(one)
    assert said(node.receive(node.block(2, one, timestamp_ms=one.header.timestamp_ms)), Vote) == []


def test_serving_a_branch_gives_what_the_synced_store_lacks():
    node = OneCore()
    one, two, three = node.chain(1, 2, 3)
    for block in (one, two, three):
        node.receive(block)
    assert node.core.finalized_id == one.block_id
    assert node.core.branch(three.block_id, 0) == [one, two, three]
    assert node.core.branch(three.block_id, 2) == [three]
    assert node.core.branch(sha256(b"unknown"), 0) == []
    assert node.core.block(one.block_id) == one
    node.core.forget_journalled(1)
    assert node.core.branch(three.block_id, 0) == [two, three]

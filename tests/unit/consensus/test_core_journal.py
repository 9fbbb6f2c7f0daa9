"""R12, R13: journal, then speak; after a crash say the same again and nothing else."""

from __future__ import annotations

import pytest

from consensus.chain.journal_records import KIND_PROPOSAL, KIND_TIMEOUT, KIND_VOTE, JournalRecord, read_journal
from consensus.chain.messages import Proposal, Timeout, Vote
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.protocol.core import Core
from consensus.protocol.effects import TIMER_ROUND, Broadcast, BuildBlock, CommitBlocks, ExecuteBlock, Persist, SendTo
from tests.sim.named_chain import CHAIN_ID
from tests.unit.consensus.one_core import GENESIS, TRANSACTION, OneCore, of_type, said


def records(node):
    return [decode(data, JournalRecord) for data in node.journal]


def test_every_word_stands_behind_the_record_of_the_same_bytes():
    node = OneCore(1)
    everything = []
    (order,) = of_type(node.work(), BuildBlock)
    everything.append(node.built(order, (TRANSACTION,)))
    everything.append(node.fire("round"))
    everything.append(node.notice(node.core.high_qc, node.tc(1)))
    everything.append(node.receive(node.block(2, tc=node.tc(1))))
    for effects in everything:
        journalled: list[object] = []
        for effect in effects:
            if isinstance(effect, Persist):
                for data in effect.records:
                    record = decode(data, JournalRecord)
                    journalled += [record.vote, record.timeout, *record.blocks]
            if isinstance(effect, Broadcast | SendTo) and isinstance(effect.message, Vote | Timeout):
                assert effect.message in journalled
            if isinstance(effect, Broadcast) and isinstance(effect.message, Proposal):
                assert effect.message.block in journalled


def test_a_proposal_and_the_own_vote_are_one_record_and_one_sync():
    node = OneCore(1)
    (order,) = of_type(node.work(), BuildBlock)
    effects = node.built(order)
    assert len(of_type(effects, Persist)) == 1
    (record,) = records(node)
    assert record.kind == KIND_PROPOSAL
    assert record.vote is not None
    assert record.proposed_id == record.vote.block_id == record.blocks[0].block_id


def test_a_vote_brings_those_ancestors_that_the_journal_lacks():
    node = OneCore(6, count=7)
    one, two, three = node.chain(1, 2, 3)
    node.fire("heartbeat", 0)
    node.fire("round")
    node.receive(one)  # no vote: the round was given up
    node.receive(two)
    node.receive(three)
    timeout, second, third = records(node)
    assert (timeout.kind, timeout.blocks) == (KIND_TIMEOUT, ())
    assert (second.kind, second.blocks, second.high_qc) == (KIND_VOTE, (one, two), two.header.qc)
    assert third.blocks == (three,)


def test_after_a_crash_between_sync_and_sending_the_same_words_are_sent():
    node = OneCore()
    one = node.block(1)
    before = said(node.receive(one), Vote)
    after = node.restarted()
    assert said(after.started, Vote) == before
    assert said(after.executed(after.started), Vote) == before
    node = OneCore(1)
    (order,) = of_type(node.work(), BuildBlock)
    before = said(node.built(order, (TRANSACTION,)), Proposal)
    after = node.restarted()
    assert said(after.started, Proposal) == before
    assert of_type(after.executed(after.started), BuildBlock) == []
    assert of_type(after.work(), BuildBlock) == []
    node = OneCore()
    node.work()
    before = said(node.fire("round"), Timeout)
    after = node.restarted()
    assert said(after.started, Timeout) == before
    assert after.core.has_timed_out


def test_a_crash_before_the_sync_leaves_nothing_said():
    node = OneCore()
    one, other = node.block(1), node.block(1, transactions=(TRANSACTION,))
    node.receive(one)
    node.journal.clear()
    assert said(node.restarted().receive(other), Vote) == [node.vote(3, other)]


def test_the_journal_brings_back_round_certificates_and_blocks():
    node = OneCore(6, count=7)
    one, three = node.chain(1, 3)
    node.receive(one)
    node.receive(three)
    after = node.restarted()
    assert (after.core.round, after.core.high_qc, after.core.last_voted_round) == (3, node.core.high_qc, 3)
    assert after.core.entered_by == node.core.entered_by
    assert [effect.block for effect in of_type(after.started, ExecuteBlock)] == [one]
    assert after.core.branch(three.block_id, 0) == [one, three]


def test_what_was_final_before_the_power_cut_is_final_again_after_it():
    """The store had synced nothing: the journal alone brings the blocks back."""
    node = OneCore()
    one, two = node.chain(1, 2)
    node.receive(one)
    node.receive(two)
    node.notice(node.qc(two))
    after = node.restarted()
    after.executed(after.started)
    assert of_type(after.notice(after.qc(two)), CommitBlocks)[0].blocks == (one,)


def test_a_snapshot_says_the_same_as_the_journal_and_a_restart_from_it_goes_on():
    node = OneCore()
    node.work()
    node.receive(node.block(1))
    node.notice(node.core.high_qc, node.tc(1))
    node.fire("round")
    full, short = read_journal(node.journal, 0), read_journal(node.core.journal_snapshot(), 0)
    assert full == short
    node = OneCore(6, count=7)
    for block in node.chain(1, 2, 3):
        node.receive(block)
    node.journal = list(node.core.journal_snapshot())
    after = node.restarted()
    assert (after.core.round, after.core.last_voted_round) == (3, 3)
    assert said(after.started, Vote) == [node.core._voter.last_vote]


def test_a_block_leaves_the_journal_only_when_the_synced_store_holds_it():
    node = OneCore(6, count=7)
    one, two, three, four = node.chain(1, 2, 3, 4)
    for block in (one, two, three, four):
        node.receive(block)
    assert node.core.finalized_id == two.block_id
    assert set(read_journal(node.core.journal_snapshot(), 0).blocks.values()) == {one, two, three, four}
    node.core.forget_journalled(1)
    assert set(read_journal(node.core.journal_snapshot(), 0).blocks.values()) == {two, three, four}
    node.core.forget_journalled(2)
    assert set(read_journal(node.core.journal_snapshot(), 0).blocks.values()) == {three, four}


def test_a_block_that_was_forgotten_is_not_journalled_again():
    node = OneCore(6, count=7)
    blocks = node.chain(1, 2, 3, 4)
    for block in blocks[:3]:
        node.receive(block)
    node.core.forget_journalled(1)
    node.core.journal_snapshot()
    node.journal.clear()
    node.receive(blocks[3])
    (record,) = records(node)
    assert record.blocks == (blocks[3],)


def test_a_node_whose_store_lags_too_far_signs_nothing(monkeypatch):
    monkeypatch.setattr("consensus.protocol.journal_builder.UNSTORED_BLOCKS_MAX_COUNT", 1)
    node = OneCore(6, count=7)
    one, two, three, four = node.chain(1, 2, 3, 4)
    for block in (one, two, three):
        node.receive(block)
    assert node.core.finalized_id == one.block_id
    assert said(node.receive(four), Vote) == []
    assert said(node.fire("round"), Timeout) == []
    node.core.forget_journalled(2)
    assert len(said(node.fire("round"), Timeout)) == 1


def test_records_of_another_epoch_are_not_read_as_words_and_what_is_no_record_is_refused():
    node = OneCore()
    node.receive(node.block(1))
    assert read_journal(node.journal, 1).last_voted_round == 0
    with pytest.raises(BlockRobotError, match="ENCODING_INVALID"):
        OneCore(journal=[b"not a record"])


def test_a_store_ahead_of_the_journal_wins():
    node = OneCore()
    one, two = node.chain(1, 2)
    node.receive(one)
    core = Core(
        node.settings,
        CHAIN_ID,
        node.schedule,
        node.keys[3],
        finalized=two,
        finalized_qc=node.qc(two),
        round_zero_id=GENESIS.block_id,
        journal=node.journal,
    )
    assert (core.round, core.last_voted_round, core.finalized_id) == (3, 1, two.block_id)
    assert core.block(one.block_id) is None


def test_a_thousand_lost_rounds_leave_a_journal_that_is_read_at_once():
    """Elsewhere the replay of as many rounds took hours (tendermint#8679): here each round is one record at most."""
    node = OneCore()
    node.work()
    for number in range(1, 1_001):
        node.fire(TIMER_ROUND, number)
        node.notice(node.core.high_qc, node.tc(number))
    assert node.core.round == 1_001
    assert len(node.journal) <= 1_001
    assert len(node.core.journal_snapshot()) <= 3
    again = node.restarted().core
    assert (again.round, again.last_voted_round) == (1_000, 1_000), "where it last spoke; peers tell the rest"

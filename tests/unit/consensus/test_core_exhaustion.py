"""R41, R42: what cannot be executed here is no bad block, and what is given up in vain gets no vote."""

from __future__ import annotations

import pytest

from consensus.chain.block import Block
from consensus.chain.block_rules import lost_rounds_before_giving_up, may_give_up_change
from consensus.chain.epoch_settings import ChainSettings
from consensus.chain.messages import CertificateNotice, Proposal, Timeout, Vote
from consensus.limits import EXECUTION_RETRY_MAX_MS, EXECUTION_RETRY_MIN_MS
from consensus.protocol.effects import (
    TIMER_EXECUTE,
    BuildBlock,
    CommitBlocks,
    Effect,
    ExecuteBlock,
    Halt,
    ProposalLost,
    SetTimer,
)
from consensus.protocol.events import BlockExecuted, NoticeReceived, ProposalReceived
from tests.unit.consensus.one_core import NOW_MS, TRANSACTION, OneCore, Peers, of_type, said


def propose(node: OneCore, block: Block) -> list[Effect]:
    return node.handle(ProposalReceived(proposal=Proposal(block=block), sender=1, now_ms=NOW_MS))


def answer(node: OneCore, block: Block, *, fault: bool = False, withheld: bool = False) -> list[Effect]:
    event = BlockExecuted(block_id=block.block_id, valid=not fault, fault=fault, withheld=withheld, now_ms=NOW_MS)
    return node.handle(event)


def delays(effects: list[Effect]) -> list[int]:
    return [effect.delay_ms for effect in of_type(effects, SetTimer) if effect.kind == TIMER_EXECUTE]


def test_a_block_that_fails_here_gets_no_vote_and_is_executed_again_once_it_is_certified():
    node = OneCore()
    one = node.block(1)
    assert [effect.certified for effect in of_type(propose(node, one), ExecuteBlock)] == [False]
    failed = answer(node, one, fault=True)
    assert (said(failed, Vote), delays(failed), node.core.halted) == ([], [], "")
    certified = node.notice(node.qc(one, (0, 1, 2)))
    assert [(effect.block, effect.certified) for effect in of_type(certified, ExecuteBlock)] == [(one, True)]
    assert of_type(certified, Halt) == []


def test_a_certified_block_that_fails_is_tried_again_after_longer_and_longer_pauses_and_never_halts_the_node():
    waited = []
    again = OneCore()
    one = again.block(1)
    propose(again, one)
    again.handle(_notice(again, one))
    for _ in range(12):
        (delay,) = delays(answer(again, one, fault=True))
        waited.append(delay)
        (order,) = of_type(again.fire(TIMER_EXECUTE), ExecuteBlock)
        assert order.certified
    assert waited[:3] == [EXECUTION_RETRY_MIN_MS, 2 * EXECUTION_RETRY_MIN_MS, 4 * EXECUTION_RETRY_MIN_MS]
    assert waited[-1] == EXECUTION_RETRY_MAX_MS
    assert again.core.halted == ""
    answer(again, one)
    assert again.fire(TIMER_EXECUTE) == []


def _notice(node: OneCore, block: Block) -> NoticeReceived:
    return NoticeReceived(notice=CertificateNotice(qc=node.qc(block, (0, 1, 2)), entered_by=None), now_ms=NOW_MS)


def test_what_stands_on_a_block_that_fails_waits_and_is_final_once_it_was_executed():
    node = OneCore(0)
    one, two, three = node.chain(1, 2, 3)
    propose(node, one)
    answer(node, one, fault=True)
    effects = propose(node, two)  # its certificate is that of the first
    assert [effect.block for effect in of_type(effects, ExecuteBlock)] == [one]
    answer(node, one, fault=True)
    assert of_type(propose(node, three), ExecuteBlock) == []
    (order,) = of_type(node.fire(TIMER_EXECUTE), ExecuteBlock)
    assert order.block == one
    done = node.executed([order])
    finals = [block for effect in of_type(done, CommitBlocks) for block in effect.blocks]
    assert finals == [one]
    assert said(done, Vote) == [node.vote(0, three)]


def test_a_node_that_cannot_execute_gives_up_rounds_with_the_others():
    node = OneCore()
    one = node.block(1)
    propose(node, one)
    node.handle(_notice(node, one))
    answer(node, one, fault=True)
    node.work()
    assert [word.round for word in said(node.fire("round"), Timeout)] == [2]


def test_a_block_that_gives_up_gets_a_vote_only_with_reason():
    node = OneCore()
    one = node.block(1, gives_up_change=True)
    propose(node, one)
    assert said(answer(node, one, withheld=True), Vote) == []
    two = node.block(2, one)
    assert said(node.receive(two), Vote) == [node.vote(3, two)]
    assert node.core.halted == ""
    node = OneCore()
    one = node.block(1, gives_up_change=True)
    assert said(node.receive(one), Vote) == [node.vote(3, one)]


def test_a_closing_block_gives_up_nothing():
    node = OneCore()
    boundary = node.boundary(1)
    node.receive(boundary)
    wrong = node.closing(2, boundary, gives_up_change=True)
    assert said(node.receive(wrong), Vote) == []
    assert node.core.block(wrong.block_id) is None


@pytest.mark.parametrize(
    ("count", "blocks_per_turn", "least"), [(1, 1, 1), (4, 1, 2), (7, 1, 3), (4, 5, 10), (10, 2, 8)]
)
def test_the_turns_of_an_honest_leader_are_among_the_lost_rounds(count: int, blocks_per_turn: int, least: int):
    peers = Peers(count, blocks_per_turn)
    schedule = peers.schedule
    assert lost_rounds_before_giving_up(schedule) == least
    for first in range(1, 60):
        leaders = {schedule.leader(number) for number in range(first, first + least)}
        assert len(leaders) > schedule.faults_tolerated
    for number, allowed in ((least, False), (least + 1, True), (least + 9, True)):
        assert may_give_up_change(peers.block(number).header, schedule) is allowed


def test_a_leader_hears_that_its_own_block_was_lost():
    node = OneCore(1, settings=ChainSettings(min_block_interval_ms=0))
    (order,) = of_type(node.work(), BuildBlock)
    built = node.built(order, (TRANSACTION,))
    own = said(built, Proposal)[0].block
    lost = node.notice(node.root_qc, node.tc(1))
    assert [effect.block_id for effect in of_type(lost, ProposalLost)] == [own.block_id]
    other = OneCore(1, settings=ChainSettings(min_block_interval_ms=0))
    (order,) = of_type(other.work(), BuildBlock)
    own = said(other.built(order, (TRANSACTION,)), Proposal)[0].block
    assert of_type(other.notice(other.qc(own, (0, 2, 3))), ProposalLost) == []

"""R1, R2, R3: who proposes, on what, and when."""

from __future__ import annotations

import pytest

from consensus.chain.genesis import ChainSettings, parse_production
from consensus.chain.messages import Proposal, Vote
from consensus.errors import BlockRobotError
from consensus.limits import UNFINALIZED_BLOCKS_MAX_COUNT
from consensus.protocol.effects import TIMER_ASK, TIMER_PROPOSE, Broadcast, BuildBlock, ExecuteBlock, Persist, SetTimer
from consensus.protocol.events import BlockBuilt, ProposalReceived
from tests.unit.consensus.one_core import NOW_MS, TRANSACTION, OneCore, of_type, said


def orders(effects):
    return of_type(effects, BuildBlock)


def test_an_idle_leader_proposes_only_when_a_heartbeat_is_due():
    node = OneCore(1)
    assert node.core.leader == 1
    assert orders(node.started) == []
    assert len(orders(OneCore(1).fire("heartbeat", 0))) == 1
    node = OneCore(2)
    one = node.block(1)
    node.receive(one)
    assert orders(node.notice(node.qc(one))) == []


def test_work_makes_the_leader_propose_on_the_highest_qc_and_nobody_else():
    node = OneCore(1)
    (order,) = orders(node.work())
    assert (order.round, order.height, order.parent_id) == (1, 1, node.core.finalized_id)
    assert (order.qc, order.tc, order.empty) == (node.core.high_qc, None, False)
    assert orders(OneCore(2).work()) == []
    assert orders(OneCore(None).work()) == []


def test_a_proposal_is_journalled_with_the_own_vote_and_then_sent():
    node = OneCore(1)
    (order,) = orders(node.work())
    effects = node.built(order, (TRANSACTION,))
    kinds = [type(effect) for effect in effects[:3]]
    assert kinds == [Persist, Broadcast, Broadcast]
    assert len(said(effects, Proposal)) == 1
    assert said(effects, Vote)[0].block_id == said(effects, Proposal)[0].block.block_id


def test_a_leader_builds_once_in_a_round():
    node = OneCore(1)
    (order,) = orders(node.work())
    assert orders(node.work()) == []
    node.built(order)
    assert orders(node.work()) == []


def test_a_block_that_was_built_too_late_or_for_a_round_that_is_over_is_not_proposed():
    node = OneCore(1)
    (order,) = orders(node.work())
    node.fire("round")
    assert said(node.built(order), Proposal) == []
    node = OneCore(1)
    (order,) = orders(node.work())
    node.notice(node.core.high_qc, node.tc(1))
    assert said(node.built(order), Proposal) == []


def test_a_failed_build_is_tried_again_after_a_while_and_not_at_once():
    node = OneCore(1)
    (order,) = orders(node.work())
    effects = node.handle(BlockBuilt(round=order.round, block=None, now_ms=NOW_MS))
    assert orders(effects) == []
    assert [timer.kind for timer in of_type(effects, SetTimer)] == [TIMER_PROPOSE]
    assert orders(node.work()) == []
    assert len(orders(node.fire(TIMER_PROPOSE))) == 1


def test_the_next_leader_proposes_the_moment_the_qc_is_complete():
    """Two votes and its own: the child that finalizes is ordered by the same event, without any timer."""
    node = OneCore(2)
    node.work()
    one = node.block(1, transactions=(TRANSACTION,))
    node.receive(one)
    assert orders(node.vote_from(0, one)) == []
    (order,) = orders(node.vote_from(1, one))
    assert (order.round, order.parent_id) == (2, one.block_id)


def test_new_work_waits_for_the_shortest_interval_after_the_parent():
    node = OneCore(2)
    one = node.block(1)
    node.receive(one)
    node.notice(node.qc(one))
    effects = node.work()
    assert orders(effects) == []
    assert SetTimer(kind=TIMER_PROPOSE, round=2, delay_ms=5) in effects
    node.now_ms += 5
    assert len(orders(node.fire(TIMER_PROPOSE))) == 1


def test_a_leader_that_learns_of_a_lost_round_proposes_at_once_unless_it_gave_up_its_own():
    node = OneCore(2)
    (order,) = orders(node.notice(node.core.high_qc, node.tc(1)))
    assert order.tc == node.tc(1)
    assert order.round == 2
    node = OneCore(1)
    assert len(orders(node.timeout_from(0, 1))) == 1
    node = OneCore(1)
    (order,) = orders(node.timeout_from(0, 1))
    node.fire("round")
    assert node.core.has_timed_out
    assert said(node.built(order), Proposal) == []
    assert orders(node.work()) == []


def test_a_leader_that_entered_by_a_tc_and_then_got_the_fresh_qc_builds_on_that_without_a_tc():
    """The QC comes while the parent is still being executed: the order waits for it and names the fresh QC."""
    node = OneCore(3)
    one, two = node.chain(1, 2)
    node.receive(one)
    node.handle(ProposalReceived(proposal=Proposal(block=two), sender=2, now_ms=NOW_MS))
    node.notice(node.qc(two))
    assert node.core.round == 3
    node.timeout_from(0, 3, node.qc(two))
    (order,) = orders(node.executed([ExecuteBlock(block=two)]))
    assert (order.qc, order.tc) == (node.qc(two), None)


def test_after_64_unfinalized_blocks_the_leader_proposes_an_empty_one():
    full = UNFINALIZED_BLOCKS_MAX_COUNT
    last_round = 2 * full - 1
    node = OneCore(1, settings=ChainSettings(blocks_per_turn=last_round + 1))
    blocks = node.chain(*range(1, 2 * full, 2))
    for block in blocks[:-1]:
        node.receive(block)
    tip = blocks[-1]
    node.receive(tip)
    effects = node.notice(node.qc(tip), node.tc(last_round + 1, last_round))
    (order,) = orders(effects)
    assert order.empty


def test_blocks_per_turn_lets_one_leader_lead_several_rounds():
    node = OneCore(0, settings=ChainSettings(blocks_per_turn=3))
    assert [node.schedule.leader(number) for number in range(1, 8)] == [0, 0, 1, 1, 1, 2, 2]
    (order,) = orders(node.work())
    one = said(node.built(order, (TRANSACTION,)), Proposal)[0].block
    node.vote_from(1, one)
    (second,) = orders(node.vote_from(2, one))
    assert (second.round, second.producer) == (2, 0)


def test_interval_production_keeps_its_cadence_with_and_without_work():
    node = OneCore(2, settings=ChainSettings(production="interval:400"))
    node.now_ms = NOW_MS + 100
    one = node.block(1, timestamp_ms=NOW_MS + 50)
    node.receive(one)
    effects = node.notice(node.qc(one))
    assert orders(effects) == []
    assert SetTimer(kind=TIMER_PROPOSE, round=2, delay_ms=350) in effects
    node.now_ms += 350
    assert len(orders(node.fire(TIMER_PROPOSE))) == 1


def test_manual_production_starts_no_timer_and_proposes_when_pushed():
    node = OneCore(1, settings=ChainSettings(production="manual"))
    timers = of_type(node.started + node.work(), SetTimer)
    assert [timer.kind for timer in timers] == [TIMER_ASK]
    assert len(orders(node.fire(TIMER_PROPOSE))) == 1


@pytest.mark.parametrize("text", ["", "interval:", "interval:0", "interval:-5", "interval:9999999999", "later"])
def test_an_unknown_production_setting_is_refused(text):
    with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
        parse_production(text)

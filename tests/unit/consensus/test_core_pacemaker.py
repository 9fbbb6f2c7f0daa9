"""R9, R10, R11: how long a round takes, and when nobody waits at all."""

from __future__ import annotations

import pytest

from consensus.chain.genesis import ChainSettings
from consensus.protocol.effects import TIMER_HEARTBEAT, TIMER_ROUND, CancelTimer, SetTimer
from consensus.protocol.pacemaker import compute_timeout_ms
from tests.unit.consensus.one_core import TRANSACTION, OneCore, of_type


def round_timers(effects):
    return [timer.delay_ms for timer in of_type(effects, SetTimer) if timer.kind == TIMER_ROUND]


@pytest.mark.parametrize(
    ("round_number", "finalized", "certified", "round_trip", "delay"),
    [
        (1, 0, 0, 0, 500),
        (4, 1, 2, 0, 500),  # rounds 2 and 3 are certified: nothing was lost
        (4, 1, 1, 0, 1_000),  # one was
        (6, 1, 1, 0, 4_000),
        (9, 1, 1, 0, 8_000),  # the cap
        (5_000, 0, 0, 0, 8_000),
        (1, 0, 0, 250, 500),  # hosts near each other
        (1, 0, 0, 600, 1_025),
        (4, 1, 1, 600, 2_050),
        (1, 0, 0, 60_000, 8_000),
    ],
)
def test_the_timer_doubles_with_every_round_lost_since_finality(round_number, finalized, certified, round_trip, delay):
    assert compute_timeout_ms(ChainSettings(), round_number, finalized, certified, round_trip) == delay


def test_work_a_proposal_or_a_peers_timeout_starts_the_timer_and_an_idle_node_runs_none():
    assert round_timers(OneCore().started) == []
    node = OneCore()
    assert round_timers(node.work()) == [500]
    assert round_timers(node.work()) == []
    assert CancelTimer(kind=TIMER_ROUND) in node.work(pending=False)
    node = OneCore()
    assert round_timers(node.receive(node.block(1))) == [500]
    assert round_timers(OneCore().timeout_from(0, 1)) == [500]
    node = OneCore()
    assert round_timers(node.notice(node.qc(node.block(1)))) != []


def test_unfinalized_transactions_keep_the_timer_running_until_they_are_final():
    node = OneCore()
    one = node.block(1, transactions=(TRANSACTION,))
    node.receive(one)
    assert round_timers(node.notice(node.qc(one))) == [500]
    assert node.core.is_busy
    two = node.block(2, one)
    node.receive(two)
    assert CancelTimer(kind=TIMER_ROUND) in node.notice(node.qc(two))
    assert not node.core.is_busy


def test_a_heartbeat_wakes_the_network_and_is_set_again_at_finality():
    node = OneCore()
    assert SetTimer(kind=TIMER_HEARTBEAT, round=0, delay_ms=30_000) in node.started
    assert round_timers(node.fire(TIMER_HEARTBEAT, 0)) == [500]
    one, two = node.chain(1, 2)
    node.receive(one)
    node.receive(two)
    effects = node.notice(node.qc(two))
    assert SetTimer(kind=TIMER_HEARTBEAT, round=0, delay_ms=30_000) in effects
    assert not node.core.is_busy


def test_a_lost_round_makes_the_next_one_twice_as_long():
    node = OneCore()
    node.work()
    assert round_timers(node.notice(node.core.high_qc, node.tc(1, signers=(0, 1, 2)))) == [1_000]


def test_a_leader_that_lost_its_last_turn_and_is_silent_since_gets_a_quarter_of_the_time():
    """Producer 1 led round 1 and was not among those who gave it up; rounds 2, 3 and 4 went well; round 5 is its next."""
    node = OneCore()
    node.work()
    node.notice(node.core.high_qc, node.tc(1, signers=(0, 2, 3)))
    blocks = [node.block(2, tc=node.tc(1, signers=(0, 2, 3)))]
    for number in (3, 4):
        blocks.append(node.block(number, blocks[-1], qc=node.qc(blocks[-1], (0, 2, 3))))
    for block in blocks:
        node.receive(block)
    effects = node.notice(node.qc(blocks[-1], (0, 2, 3)))
    assert node.core.round == 5
    assert round_timers(effects) == [125]


def test_a_word_of_the_silent_leader_gives_it_its_full_time_back():
    node = OneCore()
    node.work()
    node.notice(node.core.high_qc, node.tc(1, signers=(0, 2, 3)))
    blocks = [node.block(2, tc=node.tc(1, signers=(0, 2, 3)))]
    for number in (3, 4):
        blocks.append(node.block(number, blocks[-1], qc=node.qc(blocks[-1], (0, 2, 3))))
    for block in blocks:
        node.receive(block)
    node.vote_from(1, blocks[-1])
    assert round_timers(node.notice(node.qc(blocks[-1], (0, 2, 3)))) == [500]


def test_interval_production_always_waits_and_adds_its_interval():
    node = OneCore(settings=ChainSettings(production="interval:400"))
    assert round_timers(node.started) == [900]

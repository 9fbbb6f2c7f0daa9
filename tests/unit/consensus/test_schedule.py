"""R1: leaders, quorums, and which certificates a schedule accepts."""

from __future__ import annotations

import itertools

import msgspec
import pytest

from consensus.chain.block import QuorumCertificate, TimeoutCertificate
from consensus.chain.epoch_settings import ChainSettings, Epoch, compute_epoch_hash
from consensus.chain.schedule import Schedule, verify_qc, verify_tc
from consensus.errors import BlockRobotError
from tests.sim.named_chain import CHAIN_ID, make_keys
from tests.unit.consensus.one_core import GENESIS, Peers

PEERS = Peers()
ONE = PEERS.block(1)


def refused_qc(qc):
    with pytest.raises(BlockRobotError, match="CERTIFICATE_INVALID"):
        verify_qc(qc, PEERS.schedule, CHAIN_ID, GENESIS.block_id)


def refused_tc(tc):
    with pytest.raises(BlockRobotError, match="CERTIFICATE_INVALID"):
        verify_tc(tc, PEERS.schedule, CHAIN_ID)


@pytest.mark.parametrize(
    ("count", "quorum", "faults"), [(1, 1, 0), (2, 2, 0), (3, 3, 0), (4, 3, 1), (7, 5, 2), (21, 15, 6)]
)
def test_any_two_quorums_share_an_honest_producer(count, quorum, faults):
    schedule = Schedule(0, tuple(key.public_key for key in make_keys(count)))
    assert (schedule.quorum, schedule.faults_tolerated) == (quorum, faults)
    assert 2 * quorum - count > faults
    assert count - faults >= quorum


def test_leaders_take_turns_and_are_found_by_their_keys():
    schedule = Schedule(0, PEERS.schedule.producers)
    assert [schedule.leader(number) for number in range(6)] == [0, 1, 2, 3, 0, 1]
    longer = Schedule(0, PEERS.schedule.producers, blocks_per_turn=2)
    assert [longer.leader(number) for number in range(9)] == [0, 0, 1, 1, 2, 2, 3, 3, 0]
    assert PEERS.schedule.index_of(PEERS.keys[2].public_key) == 2
    assert PEERS.schedule.index_of(bytes(33)) is None


def test_a_schedule_has_one_to_21_different_producers():
    keys = tuple(key.public_key for key in make_keys(22))
    for producers in ((), keys, (keys[0], keys[0])):
        with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
            Schedule(0, producers)
    assert Schedule(0, keys[:21]).quorum == 15


def test_leaderless_seats_lead_nothing_unless_all_are_and_count_in_the_quorum():
    schedule = Schedule(0, PEERS.schedule.producers, leaderless=(1, 2))
    assert [schedule.leader(number) for number in range(4)] == [0, 3, 0, 3]
    assert schedule.quorum == 3
    schedule = Schedule(0, PEERS.schedule.producers, leaderless=(0, 1, 2, 3))
    assert [schedule.leader(number) for number in range(4)] == [0, 1, 2, 3]


@pytest.mark.parametrize("leaderless", [(2, 1), (1, 1), (4,), (-1,)])
def test_leaderless_seats_are_sorted_indexes(leaderless):
    with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
        Schedule(0, PEERS.schedule.producers, leaderless=leaderless)


@pytest.mark.parametrize(("epoch", "turns"), [(-1, 1), (0, 0)])
def test_a_schedule_has_a_number_and_turns(epoch, turns):
    with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
        Schedule(epoch, PEERS.schedule.producers, turns)


def test_the_hash_names_all_that_an_epoch_decides():
    producers = PEERS.schedule.producers
    first = Epoch(number=1, producers=producers, leaderless=(), settings=ChainSettings())
    epochs = [
        first,
        msgspec.structs.replace(first, number=2),
        msgspec.structs.replace(first, producers=producers[::-1]),
        msgspec.structs.replace(first, producers=producers[:3]),
        msgspec.structs.replace(first, leaderless=(0,)),
        msgspec.structs.replace(first, settings=ChainSettings(blocks_per_turn=2)),
    ]
    assert len({compute_epoch_hash(epoch) for epoch in epochs}) == len(epochs)
    assert Schedule.of(epochs[4]) == Schedule(1, producers, 1, (0,))


def test_a_quorum_makes_a_certificate_a_tc_or_a_boundary_of_round_0():
    for voters in itertools.combinations(range(4), 3):
        verify_qc(PEERS.qc(ONE, voters), PEERS.schedule, CHAIN_ID, GENESIS.block_id)
    with pytest.raises(BlockRobotError, match="CERTIFICATE_INVALID"):
        verify_qc(PEERS.qc(ONE), PEERS.schedule, bytes(32), GENESIS.block_id)
    verify_qc(PEERS.qc(GENESIS), PEERS.schedule, CHAIN_ID, GENESIS.block_id)
    refused_qc(QuorumCertificate(epoch=0, round=0, block_id=ONE.block_id, votes=()))
    refused_qc(QuorumCertificate(epoch=0, round=0, block_id=GENESIS.block_id, votes=PEERS.qc(ONE).votes))
    tc = PEERS.tc(5, 0, 3, 4)
    verify_tc(tc, PEERS.schedule, CHAIN_ID)
    assert tc.highest_qc_round == 4


@pytest.mark.parametrize("voters", [(0, 1), (0, 1, 2, 3), (0, 0, 1), (2, 1, 0), ()])
def test_a_certificate_is_exactly_a_quorum_in_order(voters):
    refused_qc(PEERS.qc(ONE, voters))


@pytest.mark.parametrize("changes", [{"epoch": 1}, {"round": 2}, {"round": -1}, {"block_id": bytes(32)}], ids=str)
def test_a_certificate_for_something_else_is_refused(changes):
    refused_qc(msgspec.structs.replace(PEERS.qc(ONE), **changes))


@pytest.mark.parametrize("index", [-1, 4])
def test_a_signer_outside_the_schedule_is_refused(index):
    good = PEERS.qc(ONE)
    outside = msgspec.structs.replace(good.votes[0], index=index)
    refused_qc(msgspec.structs.replace(good, votes=tuple(sorted((outside, *good.votes[1:]), key=lambda v: v.index))))


@pytest.mark.parametrize("signers", [(), (0, 1), (0, 1, 2, 3), (1, 0, 2), (0, 0, 1)])
def test_a_tc_is_exactly_a_quorum_in_order(signers):
    refused_tc(PEERS.tc(5, signers=signers))


def test_a_tc_of_another_epoch_or_round_or_with_an_impossible_qc_round_is_refused():
    refused_tc(PEERS.tc(5, 5))
    good = PEERS.tc(5)
    negative = msgspec.structs.replace(good.timeouts[0], qc_round=-1)
    refused_tc(msgspec.structs.replace(good, timeouts=(negative, *good.timeouts[1:])))
    good = PEERS.tc(5)
    changed = msgspec.structs.replace(good.timeouts[0], qc_round=2)
    refused_tc(msgspec.structs.replace(good, timeouts=(changed, *good.timeouts[1:])))
    refused_tc(msgspec.structs.replace(PEERS.tc(5), epoch=1))
    refused_tc(msgspec.structs.replace(PEERS.tc(5), round=6))
    refused_tc(TimeoutCertificate(epoch=0, round=-1, timeouts=PEERS.tc(5).timeouts))


def test_a_vote_never_passes_for_a_timeout():
    votes = PEERS.qc(ONE).votes
    forged = tuple(
        msgspec.structs.replace(timeout, signature=vote.signature)
        for timeout, vote in zip(PEERS.tc(1).timeouts, votes, strict=True)
    )
    refused_tc(msgspec.structs.replace(PEERS.tc(1), timeouts=forged))

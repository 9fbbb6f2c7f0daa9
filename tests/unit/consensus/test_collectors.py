"""Words on their way to a certificate: each producer counts once, and only for one block."""

from __future__ import annotations

from consensus.protocol.vote_collectors import TimeoutCollector, VoteCollector
from tests.unit.consensus.one_core import Peers

PEERS = Peers()
ONE, OTHER = PEERS.block(1), PEERS.block(1, timestamp_ms=PEERS.root.header.timestamp_ms + 7)


def test_a_quorum_for_one_block_makes_its_certificate_and_votes_for_different_ones_none():
    votes = VoteCollector(PEERS.schedule.quorum)
    assert [votes.add(PEERS.vote(index, ONE)) for index in (3, 0)] == [None, None]
    assert votes.add(PEERS.vote(2, ONE)) == PEERS.qc(ONE, (0, 2, 3))
    assert votes.add(PEERS.vote(1, ONE)) is None
    votes = VoteCollector(PEERS.schedule.quorum)
    said = [(0, ONE), (1, OTHER), (2, ONE), (3, OTHER)]
    assert [votes.add(PEERS.vote(index, block)) for index, block in said] == [None] * 4


def test_of_two_words_of_one_producer_the_first_counts():
    votes = VoteCollector(PEERS.schedule.quorum)
    said = [(0, ONE), (0, OTHER), (1, OTHER), (2, OTHER)]
    assert [votes.add(PEERS.vote(index, block)) for index, block in said] == [None] * 4
    assert votes.add(PEERS.vote(3, OTHER)) == PEERS.qc(OTHER, (1, 2, 3))
    timeouts = TimeoutCollector(PEERS.schedule.quorum)
    later = PEERS.timeout(0, 2, PEERS.qc(ONE))
    assert [timeouts.add(each) for each in (PEERS.timeout(0, 2), later, PEERS.timeout(1, 2))] == [None] * 3
    assert timeouts.add(PEERS.timeout(3, 2)) == PEERS.tc(2, 0, signers=(0, 1, 3))

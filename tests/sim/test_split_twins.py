"""R39: a leader shows one block to one half of the others, its twin to the other half, and is found out all the same."""

from __future__ import annotations

from consensus.chain.messages import Proposal, Vote, sign_vote
from consensus.protocol.message_log import MessageLog
from tests.sim.core_cluster import Cluster, Links
from tests.sim.lying_node import LyingNode
from tests.sim.named_chain import CHAIN_ID

LIAR = 2


class SplittingNode(LyingNode):
    """Even peers get its block and its vote for it, odd ones a twin and a vote for that. Else it is honest."""

    def send(self, peer, message):
        if peer == self.number:
            return
        if peer % 2 and isinstance(message, Proposal):
            message = Proposal(block=self.twin_of(message.block))
        elif peer % 2 and isinstance(message, Vote) and (block := self.own_block(message.block_id)) is not None:
            twin_id = self.twin_of(block).block_id
            message = sign_vote(self.key, CHAIN_ID, message.epoch, message.round, twin_id, message.index)
        self.cluster.transmit(self.number, peer, lambda: self.cluster.nodes[peer].receive(self.number, message))

    def own_block(self, block_id):
        block = self.core.block(block_id)
        return block if block is not None and block.header.producer == self.index_of(self.number) else None

    receive = LyingNode.__mro__[1].receive


def evidence_after_a_while():
    cluster = Cluster(7, 3, kinds={LIAR: SplittingNode})
    cluster.links = Links(delay_min=5, delay_max=30)
    cluster.start()
    for _ in range(40):
        cluster.submit()
        cluster.run(100)
    cluster.run(5_000)
    assert cluster.nodes[0].store.synced, "nothing became final"
    return [(number, evidence) for number, evidence in cluster.evidence if number != LIAR]


def test_of_seven_a_leader_that_splits_its_twins_evenly_is_found_out():
    """Three voters and the liar on either side are no quorum of five: no certificate would ever show it."""
    found = evidence_after_a_while()
    assert {evidence.kind for _, evidence in found} == {"proposal"}
    assert {number for number, _ in found} == {0, 1, 3, 4, 5, 6}


def test_without_the_rule_it_is_not(monkeypatch):
    monkeypatch.setattr(MessageLog, "find_conflicting_voters", lambda self, round_number: (b"", []))
    assert evidence_after_a_while() == []

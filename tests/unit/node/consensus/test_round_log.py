"""What a node said in its last rounds."""

from __future__ import annotations

from typing import Any

from consensus.chain.block import Block, Header, QuorumCertificate
from consensus.chain.messages import Proposal, Timeout, Vote
from consensus.primitives.encoding import encode
from node.consensus.round_log import GAVE_UP, PROPOSED, ROUNDS_KEPT_COUNT, VOTED, LoggingOutbox, RoundLog

QC = QuorumCertificate(epoch=0, round=0, block_id=bytes(32), votes=())


class _Peers:
    def __init__(self) -> None:
        self.heard: list[Any] = []

    def broadcast(self, message: Any) -> None:
        self.heard.append(message)

    def send_to(self, index: int, message: Any) -> None:
        self.heard.append((index, message))

    def fetch(self, effect: Any) -> None:
        self.heard.append(effect)

    def gossip_again(self) -> None:
        self.heard.append("again")


def _spoken(now_ms: list[int]) -> RoundLog:
    return RoundLog(lambda: now_ms[0], lambda epoch, number: f"node-{number % 4 + 1}" if epoch == 0 else None)


def _vote(number: int, epoch: int = 0) -> Vote:
    return Vote(epoch=epoch, round=number, block_id=bytes(32), index=0, signature=bytes(64))


def _timeout(number: int) -> Timeout:
    return Timeout(epoch=0, round=number, index=0, signature=bytes(64), qc=QC, entered_by=None)


def _proposal(number: int) -> Proposal:
    header = Header(
        version=2,
        chain_id=bytes(32),
        epoch=0,
        height=1,
        round=number,
        parent_id=bytes(32),
        qc=QC,
        tc=None,
        producer=0,
        timestamp_ms=1,
        transactions_root=bytes(32),
        receipts_root=bytes(32),
        state_root=bytes(32),
        next_schedule_hash=None,
        gas_used=0,
    )
    return Proposal(block=Block(header_bytes=encode(header), signature=bytes(64), transactions=()))


def test_words_are_noted_by_round_and_go_out_unchanged() -> None:
    now_ms, peers = [1_000], _Peers()
    spoken = _spoken(now_ms)
    outbox = LoggingOutbox(peers, spoken)
    words = [_proposal(5), _vote(5), _timeout(6)]
    for word in words:
        outbox.broadcast(word)
    assert peers.heard == words
    assert spoken.describe() == [
        {"epoch": 0, "round": 5, "leader": "node-2", "messages": {PROPOSED: 1_000, VOTED: 1_000}},
        {"epoch": 0, "round": 6, "leader": "node-3", "messages": {GAVE_UP: 1_000}},
    ]


def test_a_word_that_is_said_again_keeps_its_first_time() -> None:
    now_ms = [1_000]
    spoken = _spoken(now_ms)
    outbox = LoggingOutbox(_Peers(), spoken)
    outbox.broadcast(_timeout(6))
    now_ms[0] = 2_000
    outbox.broadcast(_timeout(6))
    assert spoken.describe()[0]["messages"] == {GAVE_UP: 1_000}


def test_another_leaders_block_that_is_passed_on_is_no_proposal_of_this_node() -> None:
    spoken, peers = _spoken([0]), _Peers()
    outbox = LoggingOutbox(peers, spoken)
    outbox.send_to(2, _proposal(5))
    assert spoken.describe() == []
    outbox.send_to(2, _vote(5, epoch=3))
    assert spoken.describe() == [{"epoch": 3, "round": 5, "leader": None, "messages": {VOTED: 0}}]
    assert len(peers.heard) == 2


def test_only_the_last_rounds_are_kept_and_what_is_no_word_of_a_round_passes_too() -> None:
    spoken = _spoken([0])
    for number in range(ROUNDS_KEPT_COUNT + 5):
        spoken.note(0, number, VOTED)
    kept = [row["round"] for row in spoken.describe()]
    assert kept == list(range(5, ROUNDS_KEPT_COUNT + 5))
    peers = _Peers()
    outbox = LoggingOutbox(peers, _spoken([0]))
    outbox.gossip_again()
    assert peers.heard == ["again"]

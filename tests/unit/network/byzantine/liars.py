"""A liar of a network of four, the honest words that its node says, and an outbox that keeps what left it."""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random

from consensus.chain.block import Header, IndexedSignature, QuorumCertificate
from consensus.chain.messages import Proposal, Timeout, Vote, sign_timeout, sign_vote
from consensus.protocol.effects import BuildBlock, FetchBlocks, Message
from network.byzantine import Behaviour, make_behaviour
from network.byzantine.behaviour import ColludingNodes
from tests.sim.named_chain import CHAIN_ID, build_block, make_genesis_block, make_keys, make_transaction

COUNT = 4
LIAR = 1
OTHERS = [0, 2, 3]
KEYS = make_keys(COUNT)
GENESIS = make_genesis_block()
NOW_MS = 1_800_000_100_000


@dataclass
class Kept:
    """An outbox that keeps everything: (receiver or None for all, message)."""

    sent: list[tuple[int | None, Message]] = field(default_factory=list)
    fetched: list[FetchBlocks] = field(default_factory=list)
    gossiped: int = 0

    def broadcast(self, message: Message) -> None:
        self.sent.append((None, message))

    def send_to(self, index: int, message: Message) -> None:
        self.sent.append((index, message))

    def fetch(self, effect: FetchBlocks) -> None:
        self.fetched.append(effect)

    def gossip_again(self) -> None:
        self.gossiped += 1

    def seen_by(self, index: int) -> list[Message]:
        """What one other producer got, in order."""
        return [message for receiver, message in self.sent if receiver in (None, index)]


@dataclass
class Own:
    """What the liar knows of its node."""

    chain_id: bytes = CHAIN_ID
    epoch: int = 0
    round: int = 5
    index: int | None = LIAR
    producers_count: int = COUNT
    headers: dict[bytes, Header] = field(default_factory=lambda: {GENESIS.block_id: GENESIS.header})
    raw: list[tuple[int, bytes]] = field(default_factory=list)
    high_qc: QuorumCertificate = field(default_factory=lambda: qc_of(GENESIS.block_id, 0))

    def header(self, block_id: bytes) -> Header | None:
        return self.headers.get(block_id)

    def send_raw(self, kind: int, payload: bytes) -> None:
        self.raw.append((kind, payload))


def qc_of(block_id: bytes, round_number: int) -> QuorumCertificate:
    """A genuine certificate of the first three producers (none for round 0)."""
    votes = [sign_vote(KEYS[index], CHAIN_ID, 0, round_number, block_id, index) for index in range(3)]
    signed = tuple(IndexedSignature(index=vote.index, signature=vote.signature) for vote in votes)
    return QuorumCertificate(epoch=0, round=round_number, block_id=block_id, votes=signed if round_number else ())


def proposal(round_number: int = 5, transactions: int = 1) -> Proposal:
    """The honest block of the liar's node, on genesis."""
    order = BuildBlock(
        epoch=0,
        round=round_number,
        height=1,
        parent_id=GENESIS.block_id,
        parent_timestamp_ms=GENESIS.header.timestamp_ms,
        qc=qc_of(GENESIS.block_id, 0),
        tc=None,
        producer=LIAR,
        empty=not transactions,
    )
    wires = tuple(make_transaction(number) for number in range(transactions))
    return Proposal(block=build_block(order, GENESIS.header, wires, KEYS[LIAR], NOW_MS))


def vote(block_id: bytes, round_number: int = 5) -> Vote:
    return sign_vote(KEYS[LIAR], CHAIN_ID, 0, round_number, block_id, LIAR)


def timeout(round_number: int, qc: QuorumCertificate) -> Timeout:
    return sign_timeout(KEYS[LIAR], CHAIN_ID, round_number, LIAR, qc, None, 0)


def liar(
    name: str, own: Own | None = None, seed: int = 1, ring: ColludingNodes | None = None
) -> tuple[Behaviour, Kept]:
    kept = Kept()
    behaviour = make_behaviour(
        name, inner=kept, own=own or Own(), key=KEYS[LIAR], chance=Random(seed), accomplices=ring
    )
    return behaviour, kept

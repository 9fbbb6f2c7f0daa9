"""What all behaviours share: an outbox around the honest one, and the liar's own pen."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from random import Random
from typing import Any, ClassVar, Protocol, TypeVar

import msgspec

from consensus.chain.block import Block, Header, QuorumCertificate, TimeoutCertificate
from consensus.chain.messages import Timeout, Vote, sign_block, sign_timeout, sign_vote
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.protocol.effects import FetchBlocks, Message
from node.consensus.engine import Outbox

TICK_MS = 50
REMEMBERED_MAX_COUNT = 64
_ID_BYTES = 32

K = TypeVar("K")
V = TypeVar("V")


class OwnNode(Protocol):
    """What a liar knows of its own node. All of it may change from one epoch to the next, but the chain."""

    @property
    def chain_id(self) -> bytes:
        """The chain's 32-byte id."""
        ...

    @property
    def epoch(self) -> int:
        """The epoch that the node is in."""
        ...

    @property
    def round(self) -> int:
        """The round that the node is in."""
        ...

    @property
    def index(self) -> int | None:
        """The node's place in the schedule, or None if it has none (now)."""
        ...

    @property
    def producers_count(self) -> int:
        """How many producers the schedule has."""
        ...

    @property
    def high_qc(self) -> QuorumCertificate:
        """The highest certificate that the node knows."""
        ...

    def header(self, block_id: bytes) -> Header | None:
        """Return the header of a block that is not final yet, or of the finalized head; None for any other."""
        ...

    def send_raw(self, kind: int, payload: bytes) -> None:
        """Send bytes as a frame of this kind to all peers, whatever they are."""
        ...


class Accomplices:
    """What dishonest nodes know of each other's lies: the blocks that were proposed in each round."""

    def __init__(self) -> None:
        self._blocks: OrderedDict[tuple[int, int], list[bytes]] = OrderedDict()

    def tell(self, epoch: int, round_number: int, block_id: bytes) -> None:
        """Let the others know of a block."""
        known = self._blocks.setdefault((epoch, round_number), [])
        if block_id not in known:
            known.append(block_id)
        while len(self._blocks) > REMEMBERED_MAX_COUNT:
            self._blocks.popitem(last=False)

    def rivals(self, epoch: int, round_number: int, block_id: bytes) -> list[bytes]:
        """Return the blocks of a round other than this one."""
        return [known for known in self._blocks.get((epoch, round_number), []) if known != block_id]


@dataclass(frozen=True, slots=True)
class Liar:
    """Who lies: what it knows of its node, its genuine producer key, where its chance comes from, its accomplices."""

    own: OwnNode
    key: PrivateKey
    chance: Random
    accomplices: Accomplices


class Behaviour:
    """An outbox that passes everything on. Each behaviour overrides what it lies about."""

    name: ClassVar[str] = ""
    bends_clock: ClassVar[bool] = False

    def __init__(self, inner: Outbox, liar: Liar) -> None:
        self._inner = inner
        self._own = liar.own
        self._key = liar.key
        self._chance = liar.chance
        self._accomplices = liar.accomplices

    # Outbox

    def broadcast(self, message: Message) -> None:
        """Send to all peers."""
        self._inner.broadcast(message)

    def send_to(self, index: int, message: Message) -> None:
        """Send to one producer."""
        self._inner.send_to(index, message)

    def fetch(self, effect: FetchBlocks) -> None:
        """Ask producers for blocks."""
        self._inner.fetch(effect)

    def gossip_again(self) -> None:
        """Send the waiting transactions again."""
        self._inner.gossip_again()

    def tick(self) -> None:
        """Do what is done by the clock, not by occasion: called every TICK_MS."""
        if isinstance(self._inner, Behaviour):
            self._inner.tick()

    # The pen

    def others(self) -> list[int]:
        """Return the indexes of the other producers."""
        return [index for index in range(self._own.producers_count) if index != self._own.index]

    def halves(self) -> tuple[list[int], list[int]]:
        """Return the other producers as two halves, drawn by chance; the second is the larger one."""
        others = self.others()
        self._chance.shuffle(others)
        middle = len(others) // 2
        return sorted(others[:middle]), sorted(others[middle:])

    def is_own(self, block: Block) -> bool:
        """Tell whether a block is this producer's own proposal (a node also passes on those of others)."""
        return block.header.producer == self._own.index

    def rewrite(self, block: Block, *, transactions: tuple[bytes, ...] | None = None, **changes: Any) -> Block:
        """Return the block with other header fields (and transactions), genuinely signed."""
        header = msgspec.structs.replace(block.header, **changes)
        data = encode(header)
        return Block(
            header_bytes=data,
            signature=sign_block(self._key, self._own.chain_id, header.epoch, header.round, sha256(data)),
            transactions=block.transactions if transactions is None else transactions,
        )

    def vote_for(self, vote: Vote, block_id: bytes) -> Vote:
        """Return a genuine vote of the same round for another block."""
        return sign_vote(self._key, self._own.chain_id, vote.epoch, vote.round, block_id, vote.index)

    def timeout_with(
        self, timeout: Timeout, qc: QuorumCertificate, entered_by: TimeoutCertificate | None, round_number: int = 0
    ) -> Timeout:
        """Return a genuinely signed timeout with other certificates (and of another round, if one is given)."""
        return sign_timeout(
            self._key,
            self._own.chain_id,
            round_number or timeout.round,
            timeout.index,
            qc,
            entered_by,
            timeout.epoch,
        )

    def made_up_id(self) -> bytes:
        """Return the id of a block that nobody made."""
        return self._chance.randbytes(_ID_BYTES)


class Remembered(OrderedDict[K, V]):
    """The newest few lies, so that a word said again is the same word."""

    def keep(self, key: K, value: V) -> V:
        """Remember and return a value."""
        self[key] = value
        while len(self) > REMEMBERED_MAX_COUNT:
            self.popitem(last=False)
        return value

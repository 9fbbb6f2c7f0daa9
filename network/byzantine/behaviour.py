"""Common base of behaviours: an outbox around the honest one, and what a liar sees of its own node."""

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
from consensus.protocol.core import Core
from consensus.protocol.effects import FetchBlocks, Message
from node.consensus.engine import Engine, Outbox
from node.p2p.wire import FrameKind

TICK_MS = 50
REMEMBERED_MAX_COUNT = 64
_ID_BYTES = 32

K = TypeVar("K")
V = TypeVar("V")


class OwnNode(Protocol):
    """A liar's view of its own node; all but the chain may change per epoch."""

    @property
    def chain_id(self) -> bytes:
        """32 bytes."""
        ...

    @property
    def epoch(self) -> int: ...

    @property
    def round(self) -> int: ...

    @property
    def index(self) -> int | None:
        """In the schedule."""
        ...

    @property
    def producers_count(self) -> int: ...

    @property
    def high_qc(self) -> QuorumCertificate: ...

    def header(self, block_id: bytes) -> Header | None:
        """Of an unfinalized block or finalized head."""
        ...

    def send_raw(self, kind: int, payload: bytes) -> None:
        """To all peers."""
        ...


class ColludingNodes:
    """Shared knowledge of dishonest nodes: blocks proposed in each round."""

    def __init__(self) -> None:
        self._blocks: OrderedDict[tuple[int, int], list[bytes]] = OrderedDict()

    def tell(self, epoch: int, round_number: int, block_id: bytes) -> None:
        known = self._blocks.setdefault((epoch, round_number), [])
        if block_id not in known:
            known.append(block_id)
        while len(self._blocks) > REMEMBERED_MAX_COUNT:
            self._blocks.popitem(last=False)

    def rivals(self, epoch: int, round_number: int, block_id: bytes) -> list[bytes]:
        return [known for known in self._blocks.get((epoch, round_number), []) if known != block_id]


@dataclass(frozen=True, slots=True)
class ByzantineContext:
    """A liar's own node, genuine producer key, random source and accomplices."""

    own: OwnNode
    key: PrivateKey
    chance: Random
    accomplices: ColludingNodes


class Behaviour:
    """An outbox that forwards everything; subclasses override what they lie about."""

    name: ClassVar[str] = ""
    bends_clock: ClassVar[bool] = False

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        self._inner = inner
        self._own = liar.own
        self._key = liar.key
        self._chance = liar.chance
        self._accomplices = liar.accomplices

    # Outbox

    def broadcast(self, message: Message) -> None:
        self._inner.broadcast(message)

    def send_to(self, index: int, message: Message) -> None:
        self._inner.send_to(index, message)

    def fetch(self, effect: FetchBlocks) -> None:
        self._inner.fetch(effect)

    def gossip_again(self) -> None:
        self._inner.gossip_again()

    def tick(self) -> None:
        """Called every TICK_MS."""
        if isinstance(self._inner, Behaviour):
            self._inner.tick()

    # The pen

    def others(self) -> list[int]:
        return [index for index in range(self._own.producers_count) if index != self._own.index]

    def halves(self) -> tuple[list[int], list[int]]:
        """The other producers at random, the second half larger."""
        others = self.others()
        self._chance.shuffle(others)
        middle = len(others) // 2
        return sorted(others[:middle]), sorted(others[middle:])

    def is_own(self, block: Block) -> bool:
        return block.header.producer == self._own.index

    def rewrite(self, block: Block, *, transactions: tuple[bytes, ...] | None = None, **changes: Any) -> Block:
        header = msgspec.structs.replace(block.header, **changes)
        data = encode(header)
        return Block(
            header_bytes=data,
            signature=sign_block(self._key, self._own.chain_id, header.epoch, header.round, sha256(data)),
            transactions=block.transactions if transactions is None else transactions,
        )

    def vote_for(self, vote: Vote, block_id: bytes) -> Vote:
        return sign_vote(self._key, self._own.chain_id, vote.epoch, vote.round, block_id, vote.index)

    def timeout_with(
        self, timeout: Timeout, qc: QuorumCertificate, entered_by: TimeoutCertificate | None, round_number: int = 0
    ) -> Timeout:
        """Genuinely signed, with other certificates; round 0 keeps the round."""
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
        return self._chance.randbytes(_ID_BYTES)


class BoundedCache(OrderedDict[K, V]):
    """The newest lies, so that repetitions are identical."""

    def keep(self, key: K, value: V) -> V:
        self[key] = value
        while len(self) > REMEMBERED_MAX_COUNT:
            self.popitem(last=False)
        return value


class RawLinks(Protocol):
    """The part of a node's links that floods use."""

    def broadcast(self, kind: FrameKind, payload: bytes) -> None: ...


class EngineView:
    """`OwnNode` of a running engine, followed across epochs."""

    def __init__(self, engine: Engine, chain_id: bytes, links: RawLinks) -> None:
        self._engine = engine
        self._links = links
        self.chain_id = chain_id

    @property
    def _core(self) -> Core:
        return self._engine.core

    @property
    def epoch(self) -> int:
        return self._core.epoch

    @property
    def round(self) -> int:
        return self._core.round

    @property
    def index(self) -> int | None:
        return self._core.index

    @property
    def producers_count(self) -> int:
        return len(self._core.schedule.producers)

    @property
    def high_qc(self) -> QuorumCertificate:
        return self._core.high_qc

    def header(self, block_id: bytes) -> Header | None:
        if block_id == self._core.finalized_id:
            return self._core.finalized
        block = self._core.block(block_id)
        return None if block is None else block.header

    def send_raw(self, kind: int, payload: bytes) -> None:
        self._links.broadcast(FrameKind(kind), payload)

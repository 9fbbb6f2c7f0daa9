"""The node's epoch, and how others are helped into it.

Messages of one epoch never count in another. The stored head decides the epoch.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import structlog

from consensus.chain.block import (
    Block,
    EpochProof,
    FinalityProof,
    QuorumCertificate,
    certificate_of,
    genesis_certificate,
)
from consensus.chain.epoch_settings import Epoch, compute_epoch_hash
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import verify_finality
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.hashing import sha256
from node.p2p.wire import FrameKind
from node.storage.ledger_store import LedgerSnapshot, LedgerStore

ANNOUNCEMENTS_MAX_COUNT = 120
ANSWER_INTERVAL_MS = 100
BUFFERED_MESSAGES_PER_PEER_MAX_COUNT = 64
BUFFERED_MESSAGES_PER_PEER_MAX_BYTES = 2 * 1024 * 1024

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class EpochStart:
    """An epoch's start: its decisions and the block its round 0 certifies."""

    epoch: Epoch
    round_zero_id: bytes
    proof_bytes: bytes = b""
    """The `EpochProof` that began it; empty for epoch 0."""

    @property
    def number(self) -> int:
        return self.epoch.number

    @cached_property
    def schedule(self) -> Schedule:
        return Schedule.of(self.epoch)


def start_of_genesis(genesis: Genesis) -> EpochStart:
    return EpochStart(epoch=genesis.epoch, round_zero_id=genesis.block_id)


def read_start(snapshot: LedgerSnapshot, genesis: Genesis, number: int) -> EpochStart:
    """Raises STORAGE_DAMAGED, also for another epoch's proof."""
    if number == 0:
        return start_of_genesis(genesis)
    data = snapshot.epoch_proof(number)
    if data is None:
        raise BlockRobotError("STORAGE_DAMAGED", f"The ledger does not hold the proof that began epoch {number}.")
    proof = decode(data, EpochProof)
    if proof.epoch.number != number:
        raise BlockRobotError("STORAGE_DAMAGED", f"What the ledger holds as the proof of epoch {number} is another's.")
    return EpochStart(epoch=proof.epoch, round_zero_id=sha256(proof.finality.header_bytes), proof_bytes=data)


def verify_following(proof: EpochProof, start: EpochStart, chain_id: bytes) -> None:
    """Check that the proof ends this epoch and names the next.

    Raises PROOF_INVALID, CERTIFICATE_INVALID, ENCODING_*.
    """
    header = verify_finality(proof.finality, start.schedule, chain_id, start.round_zero_id)
    if proof.epoch.number != start.number + 1 or header.next_schedule_hash != compute_epoch_hash(proof.epoch):
        raise BlockRobotError("PROOF_INVALID", "The final block does not begin the epoch that it is shown for.")


@dataclass(frozen=True, slots=True)
class Head:
    """Where a node continues: epoch, newest stored block, its certificate."""

    start: EpochStart
    block: Block
    qc: QuorumCertificate


def read_head(snapshot: LedgerSnapshot, genesis: Genesis) -> Head:
    """Raises STORAGE_DAMAGED."""
    position = snapshot.position
    data = None if position is None else snapshot.block(position.height)
    if position is None or data is None:
        raise BlockRobotError("STORAGE_DAMAGED", "The ledger does not hold its newest block.")
    block = decode(data, Block)
    header = block.header
    is_boundary = header.next_schedule_hash is not None
    start = read_start(snapshot, genesis, header.epoch + is_boundary)
    if is_boundary or position.height == 0:
        return Head(start, block, genesis_certificate(position.block_id, start.number))
    return Head(start, block, certificate_of(decode(snapshot.finality, FinalityProof)))


class EpochTransition:
    """Brings producers into a new epoch; keeps its early messages. Event loop only."""

    def __init__(
        self, *, start: EpochStart, ledger: LedgerStore, send: Callable[[str, FrameKind, bytes], bool]
    ) -> None:
        """`send` sends a frame; returns whether the peer is connected."""
        self.start = start
        self._ledger = ledger
        self._send = send
        self._loop = asyncio.get_running_loop()
        self._silent: set[str] = set()
        self._tries_left = 0
        self._timer: asyncio.TimerHandle | None = None
        self._answered: dict[str, float] = {}
        self._awaited: set[str] = set()
        self._kept: dict[str, deque[tuple[FrameKind, bytes]]] = {}

    def begin(self, start: EpochStart, producers: Iterable[str]) -> list[tuple[str, FrameKind, bytes]]:
        """Begin an epoch; notify its producers until each answers; return kept messages."""
        self.start = start
        self._answered.clear()
        self._silent = set(producers)
        self._awaited |= self._silent
        self._tries_left = ANNOUNCEMENTS_MAX_COUNT
        self._tell()
        kept, self._kept = self._kept, {}
        return [(peer, kind, payload) for peer, messages in kept.items() for kind, payload in messages]

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def record_message_from(self, peer: str) -> bool:
        """Note a peer's message in this epoch; return whether it just entered (R25)."""
        self._silent.discard(peer)
        is_first = peer in self._awaited
        self._awaited.discard(peer)
        return is_first

    @property
    def silent(self) -> frozenset[str]:
        return frozenset(self._silent)

    def _tell(self) -> None:
        self.stop()
        if not self._silent or self._tries_left == 0:
            return
        self._tries_left -= 1
        for peer in sorted(self._silent):
            self._send(peer, FrameKind.EPOCH, self.start.proof_bytes)
        self._timer = self._loop.call_later(self.start.epoch.settings.base_timeout_ms / 1000, self._tell)

    def answer(self, peer: str, epoch: int) -> bool:
        """Send a peer in an earlier epoch its ending proof, rate-limited; return whether sent."""
        now = self._loop.time()
        if self._answered.get(peer, now - 1.0) > now - ANSWER_INTERVAL_MS / 1000:
            return False
        self._answered[peer] = now
        self._awaited.add(peer)
        with self._ledger.snapshot() as snapshot:
            proof = snapshot.epoch_proof(epoch + 1)
        return proof is not None and self._send(peer, FrameKind.EPOCH, proof)

    def keep(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        """Keep a next-epoch message; the same peer's oldest are evicted."""
        messages = self._kept.setdefault(peer, deque())
        messages.append((kind, payload))
        size_bytes = sum(len(message) for _, message in messages)
        while len(messages) > BUFFERED_MESSAGES_PER_PEER_MAX_COUNT or size_bytes > BUFFERED_MESSAGES_PER_PEER_MAX_BYTES:
            size_bytes -= len(messages.popleft()[1])

"""The epoch that a node is in, and how others are helped into it. Must never let a word of one epoch count in another.

The head of the synced store decides the epoch, also after a restart: whoever holds a boundary is in the epoch that the
boundary begins. A word of an earlier epoch is answered with the proof that ends it, a word of a later one is kept for a
moment (most likely one's own boundary is about to be stored) and then taken as a sign that one is behind.
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

HANDOVER_TRIES_MAX_COUNT = 120
ANSWER_INTERVAL_MS = 100
KEPT_WORDS_OF_PEER_MAX_COUNT = 64
KEPT_WORDS_OF_PEER_MAX_BYTES = 2 * 1024 * 1024

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class EpochStart:
    """Where an epoch begins: what it decides, and the block that its round 0 certifies (genesis or the boundary)."""

    epoch: Epoch
    round_zero_id: bytes
    proof_bytes: bytes = b""
    """The `EpochProof` that began it; empty for epoch 0."""

    @property
    def number(self) -> int:
        """The number of the epoch."""
        return self.epoch.number

    @cached_property
    def schedule(self) -> Schedule:
        """Who votes in it."""
        return Schedule.of(self.epoch)


def start_of_genesis(genesis: Genesis) -> EpochStart:
    """Return how epoch 0 begins."""
    return EpochStart(epoch=genesis.epoch, round_zero_id=genesis.block_id)


def read_start(snapshot: LedgerSnapshot, genesis: Genesis, number: int) -> EpochStart:
    """Return how an epoch began that the ledger has reached.

    Raises STORAGE_DAMAGED if it does not say, or tells of another epoch: nobody may be let into one by the wrong proof.
    """
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
    """Check that the proof ends the epoch of `start` and names the next one.

    Raises PROOF_INVALID, CERTIFICATE_INVALID, ENCODING_*.
    """
    header = verify_finality(proof.finality, start.schedule, chain_id, start.round_zero_id)
    if proof.epoch.number != start.number + 1 or header.next_schedule_hash != compute_epoch_hash(proof.epoch):
        raise BlockRobotError("PROOF_INVALID", "The final block does not begin the epoch that it is shown for.")


@dataclass(frozen=True, slots=True)
class Head:
    """Where a node goes on: the epoch, the newest stored block, and the certificate for it in that epoch."""

    start: EpochStart
    block: Block
    qc: QuorumCertificate


def read_head(snapshot: LedgerSnapshot, genesis: Genesis) -> Head:
    """Return where a node with this ledger goes on. Raises STORAGE_DAMAGED."""
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


class Handover:
    """Brings the producers of a new epoch into it, and keeps early words of the next one. All on the event loop."""

    def __init__(
        self, *, start: EpochStart, ledger: LedgerStore, send: Callable[[str, FrameKind, bytes], bool]
    ) -> None:
        """`send` sends a frame to a peer and tells whether it is connected."""
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
        """A new epoch began here: tell its producers until each has spoken in it; return the words kept for it."""
        self.start = start
        self._answered.clear()
        self._silent = set(producers)
        self._awaited |= self._silent
        self._tries_left = HANDOVER_TRIES_MAX_COUNT
        self._tell()
        kept, self._kept = self._kept, {}
        return [(peer, kind, payload) for peer, words in kept.items() for kind, payload in words]

    def stop(self) -> None:
        """Stop telling."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def note_word(self, peer: str) -> bool:
        """A peer spoke in this epoch, or says that it has reached it; tell whether it has just come into it (R25).

        It has if it was to be heard since the epoch began here, or spoke of an earlier one. Who connects is greeted anyway.
        """
        self._silent.discard(peer)
        is_first = peer in self._awaited
        self._awaited.discard(peer)
        return is_first

    @property
    def silent(self) -> frozenset[str]:
        """The producers of this epoch that have not been heard in it since it began here."""
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
        """Send a peer that is in an earlier epoch the proof that ends it, not too often; tell whether it was sent.

        It comes into this epoch anew only as often: whoever mixes words of two epochs is not greeted at each of them.
        """
        now = self._loop.time()
        if self._answered.get(peer, now - 1.0) > now - ANSWER_INTERVAL_MS / 1000:
            return False
        self._answered[peer] = now
        self._awaited.add(peer)
        with self._ledger.snapshot() as snapshot:
            proof = snapshot.epoch_proof(epoch + 1)
        return proof is not None and self._send(peer, FrameKind.EPOCH, proof)

    def keep(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        """Keep a word of the next epoch until it begins here; the oldest ones of the same peer make room."""
        words = self._kept.setdefault(peer, deque())
        words.append((kind, payload))
        size_bytes = sum(len(word) for _, word in words)
        while len(words) > KEPT_WORDS_OF_PEER_MAX_COUNT or size_bytes > KEPT_WORDS_OF_PEER_MAX_BYTES:
            size_bytes -= len(words.popleft()[1])

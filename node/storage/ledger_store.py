"""Interface of the finalized ledger's storage; blocks, receipts and proofs are opaque bytes.

A commit is atomic and durable on return.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.encoding import Wire
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.primitives.trie import Proof

REPLAY_WINDOW_KEPT_MS = 2 * TRANSACTION_LIFETIME_MAX_MS
"""How long the store remembers which txids a block held, by block timestamps: twice what replay protection needs."""


class Position(Wire, frozen=True):
    """The newest finalized block: height, 32-byte id, state root after it, timestamp."""

    height: int
    block_id: bytes
    state_root: bytes
    timestamp_ms: int


@dataclass(frozen=True, slots=True)
class FinalizedBlock:
    """A block to store; `transactions` are (txid, valid_until_ms) in block order.

    A boundary brings its new epoch's proof, the k-th one that of epoch k.
    """

    height: int
    block_id: bytes
    block_bytes: bytes
    receipts_bytes: bytes
    timestamp_ms: int
    state_root: bytes
    transactions: Sequence[tuple[bytes, int]] = ()
    state_writes: Mapping[bytes, bytes | None] = field(default_factory=dict)
    page_writes: Mapping[bytes, bytes | None] = field(default_factory=dict)
    events: Sequence[bytes] = ()
    epoch_proof_bytes: bytes = b""

    @property
    def position(self) -> Position:
        return Position(self.height, self.block_id, self.state_root, self.timestamp_ms)


@dataclass(frozen=True, slots=True, order=True)
class TransactionLocation:
    """A finalized transaction's block height and index within it."""

    height: int
    index: int


class RecentTransaction(NamedTuple):
    """A replay-window txid, with its block's height and timestamp and its expiry (ms)."""

    txid: bytes
    height: int
    timestamp_ms: int
    valid_until_ms: int


class RecentBlock(NamedTuple):
    """A block's replay-window share: height, timestamp (ms), (txid, valid_until_ms) in block order."""

    height: int
    timestamp_ms: int
    transactions: tuple[tuple[bytes, int], ...]


class KeptBlock(NamedTuple):
    """A block without body: its replay-window share, id and reduced bytes."""

    recent: RecentBlock
    block_id: bytes
    header_bytes: bytes


@dataclass(frozen=True, slots=True, order=True)
class EventCursor:
    """A place among all events: block height and index in the block."""

    height: int
    index: int

    @property
    def next(self) -> EventCursor:
        return EventCursor(self.height, self.index + 1)


class LedgerSnapshot(Protocol):
    """An immutable `StateView` at one position; a context manager, one thread at a time."""

    @property
    def position(self) -> Position | None:
        """The newest block, or None before genesis."""
        ...

    @property
    def state_root(self) -> bytes:
        """The 32-byte state root (that of the empty state before genesis)."""
        ...

    @property
    def finality(self) -> bytes:
        """The newest block's finality proof, as given to `commit`."""
        ...

    def get(self, key: bytes) -> bytes | None: ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` (flat key, encoded value) pairs, in key order."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield the pairs from `start` up to but without `end`, in key order."""
        ...

    def page(self, path: bytes) -> bytes | None: ...

    def prove(self, key: bytes) -> Proof:
        """Return a flat key's presence or absence proof under `state_root`."""
        ...

    def block(self, height: int) -> bytes | None: ...

    def block_height(self, block_id: bytes) -> int | None: ...

    def iter_blocks(self, from_height: int, limit: int) -> Iterator[tuple[int, bytes]]: ...

    @property
    def earliest_height(self) -> int:
        """The height from which all blocks, receipts and events are here (0: unpruned)."""
        ...

    def kept_header(self, height: int) -> bytes | None:
        """Return a pruned block's reduced bytes; None if not pruned or unknown."""
        ...

    def receipts(self, height: int) -> bytes | None: ...

    def epoch_proof(self, number: int) -> bytes | None:
        """Return the proof that began epoch `number` (1 or above), or None."""
        ...

    def locate(self, txid: bytes) -> TransactionLocation | None: ...

    def recent_txids(self, since_timestamp_ms: int) -> list[RecentTransaction]:
        """Return transactions since this timestamp, oldest block first, within `REPLAY_WINDOW_KEPT_MS` at least."""
        ...

    def iter_recent(self, since_timestamp_ms: int) -> Iterator[RecentBlock]:
        """Yield replay-window blocks, and the one before, since this timestamp, oldest first, empty ones too."""
        ...

    def events(self, from_cursor: EventCursor, limit: int) -> list[tuple[EventCursor, bytes]]:
        """Return up to `limit` events with places, from this place (inclusive), in order."""
        ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class LedgerStore(Protocol):
    """The finalized ledger of one node."""

    @property
    def position(self) -> Position | None: ...

    async def commit(self, blocks: Sequence[FinalizedBlock], finality: bytes) -> Position:
        """Store consecutive blocks atomically; return the position once durable.

        `finality` proves the last one. Raises ValueError, STORAGE_BUSY, STORAGE_FULL, STORAGE_UNWRITABLE; nothing is
        then stored.
        """
        ...

    async def prune(self, below_height: int, reduce: Callable[[bytes], bytes]) -> int:
        """Drop bodies, receipts and events below a height, keeping `reduce(block bytes)`.

        Each call drops a bounded number and returns `earliest_height`; repeat. The newest block stays. Raises as
        `commit`.
        """
        ...

    def snapshot(self) -> LedgerSnapshot:
        """Open the current ledger; close it soon. Raises STORAGE_BUSY if too many are open."""
        ...

    async def close(self) -> None:
        """Finish pending commits and close; idempotent."""
        ...


class LedgerRestore(Protocol):
    """A new store built from a snapshot; no ledger before `finish`."""

    def put_state(self, rows: Sequence[tuple[bytes, bytes]]) -> None:
        """In flat key order."""
        ...

    def put_kept(self, blocks: Sequence[KeptBlock]) -> None:
        """Add the next replay-window blocks, oldest first, without the newest (see `finish`)."""
        ...

    def finish(self, genesis_id: bytes, head: FinalizedBlock, finality: bytes, epoch_proofs: Sequence[bytes]) -> None:
        """Durably complete the ledger with newest block `head`. Raises SNAPSHOT_DAMAGED for another state."""
        ...

    def abandon(self) -> None:
        """Discard what was added; no effect after `finish`."""
        ...


def check_order(position: Position | None, blocks: Sequence[FinalizedBlock]) -> None:
    """Raise ValueError unless blocks follow the position consecutively (0 after None) and name txids."""
    if not blocks:
        raise ValueError("a commit needs at least one block")
    height = 0 if position is None else position.height + 1
    timestamp_ms = -1 if position is None else position.timestamp_ms
    for block in blocks:
        if block.height != height:
            raise ValueError(f"the store expects block {height}, not {block.height}")
        if block.timestamp_ms <= timestamp_ms:
            raise ValueError(f"block {height} is not later than the block before it")
        if any(len(txid) != HASH_SIZE_BYTES for txid, _ in block.transactions):
            raise ValueError(f"block {height} names a txid that is not of {HASH_SIZE_BYTES} bytes")
        height, timestamp_ms = height + 1, block.timestamp_ms

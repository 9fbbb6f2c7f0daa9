"""What a node needs of the place where the finalized ledger is kept.

Two stores keep these promises under one test suite: `lmdb_store` on disk and `memory_store` for tests and the
simulator. Blocks, receipts, events and proofs of finality are opaque bytes here. A commit is one atomic step: state,
trie pages, blocks, receipts, indexes and position move together, and when it returns they survive a power cut. Of a
pruned block only what its owner reduced it to is kept, its id, where its transactions were, and its share of the replay
window.
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
    """The newest finalized block: its height, 32-byte id, the 32-byte state root after it, its timestamp."""

    height: int
    block_id: bytes
    state_root: bytes
    timestamp_ms: int


@dataclass(frozen=True, slots=True)
class FinalizedBlock:
    """One block to be stored, with all that it changes. `transactions` are (txid, valid_until_ms) in block order.

    A boundary brings the proof of the epoch that it begins; the k-th such proof of a ledger is that of epoch k.
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
        """The position of a ledger that ends with this block."""
        return Position(self.height, self.block_id, self.state_root, self.timestamp_ms)


@dataclass(frozen=True, slots=True, order=True)
class TransactionLocation:
    """Where a finalized transaction stands: the block's height and the index within it."""

    height: int
    index: int


class RecentTransaction(NamedTuple):
    """A txid of the replay window, with its block's height and timestamp and its own expiry (both ms)."""

    txid: bytes
    height: int
    timestamp_ms: int
    valid_until_ms: int


class RecentBlock(NamedTuple):
    """One block's share of the replay window: height, timestamp (ms), and (txid, valid_until_ms) in block order."""

    height: int
    timestamp_ms: int
    transactions: tuple[tuple[bytes, int], ...]


class KeptBlock(NamedTuple):
    """What a store knows of a block whose body it does not hold: its share of the window, its id, its reduced bytes."""

    recent: RecentBlock
    block_id: bytes
    header_bytes: bytes


@dataclass(frozen=True, slots=True, order=True)
class EventCursor:
    """A place in the sequence of all events: block height and index among the block's events."""

    height: int
    index: int

    @property
    def next(self) -> EventCursor:
        """The first place after this one: from there nothing is lost and nothing comes twice."""
        return EventCursor(self.height, self.index + 1)


class LedgerSnapshot(Protocol):
    """The ledger at one position. It does not change while open; one thread at a time may use it.

    A context manager: it closes itself at the end. It is a `StateView`, so blocks can be executed on it.
    """

    @property
    def position(self) -> Position | None:
        """The newest block of this snapshot, or None in a store that holds no genesis yet."""
        ...

    @property
    def state_root(self) -> bytes:
        """The 32-byte root of the state (that of the empty state before genesis)."""
        ...

    @property
    def finality(self) -> bytes:
        """The proof that the newest block is final, as given to `commit`."""
        ...

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs of flat key and encoded value under the prefix, in key order."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield the pairs from `start` up to but without `end`, in key order; see `StateReader`."""
        ...

    def page(self, path: bytes) -> bytes | None:
        """Return the trie page under a nibble path, or None."""
        ...

    def prove(self, key: bytes) -> Proof:
        """Return the proof of a flat key's presence or absence under `state_root`."""
        ...

    def block(self, height: int) -> bytes | None:
        """Return the bytes of the block of this height, or None."""
        ...

    def block_height(self, block_id: bytes) -> int | None:
        """Return the height of the finalized block with this id, or None."""
        ...

    def iter_blocks(self, from_height: int, limit: int) -> Iterator[tuple[int, bytes]]:
        """Yield up to `limit` pairs of height and block bytes, from this height upwards."""
        ...

    @property
    def earliest_height(self) -> int:
        """The height from which on all blocks, receipts and events are here; 0 unless there was pruning."""
        ...

    def kept_header(self, height: int) -> bytes | None:
        """Return what is kept of the pruned block of this height, or None if it was not pruned or is not known."""
        ...

    def receipts(self, height: int) -> bytes | None:
        """Return the receipts of the block of this height, or None."""
        ...

    def epoch_proof(self, number: int) -> bytes | None:
        """Return the proof that began epoch `number` (1 or above), as its boundary brought it, or None."""
        ...

    def locate(self, txid: bytes) -> TransactionLocation | None:
        """Return where a finalized transaction stands, or None."""
        ...

    def recent_txids(self, since_timestamp_ms: int) -> list[RecentTransaction]:
        """Return the transactions of blocks with this timestamp or a later one, oldest block first.

        Reaches back `REPLAY_WINDOW_KEPT_MS` from the newest block at least.
        """
        ...

    def iter_recent(self, since_timestamp_ms: int) -> Iterator[RecentBlock]:
        """Yield the replay window block by block, empty ones too, from this timestamp on, oldest first."""
        ...

    def events(self, from_cursor: EventCursor, limit: int) -> list[tuple[EventCursor, bytes]]:
        """Return up to `limit` events with their places, from this place on (inclusive), in order."""
        ...

    def close(self) -> None:
        """Let go of the snapshot; it cannot be read any more. Closing twice is harmless."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class LedgerStore(Protocol):
    """The finalized ledger of one node."""

    @property
    def position(self) -> Position | None:
        """The newest block that is safe in the store, or None before genesis."""
        ...

    async def commit(self, blocks: Sequence[FinalizedBlock], finality: bytes) -> Position:
        """Store consecutive finalized blocks, oldest first, in one atomic step; return the new position once durable.

        `finality` proves the last of them final. Several commits may wait at once; they are written in the order of
        the calls. Raises ValueError for blocks that do not follow the position, STORAGE_BUSY if too many wait,
        STORAGE_FULL and STORAGE_UNWRITABLE if the disk takes no more. After an error nothing of the commit is stored.
        """
        ...

    async def prune(self, below_height: int, reduce: Callable[[bytes], bytes]) -> int:
        """Drop bodies, receipts and events of blocks below a height, the oldest first; return `earliest_height` then.

        One call drops a bounded number of blocks in one atomic step: call again until it returns `below_height`. The
        newest block always stays. Of each block `reduce(block bytes)` is kept. Raises as `commit` does.
        """
        ...

    def snapshot(self) -> LedgerSnapshot:
        """Open the ledger as it is now. Close it soon. Raises STORAGE_BUSY if too many are open."""
        ...

    async def close(self) -> None:
        """Finish the commits that wait, then let go of the store. Closing twice is harmless."""
        ...


class LedgerRestore(Protocol):
    """A new store in the making, out of the parts of a snapshot. Nothing of it is a ledger before `finish`."""

    def put_state(self, rows: Sequence[tuple[bytes, bytes]]) -> None:
        """Take the next rows of the state, in the order of their flat keys."""
        ...

    def put_kept(self, blocks: Sequence[KeptBlock]) -> None:
        """Take the next blocks of the replay window, oldest first; the newest one comes with `finish`."""
        ...

    def finish(self, genesis_id: bytes, head: FinalizedBlock, finality: bytes, epoch_proofs: Sequence[bytes]) -> None:
        """Make it a ledger whose newest block is `head`, durably. Raises SNAPSHOT_DAMAGED if the state is not its own."""
        ...

    def abandon(self) -> None:
        """Let go of what was taken so far; after `finish` this does nothing."""
        ...


def check_order(position: Position | None, blocks: Sequence[FinalizedBlock]) -> None:
    """Raise ValueError unless the blocks are consecutive, follow the position (height 0 follows None), name txids."""
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

"""A ledger store in memory, for tests and the simulator. Must never differ from the one on disk but in durability.

A snapshot shares the tables with the store until the next commit, which then works on a copy: nothing that a reader
holds open ever changes.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Self

from consensus.errors import BlockRobotError
from consensus.primitives.trie import Proof
from contracts.state.view import MemoryState
from node.storage.ledger_store import (
    REPLAY_WINDOW_KEPT_MS,
    EventCursor,
    FinalizedBlock,
    Position,
    RecentTransaction,
    TransactionLocation,
    check_order,
)


class _Tables:
    """All that the store holds at one position."""

    def __init__(self) -> None:
        self.position: Position | None = None
        self.finality = b""
        self.state = MemoryState()
        self.blocks: list[FinalizedBlock] = []
        self.heights: dict[bytes, int] = {}
        self.locations: dict[bytes, TransactionLocation] = {}
        self.epoch_proofs: list[bytes] = []
        self.readers = 0

    def copy(self) -> _Tables:
        other = _Tables()
        other.position, other.finality, other.state = self.position, self.finality, self.state.copy()
        other.blocks, other.heights = self.blocks.copy(), self.heights.copy()
        other.locations, other.epoch_proofs = self.locations.copy(), self.epoch_proofs.copy()
        return other

    def append(self, block: FinalizedBlock) -> None:
        self.position = block.position
        self.state.absorb(block.state_writes, block.page_writes, block.state_root)
        self.blocks.append(_without_writes(block))
        self.heights[block.block_id] = block.height
        if block.epoch_proof_bytes:
            self.epoch_proofs.append(block.epoch_proof_bytes)
        for index, (txid, _) in enumerate(block.transactions):
            self.locations[txid] = TransactionLocation(block.height, index)


class MemorySnapshot:
    """The ledger at one position; see `LedgerSnapshot`."""

    def __init__(self, tables: _Tables) -> None:
        self._tables: _Tables | None = tables
        tables.readers += 1

    @property
    def _open(self) -> _Tables:
        if self._tables is None:
            raise ValueError("the snapshot is closed")
        return self._tables

    @property
    def position(self) -> Position | None:
        """The newest block of this snapshot, or None before genesis."""
        return self._open.position

    @property
    def state_root(self) -> bytes:
        """The 32-byte root of the state."""
        return self._open.state.state_root

    @property
    def finality(self) -> bytes:
        """The proof that the newest block is final."""
        return self._open.finality

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        return self._open.state.get(key)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs under the prefix, in key order."""
        return self._open.state.scan(prefix, limit)

    def page(self, path: bytes) -> bytes | None:
        """Return the trie page under a nibble path, or None."""
        return self._open.state.page(path)

    def prove(self, key: bytes) -> Proof:
        """Return the proof of a flat key's presence or absence under `state_root`."""
        return self._open.state.prove(key)

    def _stored(self, height: int) -> FinalizedBlock | None:
        blocks = self._open.blocks
        return blocks[height] if 0 <= height < len(blocks) else None

    def block(self, height: int) -> bytes | None:
        """Return the bytes of the block of this height, or None."""
        found = self._stored(height)
        return None if found is None else found.block_bytes

    def block_height(self, block_id: bytes) -> int | None:
        """Return the height of the finalized block with this id, or None."""
        return self._open.heights.get(block_id)

    def iter_blocks(self, from_height: int, limit: int) -> Iterator[tuple[int, bytes]]:
        """Yield up to `limit` pairs of height and block bytes, from this height upwards."""
        first = max(from_height, 0)
        for block in self._open.blocks[first : first + max(limit, 0)]:
            yield block.height, block.block_bytes

    def receipts(self, height: int) -> bytes | None:
        """Return the receipts of the block of this height, or None."""
        found = self._stored(height)
        return None if found is None else found.receipts_bytes

    def epoch_proof(self, number: int) -> bytes | None:
        """Return the proof that began epoch `number` (1 or above), or None."""
        proofs = self._open.epoch_proofs
        return proofs[number - 1] if 1 <= number <= len(proofs) else None

    def locate(self, txid: bytes) -> TransactionLocation | None:
        """Return where a finalized transaction stands, or None."""
        return self._open.locations.get(txid)

    def recent_txids(self, since_timestamp_ms: int) -> list[RecentTransaction]:
        """Return the transactions of blocks with this timestamp or a later one, oldest block first."""
        tables = self._open
        if tables.position is None:
            return []
        since_ms = max(since_timestamp_ms, tables.position.timestamp_ms - REPLAY_WINDOW_KEPT_MS)
        first = bisect_left(tables.blocks, since_ms, key=lambda block: block.timestamp_ms)
        return [
            RecentTransaction(txid, block.height, block.timestamp_ms, valid_until_ms)
            for block in tables.blocks[first:]
            for txid, valid_until_ms in block.transactions
        ]

    def events(self, from_cursor: EventCursor, limit: int) -> list[tuple[EventCursor, bytes]]:
        """Return up to `limit` events with their places, from this place on (inclusive), in order."""
        found: list[tuple[EventCursor, bytes]] = []
        for block in self._open.blocks[max(from_cursor.height, 0) :]:
            for index, event in enumerate(block.events):
                if len(found) >= limit:
                    return found
                place = EventCursor(block.height, index)
                if place >= from_cursor:
                    found.append((place, event))
        return found

    def close(self) -> None:
        """Let go of the snapshot; closing twice is harmless."""
        if self._tables is not None:
            self._tables.readers -= 1
            self._tables = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class MemoryStore:
    """See `LedgerStore`. What it holds is lost with the object."""

    def __init__(self) -> None:
        self._tables = _Tables()
        self._closed = False

    @property
    def position(self) -> Position | None:
        """The newest block of the store, or None before genesis."""
        return self._tables.position

    async def commit(self, blocks: Sequence[FinalizedBlock], finality: bytes) -> Position:
        """Store consecutive finalized blocks in one step. Raises ValueError for blocks that do not follow."""
        if self._closed:
            raise BlockRobotError("STORAGE_UNWRITABLE", "The store is closed.")
        check_order(self._tables.position, blocks)
        tables = self._tables.copy() if self._tables.readers else self._tables
        for block in blocks:
            tables.append(block)
        tables.finality = finality
        self._tables = tables
        return blocks[-1].position

    def snapshot(self) -> MemorySnapshot:
        """Open the ledger as it is now."""
        if self._closed:
            raise ValueError("the store is closed")
        return MemorySnapshot(self._tables)

    async def close(self) -> None:
        """Let go of the store; closing twice is harmless."""
        self._closed = True


def _without_writes(block: FinalizedBlock) -> FinalizedBlock:
    """Return the block without its writes, which the state has absorbed, and free of the caller's containers."""
    return replace(
        block,
        transactions=tuple(block.transactions),
        state_writes={},
        page_writes={},
        events=tuple(block.events),
    )

"""A ledger store in memory, for tests and the simulator; commits copy shared tables."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
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
    KeptBlock,
    Position,
    RecentBlock,
    RecentTransaction,
    TransactionLocation,
    check_order,
)


class _Tables:
    def __init__(self) -> None:
        self.position: Position | None = None
        self.finality = b""
        self.state = MemoryState()
        self.blocks: list[FinalizedBlock] = []
        self.earliest_height = 0
        self.kept: dict[int, bytes] = {}
        self.recent: list[RecentBlock] = []
        self.heights: dict[bytes, int] = {}
        self.locations: dict[bytes, TransactionLocation] = {}
        self.epoch_proofs: list[bytes] = []
        self.readers = 0

    def copy(self) -> _Tables:
        other = _Tables()
        other.position, other.finality, other.state = self.position, self.finality, self.state.copy()
        other.blocks, other.heights = self.blocks.copy(), self.heights.copy()
        other.earliest_height, other.kept, other.recent = self.earliest_height, self.kept.copy(), self.recent.copy()
        other.locations, other.epoch_proofs = self.locations.copy(), self.epoch_proofs.copy()
        return other

    def append(self, block: FinalizedBlock) -> None:
        self.position = block.position
        self.state.absorb(block.state_writes, block.page_writes, block.state_root)
        self.blocks.append(_without_writes(block))
        self.heights[block.block_id] = block.height
        if block.epoch_proof_bytes:
            self.epoch_proofs.append(block.epoch_proof_bytes)
        self.remember(RecentBlock(block.height, block.timestamp_ms, tuple(block.transactions)))

    def remember(self, block: RecentBlock) -> None:
        self.recent.append(block)
        since_ms = block.timestamp_ms - REPLAY_WINDOW_KEPT_MS
        while len(self.recent) > 1 and self.recent[1].timestamp_ms <= since_ms:  # as `forget_old_txids`
            self.recent.pop(0)
        for index, (txid, _) in enumerate(block.transactions):
            self.locations[txid] = TransactionLocation(block.height, index)

    def prune(self, below_height: int, reduce: Callable[[bytes], bytes]) -> None:
        count = max(0, below_height - self.earliest_height)
        for block in self.blocks[:count]:
            self.kept[block.height] = reduce(block.block_bytes)
        del self.blocks[:count]
        self.earliest_height += count


class MemorySnapshot:
    """See `LedgerSnapshot`."""

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
        return self._open.position

    @property
    def state_root(self) -> bytes:
        return self._open.state.state_root

    @property
    def finality(self) -> bytes:
        return self._open.finality

    def get(self, key: bytes) -> bytes | None:
        return self._open.state.get(key)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return self._open.state.scan(prefix, limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        return self._open.state.scan_range(start, end)

    def page(self, path: bytes) -> bytes | None:
        return self._open.state.page(path)

    def prove(self, key: bytes) -> Proof:
        return self._open.state.prove(key)

    def _stored(self, height: int) -> FinalizedBlock | None:
        index = height - self._open.earliest_height
        return self._open.blocks[index] if 0 <= index < len(self._open.blocks) else None

    def block(self, height: int) -> bytes | None:
        found = self._stored(height)
        return None if found is None else found.block_bytes

    def block_height(self, block_id: bytes) -> int | None:
        return self._open.heights.get(block_id)

    def iter_blocks(self, from_height: int, limit: int) -> Iterator[tuple[int, bytes]]:
        first = max(from_height - self._open.earliest_height, 0)
        for block in self._open.blocks[first : first + max(limit, 0)]:
            yield block.height, block.block_bytes

    def receipts(self, height: int) -> bytes | None:
        found = self._stored(height)
        return None if found is None else found.receipts_bytes

    @property
    def earliest_height(self) -> int:
        return self._open.earliest_height

    def kept_header(self, height: int) -> bytes | None:
        return self._open.kept.get(height)

    def epoch_proof(self, number: int) -> bytes | None:
        proofs = self._open.epoch_proofs
        return proofs[number - 1] if 1 <= number <= len(proofs) else None

    def locate(self, txid: bytes) -> TransactionLocation | None:
        return self._open.locations.get(txid)

    def recent_txids(self, since_timestamp_ms: int) -> list[RecentTransaction]:
        return [
            RecentTransaction(txid, block.height, block.timestamp_ms, valid_until_ms)
            for block in self.iter_recent(since_timestamp_ms)
            for txid, valid_until_ms in block.transactions
        ]

    def iter_recent(self, since_timestamp_ms: int) -> Iterator[RecentBlock]:
        tables = self._open
        first = bisect_left(tables.recent, since_timestamp_ms, key=lambda block: block.timestamp_ms)
        yield from tables.recent[first:]

    def events(self, from_cursor: EventCursor, limit: int) -> list[tuple[EventCursor, bytes]]:
        found: list[tuple[EventCursor, bytes]] = []
        first = max(from_cursor.height - self._open.earliest_height, 0)
        for block in self._open.blocks[first:]:
            for index, event in enumerate(block.events):
                if len(found) >= limit:
                    return found
                place = EventCursor(block.height, index)
                if place >= from_cursor:
                    found.append((place, event))
        return found

    def close(self) -> None:
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
    """See `LedgerStore`; not persistent."""

    def __init__(self) -> None:
        self._tables = _Tables()
        self._closed = False

    @property
    def position(self) -> Position | None:
        return self._tables.position

    async def commit(self, blocks: Sequence[FinalizedBlock], finality: bytes) -> Position:
        if self._closed:
            raise BlockRobotError("STORAGE_UNWRITABLE", "The store is closed.")
        check_order(self._tables.position, blocks)
        tables = self._tables.copy() if self._tables.readers else self._tables
        for block in blocks:
            tables.append(block)
        tables.finality = finality
        self._tables = tables
        return blocks[-1].position

    async def prune(self, below_height: int, reduce: Callable[[bytes], bytes]) -> int:
        if self._closed:
            raise BlockRobotError("STORAGE_UNWRITABLE", "The store is closed.")
        tables = self._tables.copy() if self._tables.readers else self._tables
        if tables.position is not None:
            tables.prune(min(below_height, tables.position.height), reduce)
        self._tables = tables
        return tables.earliest_height

    def snapshot(self) -> MemorySnapshot:
        if self._closed:
            raise ValueError("the store is closed")
        return MemorySnapshot(self._tables)

    async def close(self) -> None:
        self._closed = True


class MemoryRestore:
    """See `LedgerRestore`. The finished store is `store`."""

    def __init__(self) -> None:
        self._tables = _Tables()
        self._last_key = b""
        self.store: MemoryStore | None = None

    def put_state(self, rows: Sequence[tuple[bytes, bytes]]) -> None:
        """Raises SNAPSHOT_DAMAGED."""
        for key, _ in rows:
            if key <= self._last_key:
                raise BlockRobotError("SNAPSHOT_DAMAGED", "The state's keys are out of order.")
            self._last_key = key
        self._tables.state.apply(dict(rows))

    def put_kept(self, blocks: Sequence[KeptBlock]) -> None:
        for block in blocks:
            self._tables.kept[block.recent.height] = block.header_bytes
            self._tables.heights[block.block_id] = block.recent.height
            self._tables.remember(block.recent)

    def finish(self, genesis_id: bytes, head: FinalizedBlock, finality: bytes, epoch_proofs: Sequence[bytes]) -> None:
        """Raises SNAPSHOT_DAMAGED."""
        tables = self._tables
        if tables.state.state_root != head.state_root:
            raise BlockRobotError("SNAPSHOT_DAMAGED", "The state of the snapshot is not the one of its block.")
        tables.heights[genesis_id] = 0
        tables.earliest_height = head.height
        tables.append(replace(head, state_writes={}, page_writes={}, epoch_proof_bytes=b""))
        tables.epoch_proofs = list(epoch_proofs)
        tables.finality = finality
        self.store = MemoryStore()
        self.store._tables = tables

    def abandon(self) -> None:
        self._tables = _Tables()


def _without_writes(block: FinalizedBlock) -> FinalizedBlock:
    return replace(
        block,
        transactions=tuple(block.transactions),
        state_writes={},
        page_writes={},
        events=tuple(block.events),
    )

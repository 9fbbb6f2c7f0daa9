"""Reads the ledger in LMDB from one read transaction, to be closed soon."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from types import TracebackType
from typing import Any, Self

import lmdb

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.trie import EMPTY_ROOT, Proof
from contracts.state.key_cache import prefix_end
from contracts.state.trie import prove
from node.storage import lmdb_layout as layout
from node.storage.ledger_store import (
    EventCursor,
    Position,
    RecentBlock,
    RecentTransaction,
    TransactionLocation,
)


def read_position(transaction: lmdb.Transaction[bytes], tables: layout.Tables) -> Position | None:
    """Return the transaction's position. Raises STORAGE_DAMAGED for an invalid row."""
    row = transaction.get(layout.META_POSITION, db=tables.meta)
    if row is None:
        return None
    try:
        return decode(row, Position)
    except BlockRobotError as error:
        raise BlockRobotError("STORAGE_DAMAGED", "The ledger's position cannot be read.") from error


class LmdbSnapshot:
    """See `LedgerSnapshot`. Reads raise STORAGE_DAMAGED where LMDB finds damage."""

    def __init__(
        self, transaction: lmdb.Transaction[bytes], tables: layout.Tables, on_close: Callable[[], None]
    ) -> None:
        self._transaction = transaction
        self._tables = tables
        self._on_close = on_close
        self._closed = False
        self._position = read_position(transaction, tables)

    def _get(self, table: Any, key: bytes) -> bytes | None:
        if self._closed:
            raise ValueError("the snapshot is closed")
        if not key:
            return None
        try:
            value: bytes | None = self._transaction.get(key, db=table)
        except lmdb.Error as error:
            raise _damage(error) from error
        return value

    def _rows(self, table: Any, start: bytes) -> Iterator[tuple[bytes, bytes]]:
        if self._closed:
            raise ValueError("the snapshot is closed")
        try:
            with self._transaction.cursor(db=table) as cursor:
                if cursor.set_range(start) if start else cursor.first():
                    yield from cursor.iternext(keys=True, values=True)
        except lmdb.Error as error:
            if self._closed:
                raise ValueError("the snapshot was closed while it was read") from error
            raise _damage(error) from error

    @property
    def position(self) -> Position | None:
        return self._position

    @property
    def state_root(self) -> bytes:
        return EMPTY_ROOT if self._position is None else self._position.state_root

    @property
    def finality(self) -> bytes:
        return self._get(self._tables.meta, layout.META_FINALITY) or b""

    def get(self, key: bytes) -> bytes | None:
        return self._get(self._tables.state, key)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return islice(self.scan_range(prefix, prefix_end(prefix)), max(limit, 0))

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        for key, value in self._rows(self._tables.state, start):
            if key >= end:
                return
            yield key, value

    def page(self, path: bytes) -> bytes | None:
        return self._get(self._tables.pages, layout.page_key(path))

    def prove(self, key: bytes) -> Proof:
        return prove(self, self.state_root, key)

    def block(self, height: int) -> bytes | None:
        return None if height < 0 else self._get(self._tables.blocks, layout.height_key(height))

    def block_height(self, block_id: bytes) -> int | None:
        row = self._get(self._tables.heights, block_id)
        return None if row is None else layout.read_height(row)

    def iter_blocks(self, from_height: int, limit: int) -> Iterator[tuple[int, bytes]]:
        if limit <= 0:
            return
        start = layout.height_key(max(from_height, 0))
        for count, (key, value) in enumerate(self._rows(self._tables.blocks, start), start=1):
            yield layout.read_height(key), value
            if count >= limit:
                return

    def receipts(self, height: int) -> bytes | None:
        return None if height < 0 else self._get(self._tables.receipts, layout.height_key(height))

    @property
    def earliest_height(self) -> int:
        row = self._get(self._tables.meta, layout.META_EARLIEST)
        return 0 if row is None else layout.read_height(row)

    def kept_header(self, height: int) -> bytes | None:
        return None if height < 0 else self._get(self._tables.headers, layout.height_key(height))

    def epoch_proof(self, number: int) -> bytes | None:
        return None if number < 1 else self._get(self._tables.epochs, layout.height_key(number))

    def locate(self, txid: bytes) -> TransactionLocation | None:
        row = self._get(self._tables.transactions, txid)
        return None if row is None else layout.read_location(row)

    def recent_txids(self, since_timestamp_ms: int) -> list[RecentTransaction]:
        return [
            RecentTransaction(txid, block.height, block.timestamp_ms, valid_until_ms)
            for block in self.iter_recent(since_timestamp_ms)
            for txid, valid_until_ms in block.transactions
        ]

    def iter_recent(self, since_timestamp_ms: int) -> Iterator[RecentBlock]:
        for key, row in self._rows(self._tables.recent, b""):
            if layout.read_recent_timestamp(row) >= since_timestamp_ms:
                yield layout.read_recent(layout.read_height(key), row)

    def events(self, from_cursor: EventCursor, limit: int) -> list[tuple[EventCursor, bytes]]:
        found: list[tuple[EventCursor, bytes]] = []
        if limit <= 0:
            return found
        first = max(from_cursor, EventCursor(0, 0))
        start = layout.place_bytes(first.height, first.index)
        for key, event in self._rows(self._tables.events, start):
            found.append((layout.read_cursor(key), event))
            if len(found) >= limit:
                break
        return found

    def close(self) -> None:
        """Drop the transaction object: only then does LMDB free the reader's slot."""
        if not self._closed:
            self._closed = True
            try:
                self._transaction.abort()
                del self._transaction
            finally:
                self._on_close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _damage(error: lmdb.Error) -> BlockRobotError:
    return BlockRobotError("STORAGE_DAMAGED", f"The ledger cannot be read: {error}.")

"""Layout of the ledger in LMDB: tables, keys (big-endian heights) and rows."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import lmdb

from node.storage.ledger_store import EventCursor, RecentBlock, TransactionLocation

FORMAT_NAME = b"blockrobot-ledger/2"
META_FORMAT = b"format"
META_POSITION = b"position"
META_FINALITY = b"finality"
META_EARLIEST = b"earliest"

TABLES_MAX_COUNT = 16

_HEIGHT = struct.Struct(">Q")
_PLACE = struct.Struct(">QI")
_RECENT_ROW = struct.Struct(">32sQ")


@dataclass(frozen=True, slots=True)
class Tables:
    """The handles of the named tables."""

    meta: Any
    state: Any
    pages: Any
    blocks: Any
    heights: Any
    receipts: Any
    transactions: Any
    recent: Any
    events: Any
    epochs: Any
    headers: Any

    @classmethod
    def open(
        cls, environment: lmdb.Environment, transaction: lmdb.Transaction[bytes] | None, *, create: bool
    ) -> Tables:
        """Open all tables. Raises lmdb.Error if one is missing and `create` is False."""
        names = (
            "meta",
            "state",
            "pages",
            "blocks",
            "heights",
            "receipts",
            "transactions",
            "recent",
            "events",
            "epochs",
            "headers",
        )
        return cls(*(environment.open_db(name.encode(), txn=transaction, create=create) for name in names))


def page_key(path: bytes) -> bytes:
    return b"/" + path


def height_key(height: int) -> bytes:
    return _HEIGHT.pack(height)


def read_height(data: bytes) -> int:
    height: int = _HEIGHT.unpack(data)[0]
    return height


def place_bytes(height: int, index: int) -> bytes:
    """Sortable, 12 bytes."""
    return _PLACE.pack(height, index)


def read_location(data: bytes) -> TransactionLocation:
    return TransactionLocation(*_PLACE.unpack(data))


def read_cursor(data: bytes) -> EventCursor:
    return EventCursor(*_PLACE.unpack(data))


def recent_row(timestamp_ms: int, transactions: Sequence[tuple[bytes, int]]) -> bytes:
    return _HEIGHT.pack(timestamp_ms) + b"".join(_RECENT_ROW.pack(*transaction) for transaction in transactions)


def read_recent_timestamp(row: bytes) -> int:
    return read_height(row[: _HEIGHT.size])


def read_recent(height: int, row: bytes) -> RecentBlock:
    transactions = tuple(_RECENT_ROW.iter_unpack(row[_HEIGHT.size :]))
    return RecentBlock(height, read_recent_timestamp(row), transactions)

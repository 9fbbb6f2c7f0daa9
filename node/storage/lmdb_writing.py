"""Rows that blocks add to the LMDB ledger and pruning removes."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import lmdb

from node.storage import lmdb_layout as layout
from node.storage.ledger_store import REPLAY_WINDOW_KEPT_MS, FinalizedBlock, KeptBlock

PRUNED_AT_ONCE_COUNT = 256


def write_block(transaction: lmdb.Transaction[bytes], tables: layout.Tables, block: FinalizedBlock) -> None:
    write_body(transaction, tables, block)
    key = layout.height_key(block.height)
    if block.epoch_proof_bytes:
        write_epoch_proofs(transaction, tables, [block.epoch_proof_bytes])
    for flat_key, value in sorted(block.state_writes.items()):
        if value is None:
            transaction.delete(flat_key, db=tables.state)
        else:
            transaction.put(flat_key, value, db=tables.state)
    write_pages(transaction, tables, block.page_writes.items())
    transaction.put(key, layout.recent_row(block.timestamp_ms, block.transactions), db=tables.recent, append=True)


def write_body(transaction: lmdb.Transaction[bytes], tables: layout.Tables, block: FinalizedBlock) -> None:
    key = layout.height_key(block.height)
    transaction.put(key, block.block_bytes, db=tables.blocks, append=True)
    transaction.put(key, block.receipts_bytes, db=tables.receipts, append=True)
    transaction.put(block.block_id, key, db=tables.heights)
    for index, (txid, _) in enumerate(block.transactions):
        transaction.put(txid, layout.place_bytes(block.height, index), db=tables.transactions)
    for index, event in enumerate(block.events):
        transaction.put(layout.place_bytes(block.height, index), event, db=tables.events, append=True)


def write_kept(transaction: lmdb.Transaction[bytes], tables: layout.Tables, block: KeptBlock) -> None:
    height, timestamp_ms, transactions = block.recent
    key = layout.height_key(height)
    transaction.put(key, block.header_bytes, db=tables.headers)
    transaction.put(block.block_id, key, db=tables.heights)
    for index, (txid, _) in enumerate(transactions):
        transaction.put(txid, layout.place_bytes(height, index), db=tables.transactions)
    transaction.put(key, layout.recent_row(timestamp_ms, transactions), db=tables.recent, append=True)


def write_pages(
    transaction: lmdb.Transaction[bytes], tables: layout.Tables, pages: Iterable[tuple[bytes, bytes | None]]
) -> None:
    for path, page in pages:
        if page is None:
            transaction.delete(layout.page_key(path), db=tables.pages)
        else:
            transaction.put(layout.page_key(path), page, db=tables.pages)


def write_epoch_proofs(transaction: lmdb.Transaction[bytes], tables: layout.Tables, proofs: Iterable[bytes]) -> None:
    first = transaction.stat(tables.epochs)["entries"] + 1
    for number, proof in enumerate(proofs, start=first):
        transaction.put(layout.height_key(number), proof, db=tables.epochs, append=True)


def forget_old_txids(transaction: lmdb.Transaction[bytes], tables: layout.Tables, timestamp_ms: int) -> None:
    """The newest block from before the window stays: a snapshot shows by it that nothing is missing."""
    since_ms = timestamp_ms - REPLAY_WINDOW_KEPT_MS
    with transaction.cursor(db=tables.recent) as cursor:
        while cursor.first() and cursor.next() and layout.read_recent_timestamp(cursor.value()) <= since_ms:
            cursor.prev()
            cursor.delete()


def prune_blocks(
    transaction: lmdb.Transaction[bytes], tables: layout.Tables, below_height: int, reduce: Callable[[bytes], bytes]
) -> int:
    """Reduce up to `PRUNED_AT_ONCE_COUNT` oldest blocks; return the new earliest height."""
    earliest = _read_earliest(transaction, tables)
    end = min(below_height, earliest + PRUNED_AT_ONCE_COUNT)
    if end <= earliest:
        return earliest
    for height in range(earliest, end):
        key = layout.height_key(height)
        body = transaction.get(key, db=tables.blocks)
        if body is not None:
            transaction.put(key, reduce(body), db=tables.headers)
            transaction.delete(key, db=tables.blocks)
            transaction.delete(key, db=tables.receipts)
    with transaction.cursor(db=tables.events) as cursor:
        while cursor.first() and layout.read_cursor(cursor.key()).height < end:
            cursor.delete()
    write_earliest(transaction, tables, end)
    return end


def write_earliest(transaction: lmdb.Transaction[bytes], tables: layout.Tables, height: int) -> None:
    transaction.put(layout.META_EARLIEST, layout.height_key(height), db=tables.meta)


def _read_earliest(transaction: lmdb.Transaction[bytes], tables: layout.Tables) -> int:
    row = transaction.get(layout.META_EARLIEST, db=tables.meta)
    return 0 if row is None else layout.read_height(row)

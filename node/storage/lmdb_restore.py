"""Builds a ledger in LMDB from a snapshot; unsynced until format and position are written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lmdb

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.trie import EMPTY_ROOT
from contracts.state.trie import apply_batch
from node.storage import lmdb_layout as layout
from node.storage.directory_lock import DirectoryLock
from node.storage.ledger_store import FinalizedBlock, KeptBlock
from node.storage.lmdb_store import MAP_SIZE_START_BYTES, open_environment, refusal_of
from node.storage.lmdb_writing import (
    forget_old_txids,
    write_body,
    write_earliest,
    write_epoch_proofs,
    write_kept,
    write_pages,
)
from node.storage.synced_files import sync_directory


class _Pages:
    def __init__(self, transaction: lmdb.Transaction[bytes], tables: layout.Tables) -> None:
        self._transaction = transaction
        self._tables = tables

    def page(self, path: bytes) -> bytes | None:
        page: bytes | None = self._transaction.get(layout.page_key(path), db=self._tables.pages)
        return page


class LmdbRestore:
    """See `LedgerRestore`; uses a new directory, and every method may block."""

    def __init__(self, directory: Path, *, map_size_bytes: int = MAP_SIZE_START_BYTES) -> None:
        """Raises DATA_DIRECTORY_IN_USE, DATA_DIRECTORY_INVALID if the directory is not empty."""
        directory.mkdir(parents=True, mode=0o700, exist_ok=True)
        if any(directory.iterdir()):
            raise BlockRobotError("DATA_DIRECTORY_INVALID", f"{directory} is not empty.")
        self._directory = directory
        self._lock = DirectoryLock(directory)
        try:
            self._environment = open_environment(directory, map_size_bytes, sync=False)
            with self._environment.begin(write=True) as transaction:
                self._tables = layout.Tables.open(self._environment, transaction, create=True)
        except BaseException:
            self._lock.release()
            raise
        self._root = EMPTY_ROOT
        self._open = True

    @property
    def state_root(self) -> bytes:
        """Of the rows so far."""
        return self._root

    def put_state(self, rows: Sequence[tuple[bytes, bytes]]) -> None:
        """See `LedgerRestore.put_state`. Raises SNAPSHOT_DAMAGED out of order."""
        try:
            with self._environment.begin(write=True) as transaction:
                for key, value in rows:
                    if not transaction.put(key, value, db=self._tables.state, append=True, overwrite=False):
                        raise BlockRobotError("SNAPSHOT_DAMAGED", "A key of the state comes twice.")
                update = apply_batch(_Pages(transaction, self._tables), self._root, dict(rows))
                write_pages(transaction, self._tables, update.pages.items())
        except (lmdb.KeyExistsError, lmdb.BadValsizeError) as error:
            raise BlockRobotError(
                "SNAPSHOT_DAMAGED", "The state's keys are out of order or of a wrong size."
            ) from error
        except (lmdb.Error, OSError) as error:
            raise refusal_of(error) from error
        self._root = update.root

    def put_kept(self, blocks: Sequence[KeptBlock]) -> None:
        try:
            with self._environment.begin(write=True) as transaction:
                for block in blocks:
                    write_kept(transaction, self._tables, block)
        except (lmdb.Error, OSError) as error:
            raise refusal_of(error) from error

    def finish(self, genesis_id: bytes, head: FinalizedBlock, finality: bytes, epoch_proofs: Sequence[bytes]) -> None:
        """Raises SNAPSHOT_DAMAGED."""
        if self._root != head.state_root:
            raise BlockRobotError("SNAPSHOT_DAMAGED", "The state of the snapshot is not the one of its block.")
        tables = self._tables
        try:
            with self._environment.begin(write=True) as transaction:
                transaction.put(genesis_id, layout.height_key(0), db=tables.heights)
                write_body(transaction, tables, head)
                recent = layout.recent_row(head.timestamp_ms, head.transactions)
                transaction.put(layout.height_key(head.height), recent, db=tables.recent, append=True)
                forget_old_txids(transaction, tables, head.timestamp_ms)
                write_epoch_proofs(transaction, tables, epoch_proofs)
                write_earliest(transaction, tables, head.height)
                transaction.put(layout.META_FINALITY, finality, db=tables.meta)
            self._environment.sync(True)
            with self._environment.begin(write=True) as transaction:
                transaction.put(layout.META_POSITION, encode(head.position), db=tables.meta)
                transaction.put(layout.META_FORMAT, layout.FORMAT_NAME, db=tables.meta)
            self._environment.sync(True)
            sync_directory(self._directory)
        except (lmdb.Error, OSError) as error:
            raise refusal_of(error) from error
        self._close()

    def abandon(self) -> None:
        """Discard what was added; the caller removes the directory."""
        self._close()

    def _close(self) -> None:
        if self._open:
            self._open = False
            self._environment.close()
            self._lock.release()

"""Reads a ledger in LMDB that another process may be writing."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import lmdb

from consensus.errors import BlockRobotError
from node.storage import lmdb_layout as layout
from node.storage.lmdb_snapshot import LmdbSnapshot
from node.storage.lmdb_store import DATA_FILE_NAME, MAP_SIZE_LEAST_BYTES, MAP_SIZE_START_BYTES, SNAPSHOTS_MAX_COUNT


class LedgerFile:
    """A ledger opened for reading only; a context manager."""

    def __init__(self, directory: Path, *, held: bool = False) -> None:
        """Raises DATA_DIRECTORY_INVALID, STORAGE_DAMAGED.

        `held`: an older snapshot stays open elsewhere, so LMDB's lock file is unused.
        """
        if not (directory / DATA_FILE_NAME).is_file():
            raise BlockRobotError("DATA_DIRECTORY_INVALID", f"{directory} holds no ledger.")
        self._environment = _open(directory, lock=not held)
        try:
            self._tables = layout.Tables.open(self._environment, None, create=False)
            with self._environment.begin() as transaction:
                found = transaction.get(layout.META_FORMAT, db=self._tables.meta)
        except lmdb.NotFoundError as error:
            self._environment.close()
            raise BlockRobotError("DATA_DIRECTORY_INVALID", f"{directory} holds no ledger of this version.") from error
        except lmdb.Error as error:
            self._environment.close()
            raise BlockRobotError("STORAGE_DAMAGED", f"The ledger in {directory} cannot be read: {error}.") from error
        if found != layout.FORMAT_NAME:
            self._environment.close()
            raise BlockRobotError("DATA_DIRECTORY_INVALID", f"The ledger in {directory} has another format.")

    def snapshot(self) -> LmdbSnapshot:
        """Open the newest version. Raises STORAGE_BUSY if too many readers use the ledger."""
        try:
            transaction = self._environment.begin()
        except lmdb.ReadersFullError:
            raise BlockRobotError("STORAGE_BUSY", "Too many readers use the ledger.") from None
        return LmdbSnapshot(transaction, self._tables, lambda: None)

    def close(self) -> None:
        self._environment.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _open(directory: Path, *, lock: bool) -> lmdb.Environment:
    size_bytes = MAP_SIZE_START_BYTES
    while True:
        try:
            return lmdb.open(
                str(directory),
                readonly=True,
                lock=lock,
                create=False,
                map_size=size_bytes,
                max_dbs=layout.TABLES_MAX_COUNT,
                max_readers=SNAPSHOTS_MAX_COUNT + 16,
            )
        except lmdb.MemoryError:
            if size_bytes < 2 * MAP_SIZE_LEAST_BYTES:
                raise BlockRobotError("STORAGE_BUSY", "The system gives no address space for the ledger.") from None
            size_bytes //= 2
        except lmdb.Error as error:
            raise BlockRobotError("STORAGE_DAMAGED", f"The ledger in {directory} cannot be opened: {error}.") from error

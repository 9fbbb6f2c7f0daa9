"""The ledger of a node on disk, in LMDB: one writer thread, group commits."""

from __future__ import annotations

import asyncio
import errno
import os
import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lmdb

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.trie import EMPTY_ROOT, hash_page
from contracts.state.trie import compute_root
from node.storage import lmdb_layout as layout
from node.storage.directory_lock import DirectoryLock
from node.storage.ledger_store import FinalizedBlock, Position, check_order
from node.storage.lmdb_snapshot import LmdbSnapshot, read_position
from node.storage.lmdb_writing import forget_old_txids, prune_blocks, write_block
from node.storage.synced_files import sync_directory

DATA_FILE_NAME = "data.mdb"
STORE_SIZE_MAX_BYTES = 1024**4
MAP_SIZE_START_BYTES = STORE_SIZE_MAX_BYTES
MAP_SIZE_LEAST_BYTES = 1024**3
SNAPSHOTS_MAX_COUNT = 512
COMMITS_WAITING_MAX_COUNT = 256
COMMITS_GROUP_MAX_COUNT = 32
GROWTH_WAIT_MAX_MS = 5_000


@dataclass(slots=True)
class _Commit:
    blocks: Sequence[FinalizedBlock]
    finality: bytes
    done: Future[Position]


@dataclass(slots=True)
class _Pruning:
    below_height: int
    reduce: Callable[[bytes], bytes]
    done: Future[int]


class _ReaderGate:
    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._open_count = 0

    def open(self, environment: lmdb.Environment) -> lmdb.Transaction[bytes]:
        with self._changed:
            if self._open_count >= SNAPSHOTS_MAX_COUNT:
                raise BlockRobotError("STORAGE_BUSY", "Too many snapshots of the ledger are open.")
            try:
                transaction = environment.begin()
            except lmdb.ReadersFullError:
                raise BlockRobotError("STORAGE_BUSY", "Too many readers use the ledger.") from None
            self._open_count += 1
            return transaction

    def leave(self) -> None:
        with self._changed:
            self._open_count -= 1
            self._changed.notify_all()

    def resize(self, environment: lmdb.Environment, size_bytes: int, wait_max_ms: int) -> bool:
        """Resize the map once no snapshot is open; return False on timeout."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._open_count == 0, wait_max_ms / 1000):
                return False
            environment.set_mapsize(size_bytes)
            return True


class LmdbStore:
    """See `LedgerStore`. `create` and `open` block: call them before the loop serves."""

    def __init__(
        self, environment: lmdb.Environment, tables: layout.Tables, lock: DirectoryLock, size_max_bytes: int
    ) -> None:
        self._environment = environment
        self._tables = tables
        self._lock = lock
        self._size_max_bytes = size_max_bytes
        self._gate = _ReaderGate()
        self.require_space: Callable[[], None] = lambda: None
        """Called before each commit, in the writer's thread; what it raises is taken for the disk's own refusal."""
        with environment.begin() as transaction:
            self._position = read_position(transaction, tables)
        self._closing = False
        self._waiting: queue.Queue[_Commit | _Pruning | None] = queue.Queue()
        self._writer = threading.Thread(target=self._write_until_closed, name="ledger-writer", daemon=True)
        self._writer.start()

    @classmethod
    def create(
        cls,
        directory: Path,
        *,
        map_size_bytes: int = MAP_SIZE_START_BYTES,
        size_max_bytes: int = STORE_SIZE_MAX_BYTES,
    ) -> LmdbStore:
        """Raises DATA_DIRECTORY_INVALID if one exists, DATA_DIRECTORY_IN_USE."""
        directory.mkdir(parents=True, exist_ok=True)
        lock = DirectoryLock(directory)
        try:
            environment = open_environment(directory, min(map_size_bytes, size_max_bytes))
            try:
                if environment.stat()["entries"]:
                    raise BlockRobotError("DATA_DIRECTORY_INVALID", f"{directory} already holds a ledger.")
                tables = _make_tables(environment)
                sync_directory(directory)
                return cls(environment, tables, lock, size_max_bytes)
            except BaseException:
                environment.close()
                raise
        except BaseException:
            lock.release()
            raise

    @classmethod
    def open(
        cls,
        directory: Path,
        *,
        map_size_bytes: int = MAP_SIZE_START_BYTES,
        size_max_bytes: int = STORE_SIZE_MAX_BYTES,
    ) -> LmdbStore:
        """Open, completing interrupted creation. Raises DATA_DIRECTORY_INVALID, DATA_DIRECTORY_IN_USE, STORAGE_DAMAGED."""
        if not (directory / DATA_FILE_NAME).is_file():
            raise BlockRobotError("DATA_DIRECTORY_INVALID", f"{directory} holds no ledger.")
        lock = DirectoryLock(directory)
        try:
            size_bytes = max(map_size_bytes, 2 * (directory / DATA_FILE_NAME).stat().st_size)
            environment = open_environment(directory, min(size_bytes, size_max_bytes))
            try:
                short = _fill_up(environment, directory / DATA_FILE_NAME)
                if not environment.stat()["entries"]:
                    _make_tables(environment)
                tables = _check_ledger(environment, directory)
                if short:
                    _check_content(environment, tables, directory)
                return cls(environment, tables, lock, size_max_bytes)
            except BaseException:
                environment.close()
                raise
        except BaseException:
            lock.release()
            raise

    @property
    def position(self) -> Position | None:
        return self._position

    async def commit(self, blocks: Sequence[FinalizedBlock], finality: bytes) -> Position:
        """See `LedgerStore.commit`; cancellation does not undo it."""
        if self._closing:
            raise BlockRobotError("STORAGE_UNWRITABLE", "The store is closed.")
        if self._waiting.qsize() >= COMMITS_WAITING_MAX_COUNT:
            raise BlockRobotError("STORAGE_BUSY", "Too many commits wait to be written.")
        done: Future[Position] = Future()
        self._waiting.put(_Commit(blocks, finality, done))
        return await asyncio.shield(asyncio.wrap_future(done))

    async def prune(self, below_height: int, reduce: Callable[[bytes], bytes]) -> int:
        if self._closing:
            raise BlockRobotError("STORAGE_UNWRITABLE", "The store is closed.")
        done: Future[int] = Future()
        self._waiting.put(_Pruning(below_height, reduce, done))
        return await asyncio.shield(asyncio.wrap_future(done))

    def snapshot(self) -> LmdbSnapshot:
        """Raises STORAGE_BUSY."""
        if self._closing:
            raise ValueError("the store is closed")
        transaction = self._gate.open(self._environment)
        try:
            return LmdbSnapshot(transaction, self._tables, self._gate.leave)
        except BaseException:
            transaction.abort()
            self._gate.leave()
            raise

    async def close(self) -> None:
        if self._closing:
            return
        self._closing = True
        self._waiting.put(None)
        await asyncio.to_thread(self._writer.join)
        self._environment.close()
        self._lock.release()

    def _write_until_closed(self) -> None:
        task = self._waiting.get()
        while task is not None:
            if isinstance(task, _Pruning):
                self._prune(task)
                task = self._waiting.get()
            else:
                group, task = self._gather(task)
                self._write_group(group)
                task = task or self._waiting.get()

    def _gather(self, first: _Commit) -> tuple[list[_Commit], _Commit | _Pruning | None]:
        group = [first]
        while len(group) < COMMITS_GROUP_MAX_COUNT:
            try:
                following = self._waiting.get_nowait()
            except queue.Empty:
                break
            if following is None:
                self._waiting.put(None)
                break
            if isinstance(following, _Pruning):
                return group, following
            group.append(following)
        return group, None

    def _write_group(self, group: list[_Commit]) -> None:
        """Write pending commits in one transaction; commits out of order fail alone."""
        accepted: list[_Commit] = []
        position = self._position
        for commit in group:
            try:
                check_order(position, commit.blocks)
            except ValueError as error:
                commit.done.set_exception(error)
                continue
            accepted.append(commit)
            position = commit.blocks[-1].position
        if not accepted:
            return
        try:
            self._write_growing(accepted)
        except Exception as error:  # noqa: BLE001 - whatever failed, the callers must hear of it and the thread must live
            if len(accepted) > 1:
                for commit in accepted:
                    self._write_group([commit])
            else:
                accepted[0].done.set_exception(refusal_of(error))
            return
        self._position = position
        for commit in accepted:
            commit.done.set_result(commit.blocks[-1].position)

    def _prune(self, pruning: _Pruning) -> None:
        below_height = min(pruning.below_height, 0 if self._position is None else self._position.height)
        try:
            with self._environment.begin(write=True) as transaction:
                earliest = prune_blocks(transaction, self._tables, below_height, pruning.reduce)
        except Exception as error:  # noqa: BLE001 - the caller must hear of it and the thread must live
            pruning.done.set_exception(refusal_of(error))
        else:
            pruning.done.set_result(earliest)

    def _write_growing(self, commits: list[_Commit]) -> None:
        while True:
            try:
                with self._environment.begin(write=True) as transaction:
                    self.require_space()
                    for commit in commits:
                        for block in commit.blocks:
                            write_block(transaction, self._tables, block)
                    newest = commits[-1]
                    position = newest.blocks[-1].position
                    transaction.put(layout.META_POSITION, encode(position), db=self._tables.meta)
                    transaction.put(layout.META_FINALITY, newest.finality, db=self._tables.meta)
                    forget_old_txids(transaction, self._tables, position.timestamp_ms)
            except lmdb.MapFullError:
                self._grow()
            else:
                return

    def _grow(self) -> None:
        size_bytes = self._environment.info()["map_size"]
        if size_bytes >= self._size_max_bytes:
            raise BlockRobotError("STORAGE_FULL", f"The ledger has reached the {size_bytes} bytes that it is allowed.")
        grown = min(2 * size_bytes, self._size_max_bytes)
        if not self._gate.resize(self._environment, grown, GROWTH_WAIT_MAX_MS):
            raise BlockRobotError("STORAGE_BUSY", "The ledger must grow, but a snapshot of it stays open.")


def open_environment(directory: Path, map_size_bytes: int, *, sync: bool = True) -> lmdb.Environment:
    """Raises STORAGE_DAMAGED, STORAGE_BUSY. Without `sync` commits are not durable until synced."""
    while True:
        try:
            return lmdb.open(
                str(directory),
                map_size=map_size_bytes,
                mode=0o600,
                sync=sync,
                max_dbs=layout.TABLES_MAX_COUNT,
                max_readers=SNAPSHOTS_MAX_COUNT + 16,
                max_spare_txns=8,
            )
        except lmdb.MemoryError:
            if map_size_bytes < 2 * MAP_SIZE_LEAST_BYTES:
                raise BlockRobotError("STORAGE_BUSY", "The system gives no address space for the ledger.") from None
            map_size_bytes //= 2
        except lmdb.Error as error:
            raise BlockRobotError("STORAGE_DAMAGED", f"The ledger in {directory} cannot be opened: {error}.") from error


def _make_tables(environment: lmdb.Environment) -> layout.Tables:
    with environment.begin(write=True) as transaction:
        tables = layout.Tables.open(environment, transaction, create=True)
        transaction.put(layout.META_FORMAT, layout.FORMAT_NAME, db=tables.meta)
    return tables


def _fill_up(environment: lmdb.Environment, path: Path) -> bool:
    """Extend the data file to all pages: touching the map beyond it kills the process."""
    size_bytes = (environment.info()["last_pgno"] + 1) * environment.stat()["psize"]
    if path.stat().st_size >= size_bytes:
        return False
    os.truncate(path, size_bytes)
    return True


def _check_content(environment: lmdb.Environment, tables: layout.Tables, directory: Path) -> None:
    """Read every row and recompute the state root. Raises STORAGE_DAMAGED."""
    try:
        with environment.begin() as transaction:
            position = read_position(transaction, tables)
            for table in (tables.pages, tables.blocks, tables.heights, tables.receipts, tables.transactions):
                _count_rows(transaction, table)
            for table in (tables.recent, tables.events, tables.epochs, tables.headers):
                _count_rows(transaction, table)
            with transaction.cursor(db=tables.state) as cursor:
                root = compute_root(cursor.iternext())
    except lmdb.Error as error:
        raise BlockRobotError("STORAGE_DAMAGED", f"The ledger in {directory} cannot be read: {error}.") from error
    if root != (EMPTY_ROOT if position is None else position.state_root):
        raise BlockRobotError("STORAGE_DAMAGED", f"The state in {directory} is not the one of its newest block.")


def _count_rows(transaction: lmdb.Transaction[bytes], table: Any) -> None:
    with transaction.cursor(db=table) as cursor:
        found = sum(1 for _ in cursor.iternext())
    if found != transaction.stat(table)["entries"]:
        raise lmdb.CorruptedError("a table has lost rows")


def _check_ledger(environment: lmdb.Environment, directory: Path) -> layout.Tables:
    try:
        with environment.begin(write=True) as transaction:
            try:
                tables = layout.Tables.open(environment, transaction, create=False)
            except lmdb.NotFoundError as error:
                raise BlockRobotError("DATA_DIRECTORY_INVALID", f"{directory} holds no ledger.") from error
            found = transaction.get(layout.META_FORMAT, db=tables.meta)
            if found != layout.FORMAT_NAME:
                name = "none" if found is None else found.decode("ascii", "replace")
                raise BlockRobotError(
                    "DATA_DIRECTORY_INVALID",
                    f"The ledger in {directory} has the format {name}; this version reads {layout.FORMAT_NAME.decode()}.",
                )
            position = read_position(transaction, tables)
            page = transaction.get(layout.page_key(b""), db=tables.pages)
    except lmdb.Error as error:
        raise BlockRobotError("STORAGE_DAMAGED", f"The ledger in {directory} cannot be read: {error}.") from error
    root = EMPTY_ROOT if page is None else hash_page(page)
    if root != (EMPTY_ROOT if position is None else position.state_root):
        raise BlockRobotError("STORAGE_DAMAGED", f"The state in {directory} is not the one of its newest block.")
    return tables


def refusal_of(error: Exception) -> Exception:
    full = isinstance(error, lmdb.DiskError) or (isinstance(error, OSError) and error.errno == errno.ENOSPC)
    if full:
        return BlockRobotError("STORAGE_FULL", "The disk is full; nothing of the commit was stored.")
    if isinstance(error, (lmdb.Error, OSError)):
        return BlockRobotError("STORAGE_UNWRITABLE", f"The ledger takes no writes: {error}.")
    return error

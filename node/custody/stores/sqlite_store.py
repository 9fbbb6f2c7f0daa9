"""Embedded custody store on SQLite; erased rows leave no bytes.

One connection in one thread; `secure_delete` overwrites freed pages, `sweep` the log and moved rows' copies.
"""

from __future__ import annotations

import asyncio
import os
import sqlite3
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import structlog

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from node.custody.stores.custody_store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    FramePlace,
    FrameRow,
    Grant,
    Leftovers,
    OutboxRow,
    OutboxStatus,
    RecordFacts,
    StoreCounts,
    Unwritten,
    VisitRestrictions,
    require_written,
)
from node.custody.stores.sqlite_rows import (
    delete_clip,
    insert_outbox,
    read_clip,
    read_grant,
    read_missing,
    replace_frames,
    write_clip,
    write_effects,
)
from node.custody.stores.sqlite_schema import (
    CLIP_COLUMNS,
    FORMAT_VERSION,
    GRANT_COLUMNS,
    MISSING_COLUMNS,
    OUTBOX_COLUMNS,
    PLACES_COUNT,
    SCHEMA,
)
from node.custody.stores.sqlite_shares import SqliteShares
from node.custody.stores.sqlite_sweep import LOG_MAX_BYTES, Sweeper
from node.custody.stores.sqlite_uploads import SqliteUploads

T = TypeVar("T")
log = structlog.get_logger(__name__)

DATABASE_FILE_NAME = "custody.sqlite3"
BUSY_TIMEOUT_MS = 5_000
_PAGE_ROWS_COUNT = 500
_HEIGHT_MAX = (1 << 63) - 1


class SqliteStore(SqliteShares, SqliteUploads):
    """A `CustodyStore` in one directory, which it makes with mode 0700."""

    def __init__(self, directory: Path, require_space: Callable[[], None] = lambda: None) -> None:
        """`require_space` runs before each write; its OSError counts as the disk's."""
        self._directory = directory
        self._require_space = require_space
        self._database: sqlite3.Connection | None = None
        self._worker: ThreadPoolExecutor | None = None
        self._descriptor = -1
        self._sweeper: Sweeper | None = None
        self._clean_from_bytes = LOG_MAX_BYTES

    async def __aenter__(self) -> Self:
        """Raises STORE_UNAVAILABLE if directory or file is unusable."""
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="custody-store")
        try:
            await self._in_worker(self._open)
        except BaseException:
            self._worker.shutdown()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._database is not None:
            await self._in_worker(self._finish)
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
        if self._worker is not None:
            self._worker.shutdown()
            self._worker = None

    def _open(self) -> None:
        self._directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        path = self._directory / DATABASE_FILE_NAME
        is_new = not path.exists()
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            self._sweeper = Sweeper(path, self._descriptor)
            self._database = self._connect()
            if not self._sweeper.is_known_clean:
                if not is_new:
                    log.info("custody_walks_every_page", size_bytes=os.fstat(self._descriptor).st_size)
                self._try_to_clean()
        except BaseException:
            self._close_database()
            os.close(self._descriptor)
            self._descriptor = -1
            raise

    def _finish(self) -> None:
        self._try_to_clean()
        self._close_database()

    def _try_to_clean(self) -> bool:
        try:
            self._clean()
        except (sqlite3.Error, OSError, BlockRobotError) as error:  # the next sweep walks every page then
            log.warning("custody_log_not_cut", error=str(error))
            return False
        return True

    def _clean_full_log(self) -> None:
        self._opened().execute("PRAGMA busy_timeout = 0")
        is_cut = self._try_to_clean()
        self._opened().execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
        self._clean_from_bytes = LOG_MAX_BYTES if is_cut else self._swept().log_bytes + LOG_MAX_BYTES

    def _close_database(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            database.close()

    def _connect(self) -> sqlite3.Connection:
        path = self._directory / DATABASE_FILE_NAME
        database = sqlite3.connect(path, BUSY_TIMEOUT_MS / 1000, isolation_level=None, check_same_thread=False)
        try:
            self._prepare(database)
            self._swept().begin(database)
        except BaseException:
            database.close()  # or what it began would lock the next try out
            raise
        return database

    def _prepare(self, database: sqlite3.Connection) -> None:
        """Create the tables in one transaction. Raises STORE_UNAVAILABLE for a foreign database."""
        for setting in ("journal_mode = WAL", "synchronous = FULL", "secure_delete = ON", "temp_store = MEMORY"):
            database.execute(f"PRAGMA {setting}").fetchall()
        version = database.execute("PRAGMA user_version").fetchone()[0]
        if version == 0:
            database.executescript(f"BEGIN IMMEDIATE; {SCHEMA} PRAGMA user_version = {FORMAT_VERSION}; COMMIT;")
        elif version != FORMAT_VERSION:
            raise BlockRobotError("STORE_UNAVAILABLE", f"The store has format {version}, not {FORMAT_VERSION}.")

    async def _in_worker(self, work: Callable[[], T]) -> T:
        if self._worker is None:
            raise BlockRobotError("STORE_UNAVAILABLE", "The store is not open.")
        try:
            return await asyncio.get_running_loop().run_in_executor(self._worker, work)
        except (sqlite3.Error, OSError) as error:
            raise BlockRobotError("STORE_UNAVAILABLE", f"The store in {self._directory} fails: {error}.") from error

    async def _write(self, work: Callable[[sqlite3.Connection], None]) -> None:
        def transaction() -> None:
            database = self._opened()
            database.execute("BEGIN IMMEDIATE")
            try:
                self._require_space()
                work(database)
                database.execute("COMMIT")
            except BaseException:
                if database.in_transaction:  # on some errors SQLite has rolled back by itself
                    database.execute("ROLLBACK")
                raise
            if self._swept().log_bytes >= self._clean_from_bytes:
                self._clean_full_log()

        await self._in_worker(transaction)

    async def _write_one(self, query: str, *rows: Sequence[Any]) -> None:
        def write(database: sqlite3.Connection) -> None:
            database.executemany(query, rows)

        await self._write(write)

    async def _read(self, query: str, *arguments: Any) -> list[tuple[Any, ...]]:
        return await self._in_worker(lambda: self._opened().execute(query, arguments).fetchall())

    async def _read_each(self, query: str, keys: Sequence[bytes]) -> list[tuple[Any, ...]]:
        def read() -> list[tuple[Any, ...]]:
            database = self._opened()
            return [row for key in keys for row in database.execute(query, (key,))]

        return await self._in_worker(read)

    def _swept(self) -> Sweeper:
        if self._sweeper is None:
            raise BlockRobotError("STORE_UNAVAILABLE", "The store is not open.")
        return self._sweeper

    def _opened(self) -> sqlite3.Connection:
        if self._descriptor < 0:
            raise BlockRobotError("STORE_UNAVAILABLE", "The store is not open.")
        if self._database is None:  # a sweep closed it, and could not open it again
            self._database = self._connect()
        return self._database

    async def stage(self, clip: ClipRow, frames: Sequence[FrameRow]) -> None:
        require_written(await self.stage_all([(clip, frames)]))

    async def stage_all(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        is_committing = False

        def write(database: sqlite3.Connection) -> None:
            nonlocal is_committing
            for clip, frames in clips:
                write_clip(database, clip, frames)
            is_committing = True

        try:
            await self._write(write)
        except BlockRobotError as error:
            if is_committing:
                raise
            return {clip.record_id: error for clip, _ in clips}
        return {}

    async def correct(self, facts: RecordFacts) -> None:
        changes = "txid = ?, owner = ?, expires_at_ms = ?, height = ?"
        query = f"UPDATE clips SET {changes} WHERE record_id = ? AND status = 'confirmed'"  # noqa: S608
        await self._write_one(query, (facts.txid, facts.owner, facts.expires_at_ms, facts.height, facts.record_id))

    async def replace_frames(self, record_id: bytes, frames: Sequence[FrameRow]) -> None:
        await self._write(lambda database: replace_frames(database, record_id, frames))

    async def extend_staged(self, record_id: bytes, txid: bytes, valid_until_ms: int) -> None:
        query = "UPDATE clips SET txid = ?, valid_until_ms = ? WHERE record_id = ? AND status = 'staged'"
        await self._write_one(query, (txid, valid_until_ms, record_id))

    async def apply(self, effects: BlockEffects) -> None:
        await self._write(lambda database: write_effects(database, effects))

    async def checkpoint(self) -> Checkpoint | None:
        rows = await self._read("SELECT height, block_id, timestamp_ms FROM checkpoint")
        return Checkpoint(*rows[0]) if rows else None

    async def clips(self, record_ids: Sequence[bytes]) -> dict[bytes, ClipRow]:
        query = f"SELECT {CLIP_COLUMNS} FROM clips WHERE record_id = ?"  # noqa: S608
        return {row[0]: read_clip(row) for row in await self._read_each(query, record_ids)}

    async def clips_of_owner(self, owner: bytes) -> list[ClipRow]:
        query = f"SELECT {CLIP_COLUMNS} FROM clips WHERE owner = ? AND status = 'confirmed' ORDER BY record_id"  # noqa: S608
        return [read_clip(row) for row in await self._read(query, owner)]

    async def frames(self, record_id: bytes) -> list[FrameRow]:
        query = "SELECT record_id, place, ciphertext, wrapped_key, slot FROM frames WHERE record_id = ? ORDER BY id"
        return [FrameRow(*row) for row in await self._read(query, record_id)]

    async def frame_places(self, record_ids: Sequence[bytes]) -> list[FramePlace]:
        query = "SELECT record_id, place, slot FROM frames WHERE record_id = ? ORDER BY id"
        return [FramePlace(*row) for row in await self._read_each(query, sorted(record_ids))]

    async def references(self, record_ids: Sequence[bytes], size_bytes: int) -> dict[bytes, set[bytes]]:
        query = f"SELECT record_id, ciphertext FROM frames WHERE record_id = ? AND length(ciphertext) = {size_bytes:d}"  # noqa: S608
        found: dict[bytes, set[bytes]] = {}
        for record_id, reference in await self._read_each(query, record_ids):
            found.setdefault(record_id, set()).add(reference)
        return found

    async def erase_frames(self, record_id: bytes, indexes: Sequence[int]) -> None:
        which = f"(SELECT number FROM clips WHERE record_id = ?) * {PLACES_COUNT} + ?"  # noqa: S608
        query = f"DELETE FROM stored_frames WHERE id = {which}"  # noqa: S608
        await self._write_one(query, *((record_id, index) for index in indexes))

    async def erase_clips(self, record_ids: Sequence[bytes]) -> None:
        def erase(database: sqlite3.Connection) -> None:
            for record_id in record_ids:
                delete_clip(database, record_id)

        if record_ids:
            await self._write(erase)

    async def drop_staged(self, record_ids: Sequence[bytes]) -> None:
        query = "DELETE FROM clips WHERE record_id = ? AND status = 'staged'"
        await self._write_one(query, *((record_id,) for record_id in record_ids))

    async def sweep(self) -> None:
        await self._in_worker(self._clean)

    def _clean(self) -> None:
        if self._swept().sweep(self._opened()):  # the connection's own copies of these pages would be written again
            self._close_database()
            self._database = self._connect()

    async def sweep_blobs(self) -> int:
        return 0

    async def lapsed(self, at_ms: int, limit: int) -> list[bytes]:
        due = "status = 'staged' AND valid_until_ms <= ? ORDER BY valid_until_ms, record_id LIMIT ?"
        query = f"SELECT record_id FROM clips INDEXED BY clips_by_valid_until WHERE {due}"  # noqa: S608
        return [row[0] for row in await self._read(query, at_ms, limit)]

    async def expired(self, at_ms: int, limit: int) -> list[bytes]:
        due = "status = 'confirmed' AND expires_at_ms <= ? ORDER BY expires_at_ms, number LIMIT ?"
        query = f"SELECT record_id FROM clips INDEXED BY clips_by_expiry WHERE {due}"  # noqa: S608
        return [row[0] for row in await self._read(query, at_ms, limit)]

    async def missing(self, limit: int, after: tuple[int, bytes] | None = None) -> list[RecordFacts]:
        height, record_id = after or (_HEIGHT_MAX, b"")
        wanted = (
            "elsewhere = 0 AND height <= ? AND (height < ? OR record_id > ?) ORDER BY height DESC, record_id LIMIT ?"
        )
        query = f"SELECT {MISSING_COLUMNS} FROM missing WHERE {wanted}"  # noqa: S608
        return [read_missing(row) for row in await self._read(query, height, height, record_id, limit)]

    async def count_missing(self) -> int:
        return int((await self._read("SELECT count(*) FROM missing WHERE elsewhere = 0"))[0][0])

    async def missing_clips(self, record_ids: Sequence[bytes]) -> dict[bytes, RecordFacts]:
        query = f"SELECT {MISSING_COLUMNS} FROM missing WHERE record_id = ?"  # noqa: S608
        return {row[0]: read_missing(row) for row in await self._read_each(query, record_ids)}

    async def absent(self, after: bytes, limit: int) -> list[RecordFacts]:
        query = f"SELECT {MISSING_COLUMNS} FROM missing WHERE record_id > ? ORDER BY record_id LIMIT ?"  # noqa: S608
        return [read_missing(row) for row in await self._read(query, after, limit)]

    async def missing_of_owner(self, owner: bytes) -> list[RecordFacts]:
        query = f"SELECT {MISSING_COLUMNS} FROM missing WHERE owner = ? ORDER BY record_id"  # noqa: S608
        return [read_missing(row) for row in await self._read(query, owner)]

    async def grant(self, access_id: bytes) -> Grant | None:
        rows = await self._read(f"SELECT {GRANT_COLUMNS} FROM grants WHERE access_id = ?", access_id)  # noqa: S608
        return read_grant(rows[0]) if rows else None

    async def grants_of_owners(self, owners: Sequence[bytes]) -> list[Grant]:
        query = f"SELECT {GRANT_COLUMNS} FROM grants WHERE owner = ? ORDER BY access_id"  # noqa: S608
        return [read_grant(row) for row in await self._read_each(query, sorted(owners))]

    async def all_grants(self) -> AsyncIterator[Grant]:
        query = f"SELECT {GRANT_COLUMNS} FROM grants WHERE access_id > ? ORDER BY access_id LIMIT ?"  # noqa: S608
        last = b""
        while rows := await self._read(query, last, _PAGE_ROWS_COUNT):
            for row in rows:
                yield read_grant(row)
            last = rows[-1][0]

    async def visit_restrictions(self, owners: Sequence[bytes] | None = None) -> dict[bytes, VisitRestrictions]:
        def read() -> dict[bytes, VisitRestrictions]:
            database, query = self._opened(), "SELECT owner, content FROM restrictions"
            if owners is None:
                found = database.execute(query).fetchall()
            else:
                found = [row for owner in owners for row in database.execute(f"{query} WHERE owner = ?", (owner,))]
            return {owner: decode(content, VisitRestrictions) for owner, content in found}

        return await self._in_worker(read)

    async def put_background(self, digest: bytes, content: bytes) -> None:
        query = "INSERT OR REPLACE INTO backgrounds VALUES (?, ?)"
        await self._write_one(query, (digest, content))

    async def background(self, digest: bytes) -> bytes | None:
        rows = await self._read("SELECT content FROM backgrounds WHERE digest = ?", digest)
        return rows[0][0] if rows else None

    async def background_digests(self) -> list[bytes]:
        return [row[0] for row in await self._read("SELECT digest FROM backgrounds ORDER BY digest")]

    async def delete_backgrounds(self, digests: Sequence[bytes]) -> None:
        await self._write_one("DELETE FROM backgrounds WHERE digest = ?", *((digest,) for digest in digests))

    async def add_outbox(self, row: OutboxRow) -> None:
        await self._write(lambda database: insert_outbox(database, [row]))

    async def mark_outbox_ready(self, key: tuple[str, bytes, int]) -> None:
        query = "UPDATE outbox SET status = 'ready', plan = x'' WHERE kind = ? AND subject = ? AND part = ?"
        await self._write_one(query, key)

    async def remove_outbox(self, key: tuple[str, bytes, int]) -> None:
        await self._write(lambda database: write_effects(database, BlockEffects(settled=(key,))))

    async def outbox(self, status: OutboxStatus, contract: str, limit: int) -> list[OutboxRow]:
        where = "status = ? AND contract = ? ORDER BY height, kind, subject, part LIMIT ?"
        query = f"SELECT {OUTBOX_COLUMNS} FROM outbox WHERE {where}"  # noqa: S608
        return [OutboxRow(*row) for row in await self._read(query, status, contract, limit)]

    async def outbox_of(self, kind: str, subject: bytes) -> list[OutboxRow]:
        query = f"SELECT {OUTBOX_COLUMNS} FROM outbox WHERE kind = ? AND subject = ? ORDER BY part"  # noqa: S608
        return [OutboxRow(*row) for row in await self._read(query, kind, subject)]

    async def all_clips(self) -> AsyncIterator[ClipRow]:
        query = f"SELECT {CLIP_COLUMNS} FROM clips WHERE record_id > ? ORDER BY record_id LIMIT ?"  # noqa: S608
        last = b""
        while rows := await self._read(query, last, _PAGE_ROWS_COUNT):
            for row in rows:
                yield read_clip(row)
            last = rows[-1][0]

    async def slots_in_use(self) -> AsyncIterator[int]:
        both = "SELECT slot FROM stored_frames WHERE slot > ? UNION SELECT slot FROM parts WHERE slot > ?"
        last = -1
        while rows := await self._read(f"{both} ORDER BY slot LIMIT ?", last, last, _PAGE_ROWS_COUNT):
            for row in rows:
                yield row[0]
            last = rows[-1][0]

    async def records_with_frames(self) -> AsyncIterator[bytes]:
        has_frames = "EXISTS (SELECT 1 FROM frames WHERE frames.record_id = clips.record_id)"
        query = f"SELECT record_id FROM clips WHERE record_id > ? AND {has_frames} ORDER BY record_id LIMIT ?"  # noqa: S608
        last = b""
        while rows := await self._read(query, last, _PAGE_ROWS_COUNT):
            for row in rows:
                yield row[0]
            last = rows[-1][0]

    async def counts(self) -> StoreCounts:
        def read() -> StoreCounts:
            database = self._opened()
            clips = dict(database.execute("SELECT status, count(*) FROM clips GROUP BY status"))
            outbox = dict(database.execute("SELECT status, count(*) FROM outbox GROUP BY status"))
            frames = database.execute("SELECT count(*) FROM stored_frames").fetchone()[0]
            missing = "(SELECT count(*) FROM missing WHERE elsewhere = 0)"
            lacking, absent = database.execute(f"SELECT {missing}, count(*) FROM missing").fetchone()  # noqa: S608
            shared = database.execute("SELECT (SELECT count(*) FROM shares), (SELECT count(*) FROM parts)").fetchone()
            size_bytes = sum(path.stat().st_size for path in self._directory.glob(f"{DATABASE_FILE_NAME}*"))
            return StoreCounts(
                staged=clips.get("staged", 0),
                confirmed=clips.get("confirmed", 0),
                erased=clips.get("erased", 0),
                frames=frames,
                missing=lacking,
                outbox_ready=outbox.get("ready", 0),
                outbox_erasing=outbox.get("erasing", 0),
                size_bytes=size_bytes,
                shares=shared[0],
                parts=shared[1],
                elsewhere=absent - lacking,
            )

        return await self._in_worker(read)

    async def leftovers(self) -> Leftovers:
        def look() -> Leftovers:
            self._clean()
            sweeper = self._swept()
            dirty = sweeper.count_dirty(self._opened())
            if dirty:
                sweeper.distrust()
            return Leftovers(sweeper.log_bytes, dirty)

        return await self._in_worker(look)

"""What SQLite keeps of deleted rows in its own file: found where nothing overwrites it, and absent from our store."""

from __future__ import annotations

import asyncio
import os
import secrets
import sqlite3
import tracemalloc
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from node.custody.stores.sqlite_pages import PageFile
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME, SqliteStore
from tests.offchain.stored_clips import bytes_in, make_clip, pieces_of

CLIPS_COUNT = 40


@contextmanager
def _pages(path: Path) -> Iterator[PageFile]:
    descriptor = os.open(path, os.O_RDWR)
    try:
        yield PageFile(descriptor)
    finally:
        os.close(descriptor)


def _roots(path: Path) -> list[int]:
    with closing(sqlite3.connect(path)) as database:
        return [row[0] for row in database.execute("SELECT rootpage FROM sqlite_master WHERE rootpage > 0")]


def _churn(path: Path, secure: str) -> list[bytes]:
    """Insert rows in random order and delete every other one; return what was deleted."""
    rows = [(secrets.token_bytes(16), secrets.token_bytes(600)) for _ in range(400)]
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA synchronous = OFF")
        database.execute(f"PRAGMA secure_delete = {secure}")
        database.execute("BEGIN")
        database.execute("CREATE TABLE rows (id BLOB PRIMARY KEY, content BLOB) WITHOUT ROWID")
        for row in rows:
            database.execute("INSERT INTO rows VALUES (?, ?)", row)
        for row in rows[::2]:
            database.execute("DELETE FROM rows WHERE id = ?", row[:1])
        database.execute("COMMIT")
    return [content for _, content in rows[::2]]


def _left(path: Path, contents: list[bytes]) -> int:
    written = path.read_bytes()
    return sum(content[start : start + 16] in written for content in contents for start in (0, 300, 584))


@pytest.mark.parametrize("secure", ["OFF", "ON"])
def test_rows_that_moved_leave_copies_even_where_deleting_overwrites_and_cleaning_leaves_none(
    tmp_path: Path, secure: str
) -> None:
    path = tmp_path / "x.sqlite3"
    gone = _churn(path, secure)
    assert _left(path, gone) > 0 or secure == "ON"
    with closing(sqlite3.connect(path)) as database:
        kept = database.execute("SELECT * FROM rows").fetchall()
    with _pages(path) as pages:
        assert pages.count_dirty(_roots(path)) > 0, "or there were no need to clean"
        assert pages.clean(_roots(path)) > 0
        if secure == "ON":
            assert pages.count_dirty(_roots(path)) == 0
            assert pages.clean(_roots(path)) == 0
            assert _left(path, gone) == 0
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert database.execute("SELECT * FROM rows").fetchall() == kept


@pytest.mark.parametrize(("secure", "is_dirty"), [("OFF", True), ("ON", False)])
def test_free_pages_are_dirty_unless_deleting_overwrites(tmp_path: Path, secure: str, is_dirty: bool) -> None:
    path = tmp_path / "x.sqlite3"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA synchronous = OFF")
        database.execute(f"PRAGMA secure_delete = {secure}")
        database.execute("CREATE TABLE frames (content BLOB)")
        database.executemany("INSERT INTO frames VALUES (?)", [(secrets.token_bytes(20_000),) for _ in range(40)])
        database.execute("DELETE FROM frames")
    with _pages(path) as pages:
        assert (pages.count_dirty(_roots(path)) > 100_000) == is_dirty
        pages.clean(_roots(path))
        assert pages.count_dirty(_roots(path)) == 0


def test_a_walk_holds_a_bit_for_each_page_and_not_its_number(tmp_path: Path) -> None:
    path = tmp_path / "x.sqlite3"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA synchronous = OFF")
        database.execute("CREATE TABLE frames (content BLOB)")
        database.execute("BEGIN")
        database.executemany("INSERT INTO frames VALUES (?)", [(bytes(3_000),)] * 10_000)
        database.execute("COMMIT")
    roots, pages_count = _roots(path), path.stat().st_size // 4096
    assert pages_count > 10_000
    with _pages(path) as pages:
        tracemalloc.start()
        try:
            pages.count_dirty(roots)
            held_bytes = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert held_bytes < 10 * pages_count, "a number in a set is some 70 bytes"


def test_an_empty_file_has_no_pages(tmp_path: Path) -> None:
    (tmp_path / "new").touch()
    with _pages(tmp_path / "new") as pages:
        assert pages.count_dirty([2, 3]) == pages.clean([2, 3]) == 0


async def test_of_many_clips_that_came_and_went_not_a_byte_of_an_erased_one_is_left(tmp_path: Path) -> None:
    """Rows move from page to page as others come and go; every other clip is erased, and more come in between."""
    async with SqliteStore(tmp_path) as store:
        kept, gone = [], []
        for number in range(CLIPS_COUNT):
            clip, frames = make_clip(number)
            await store.stage(clip, frames)
            (gone if number % 2 else kept).append((clip, frames))
            if number % 8 == 7:
                for clip, _ in gone[-4:]:
                    await store.erase_clips([clip.record_id])
                await store.sweep()
        left = await store.leftovers()
        assert (left.log_bytes, left.dirty_bytes) == (0, 0)
        files = await asyncio.to_thread(bytes_in, tmp_path)
        assert not [piece for clip in gone for piece in pieces_of(*clip) if piece in files]
        for clip, frames in kept:
            assert await store.frames(clip.record_id) == frames
            assert (await store.clips([clip.record_id]))[clip.record_id] == clip
    with closing(sqlite3.connect(tmp_path / DATABASE_FILE_NAME)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


async def test_sweeping_gives_up_no_lock_and_loses_no_commit_of_anybody(tmp_path: Path) -> None:
    """Another program opens, writes and closes the database in between: nothing of either is lost."""
    async with SqliteStore(tmp_path) as store:
        first, second = make_clip(1), make_clip(2)
        await store.stage(*first)
        await store.leftovers()
        with closing(sqlite3.connect(tmp_path / DATABASE_FILE_NAME, isolation_level=None)) as other:
            other.execute(
                "UPDATE stored_frames SET ciphertext = x'00' WHERE id IN (SELECT id FROM frames WHERE record_id = ?)",
                (first[0].record_id,),
            )
        await store.stage(*second)
        await store.sweep()
        assert {frame.ciphertext for frame in await store.frames(first[0].record_id)} == {b"\x00"}
    async with SqliteStore(tmp_path) as store:
        assert await store.frames(second[0].record_id) == second[1]
        changed = [replace(frame, ciphertext=b"\x00") for frame in first[1]]
        assert await store.frames(first[0].record_id) == changed


async def test_page_numbers_that_reused_pages_leave_in_the_list_of_free_ones_are_no_alarm(tmp_path: Path) -> None:
    """SQLite writes over no number that it takes from the list: they tell of no row, and are cleared all the same."""
    async with SqliteStore(tmp_path) as store:
        clips = [make_clip(number) for number in range(8)]
        for clip, frames in clips[:6]:
            await store.stage(clip, frames)
        for clip, _ in clips[:4]:
            await store.erase_clips([clip.record_id])
        await store.sweep()
        for clip, frames in clips[6:]:
            await store.stage(clip, frames)
            left = await store.leftovers()
            assert (left.log_bytes, left.dirty_bytes) == (0, 0)
        for clip, frames in clips[4:]:
            assert await store.frames(clip.record_id) == frames
    with closing(sqlite3.connect(tmp_path / DATABASE_FILE_NAME)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


async def test_a_sweep_that_cannot_open_the_database_again_stops_nothing_but_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_store: SqliteStore) -> sqlite3.Connection:
        raise sqlite3.OperationalError("unable to open database file")

    async with SqliteStore(tmp_path) as store:
        clip, frames = make_clip(1)
        await store.stage(clip, frames)
        with monkeypatch.context() as patches:
            patches.setattr(PageFile, "clean_written", lambda _pages, _written: 1)
            patches.setattr(SqliteStore, "_connect", fail)
            for action in (store.sweep, store.counts):
                with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE:"):
                    await action()
        assert await store.frames(clip.record_id) == frames
        await store.erase_clips([clip.record_id])
        await store.sweep()
        assert await store.frames(clip.record_id) == []
        with monkeypatch.context() as patches:
            patches.setattr(PageFile, "clean_written", lambda _pages, _written: 1)
            patches.setattr(SqliteStore, "_connect", fail)
            with pytest.raises(BlockRobotError):
                await store.sweep()
    async with SqliteStore(tmp_path) as store:
        assert (await store.counts()).erased == 1


async def test_the_database_is_for_the_custodians_own_user(tmp_path: Path) -> None:
    async with SqliteStore(tmp_path / "custody"):
        assert (tmp_path / "custody").stat().st_mode & 0o777 == 0o700
        files = [tmp_path / "custody" / f"{DATABASE_FILE_NAME}{end}" for end in ("", "-wal", "-shm")]
        assert [path.stat().st_mode & 0o777 for path in files] == [0o600] * 3

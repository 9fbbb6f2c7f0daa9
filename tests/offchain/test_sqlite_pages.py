"""What SQLite keeps of deleted rows in its own file: found where nothing overwrites it, and absent from our store."""

from __future__ import annotations

import secrets
import sqlite3
from pathlib import Path

import pytest

from node.offchain.sqlite_pages import count_dirty_free_bytes
from node.offchain.sqlite_store import DATABASE_FILE_NAME, SqliteStore
from tests.offchain.test_store_contract import clip, frames_of


def _fill_and_delete(path: Path, secure: str) -> None:
    database = sqlite3.connect(path, isolation_level=None)
    database.execute(f"PRAGMA secure_delete = {secure}")
    database.execute("CREATE TABLE frames (content BLOB)")
    database.executemany("INSERT INTO frames VALUES (?)", [(secrets.token_bytes(20_000),) for _ in range(40)])
    database.execute("DELETE FROM frames")
    database.close()


def _bytes_in(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in folder.glob(f"{DATABASE_FILE_NAME}*"))


@pytest.mark.parametrize(("secure", "is_dirty"), [("OFF", True), ("ON", False)])
def test_free_pages_are_dirty_unless_deleting_overwrites(tmp_path: Path, secure: str, is_dirty: bool) -> None:
    path = tmp_path / "x.sqlite3"
    _fill_and_delete(path, secure)
    assert (count_dirty_free_bytes(path) > 100_000) == is_dirty
    if not is_dirty:
        assert count_dirty_free_bytes(path) == 0


def test_an_empty_file_has_no_free_pages(tmp_path: Path) -> None:
    (tmp_path / "new").touch()
    assert count_dirty_free_bytes(tmp_path / "new") == 0


async def test_an_erased_clip_leaves_not_a_byte_in_the_stores_files(tmp_path: Path) -> None:
    staged = clip(1, frames=16)
    contents = [secrets.token_bytes(30_000) for _ in range(16)]
    rows = [
        type(row)(row.record_id, row.index, content, row.wrapped_key, row.slot)
        for row, content in zip(frames_of(staged), contents, strict=True)
    ]
    async with SqliteStore(tmp_path) as store:
        await store.stage(staged, rows)
        written = _bytes_in(tmp_path)
        assert all(content[:16] in written for content in contents)
        await store.erase_clip(staged.record_id)
        left = await store.leftovers()
        assert (left.log_bytes, left.dirty_bytes) == (0, 0)
        files = _bytes_in(tmp_path)
        for content in contents:
            assert not any(content[start : start + 16] in files for start in range(0, len(content) - 16, 1000))

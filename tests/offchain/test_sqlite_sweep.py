"""A sweep looks at what was written since the last one, and leaves what a walk over every page would leave."""

from __future__ import annotations

import asyncio
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import node.custody.stores.sqlite_sweep as sweeping
from consensus.errors import BlockRobotError
from node.custody.stores.custody_store import BlockEffects, ClipRow, FrameRow, RecordFacts
from node.custody.stores.sqlite_pages import PageFile
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME, SqliteStore
from node.custody.stores.sqlite_sweep import read_written_pages
from tests.offchain.stored_clips import bytes_in, make_clip, pieces_of

ROOT = Path(__file__).resolve().parents[2]
SMALL_FRAME_BYTES = 700


@contextmanager
def counted(patches: pytest.MonkeyPatch, owner: Any, name: str) -> Iterator[list[int]]:
    """Count the calls of a method meanwhile."""
    original, calls = getattr(owner, name), [0]

    def counting(*arguments: Any) -> Any:
        calls[0] += 1
        return original(*arguments)

    with patches.context() as patch:
        patch.setattr(owner, name, counting)
        yield calls


def oracle(folder: Path) -> int:
    """Walk every page of a store's file, as it lies there, and count the bytes that no row holds."""
    with closing(sqlite3.connect(f"file:{folder / DATABASE_FILE_NAME}?mode=ro", uri=True)) as database:
        roots = sweeping.find_roots(database)
    descriptor = os.open(folder / DATABASE_FILE_NAME, os.O_RDONLY)
    try:
        return PageFile(descriptor).count_dirty(roots)
    finally:
        os.close(descriptor)


def confirm(clip: ClipRow, dice: random.Random) -> BlockEffects:
    owner, roots = dice.randbytes(33), (dice.randbytes(32), dice.randbytes(32))
    return BlockEffects(confirmed=(RecordFacts(clip.record_id, clip.txid, owner, *roots, 10**13, 7),))


async def test_a_sweep_reads_the_pages_that_were_written_however_many_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside them it looks at the first page of the free list."""
    dice, log, most = random.Random(1), tmp_path / f"{DATABASE_FILE_NAME}-wal", 0
    async with SqliteStore(tmp_path) as store:
        for number in range(600):
            clip, frames = make_clip(number, SMALL_FRAME_BYTES, dice=dice)
            await store.stage(clip, frames)
            if number % 50 == 7:
                await store.sweep()
                await store.erase_clips([clip.record_id])
                written = len(read_written_pages(log))
                with counted(monkeypatch, PageFile, "_page") as reads:
                    await store.sweep()
                assert 0 < reads[0] <= written + 1
                most = max(most, reads[0])
        assert most < 40 < 500 < (tmp_path / DATABASE_FILE_NAME).stat().st_size / 4096
        assert (await store.leftovers()).dirty_bytes == 0


class Churn:
    """Random writes to a store: rows that come, change, move and go, with a sweep now and then."""

    def __init__(self, store: SqliteStore, seed: int) -> None:
        self.store, self.dice = store, random.Random(seed)
        self.kept: dict[bytes, tuple[ClipRow, list[FrameRow]]] = {}
        self.gone: list[bytes] = []
        self.number = 0

    async def step(self) -> None:
        actions: list[Callable[[], Any]] = [self.stage, self.stage, self.stage]
        if self.kept:
            actions += [self.erase, self.erase_frame, self.confirm, self.extend, self.drop, self.replace]
        await self.dice.choice(actions)()

    def choose(self) -> bytes:
        return self.dice.choice(sorted(self.kept))

    async def stage(self) -> None:
        size, frames = self.dice.choice([20, 300, 1_500, 9_000, 20_000]), self.dice.choice([1, 3, 40])
        clip, rows = make_clip(self.number, size if frames < 40 else 200, frames, self.dice)
        self.number += 1
        self.kept[clip.record_id] = (clip, rows)
        await self.store.stage(clip, rows)

    async def erase(self) -> None:
        record_id = self.choose()
        self.gone += pieces_of(*self.kept.pop(record_id))
        await self.store.erase_clips([record_id])

    async def erase_frame(self) -> None:
        clip, rows = self.kept[self.choose()]
        if len(rows) > 1:
            row = rows.pop(self.dice.randrange(len(rows)))
            self.gone += [row.wrapped_key[:16], row.ciphertext[:16], row.ciphertext[-16:]]
            await self.store.erase_frames(clip.record_id, [row.index])

    async def confirm(self) -> None:
        await self.store.apply(confirm(self.kept[self.choose()][0], self.dice))

    async def extend(self) -> None:
        await self.store.extend_staged(self.choose(), self.dice.randbytes(32), self.dice.randrange(10**12))

    async def drop(self) -> None:
        record_id = self.choose()
        await self.store.drop_staged([record_id])
        if not await self.store.clips([record_id]):
            self.gone += pieces_of(*self.kept.pop(record_id))

    async def replace(self) -> None:
        clip, rows = self.kept[self.choose()]
        self.gone += [row.ciphertext[:16] for row in rows]
        rows[:] = [
            FrameRow(row.record_id, row.index, self.dice.randbytes(len(row.ciphertext)), row.wrapped_key, row.slot)
            for row in rows
        ]
        await self.store.replace_frames(clip.record_id, rows)

    async def check(self, folder: Path) -> None:
        """Ask the walk over every page, and the files themselves."""
        assert oracle(folder) == 0
        files = bytes_in(folder)
        assert not [piece for piece in self.gone if piece in files]
        for record_id, (_, rows) in self.kept.items():
            assert await self.store.frames(record_id) == rows


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32), rounds=st.integers(1, 4), writes=st.integers(1, 25))
def test_after_any_writes_the_walk_over_every_page_finds_nothing_that_a_sweep_left(
    seed: int, rounds: int, writes: int
) -> None:
    async def play(folder: Path, patches: pytest.MonkeyPatch) -> None:
        async with SqliteStore(folder) as store:
            churn = Churn(store, seed)
            with counted(patches, PageFile, "clean") as walks:
                for _ in range(rounds):
                    for _ in range(writes):
                        await churn.step()
                    await store.sweep()
                    await churn.check(folder)
            assert walks == [0], "or the walk would have done the sweep's work"

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patches:
        asyncio.run(play(Path(folder), patches))
        with closing(sqlite3.connect(Path(folder) / DATABASE_FILE_NAME)) as database:
            assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


async def test_the_walk_finds_what_a_sweep_without_the_log_would_leave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also the scrub's: it counts and does not mend, and the next sweep walks."""
    async with SqliteStore(tmp_path) as store:
        churn = Churn(store, 3)
        with monkeypatch.context() as patches:
            patches.setattr(sweeping, "read_written_pages", lambda _path: frozenset())
            for _ in range(60):
                await churn.step()
            left = await store.leftovers()
        assert (left.dirty_bytes or 0) > 0
        await store.sweep()
        await churn.check(tmp_path)
        assert (await store.leftovers()).dirty_bytes == 0


@pytest.mark.parametrize("swept", [True, False], ids=["closed-in-order", "found-as-left"])
async def test_a_store_that_nobody_touched_is_opened_without_a_walk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swept: bool
) -> None:
    async with SqliteStore(tmp_path) as store:
        await store.stage(*make_clip(1))
        if swept:
            await store.sweep()
    with counted(monkeypatch, PageFile, "clean") as walks:
        async with SqliteStore(tmp_path) as store:
            await store.stage(*make_clip(2))
            await store.sweep()
    assert walks == [0]


async def test_what_another_program_leaves_behind_is_found_by_a_walk(tmp_path: Path) -> None:
    """It deletes without overwriting: while the store is open, while it is closed, and as a restored copy."""
    with_rows = [make_clip(number, SMALL_FRAME_BYTES) for number in range(40)]

    def delete(ids: list[bytes], path: Path = tmp_path / DATABASE_FILE_NAME) -> None:
        with closing(sqlite3.connect(path, isolation_level=None)) as other:
            other.execute("PRAGMA secure_delete = OFF")
            other.executemany(
                "DELETE FROM stored_frames WHERE id IN (SELECT id FROM frames WHERE record_id = ? AND place > 0)",
                [(each,) for each in ids],
            )
            other.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()

    ids = [clip.record_id for clip, _ in with_rows]
    async with SqliteStore(tmp_path) as store:
        for clip, frames in with_rows:
            await store.stage(clip, frames)
        await store.sweep()
        delete(ids[:8])
        await store.sweep()
        assert oracle(tmp_path) == 0
    delete(ids[8:16])
    async with SqliteStore(tmp_path):
        assert oracle(tmp_path) == 0
    copy = tmp_path / "restored"
    copy.mkdir()
    await asyncio.to_thread(shutil.copy2, tmp_path / DATABASE_FILE_NAME, copy)
    await asyncio.to_thread(shutil.copy2, tmp_path / f"{DATABASE_FILE_NAME}-swept", copy)
    delete(ids[16:24], copy / DATABASE_FILE_NAME)
    async with SqliteStore(copy) as store:
        assert oracle(copy) == 0
        assert (await store.counts()).frames == 40 * 4 - 24 * 3


CRASHES = ("before", "copied", "cleaned", "cut")


@pytest.mark.parametrize("point", CRASHES)
async def test_a_process_killed_within_a_sweep_leaves_nothing_after_its_next_start(tmp_path: Path, point: str) -> None:
    """A real process that is gone before the pages are copied, then cleaned, before the log is cut, and after it."""
    child = await asyncio.to_thread(
        subprocess.run,
        [sys.executable, "-m", "tests.offchain.killed_sweep", str(tmp_path), point],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.returncode == 9, child.stderr
    gone = [bytes.fromhex(line) for line in child.stdout.split()]
    async with SqliteStore(tmp_path) as store:
        await store.sweep()
        assert oracle(tmp_path) == 0
        files = await asyncio.to_thread(bytes_in, tmp_path)
        assert gone
        assert not [piece for piece in gone if piece in files]


async def test_the_log_is_cut_when_it_has_grown_and_no_page_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("node.custody.stores.sqlite_store.LOG_MAX_BYTES", 200_000)
    async with SqliteStore(tmp_path) as store:
        churn = Churn(store, 5)
        for _ in range(120):
            await churn.step()
            assert (tmp_path / f"{DATABASE_FILE_NAME}-wal").stat().st_size < 1_200_000
        await store.sweep()
        await churn.check(tmp_path)


async def test_a_file_too_large_to_tell_pages_by_their_first_byte_is_walked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("node.custody.stores.sqlite_pages._TOLD_BY_KIND_PAGES_COUNT", 1)
    async with SqliteStore(tmp_path) as store:
        churn = Churn(store, 7)
        for _ in range(40):
            await churn.step()
        with counted(monkeypatch, PageFile, "clean") as walks:
            await store.sweep()
        assert walks == [1]
        await churn.check(tmp_path)


async def test_a_reader_that_holds_the_log_delays_the_sweep_and_hides_no_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("node.custody.stores.sqlite_store.BUSY_TIMEOUT_MS", 50)
    async with SqliteStore(tmp_path) as store:
        churn = Churn(store, 11)
        for _ in range(20):
            await churn.step()
        with closing(sqlite3.connect(tmp_path / DATABASE_FILE_NAME, isolation_level=None)) as reader:
            reader.execute("BEGIN")
            reader.execute("SELECT count(*) FROM frames").fetchall()
            for _ in range(20):
                await churn.step()
            with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE:"):
                await store.sweep()
        for _ in range(5):
            await churn.step()
        await store.sweep()
        await churn.check(tmp_path)


async def test_while_somebody_reads_no_write_waits_for_the_log_to_be_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = 64 * 1024
    monkeypatch.setattr("node.custody.stores.sqlite_store.LOG_MAX_BYTES", limit)
    original, waits_ms = sweeping.Sweeper.sweep, list[int]()

    def noted(sweeper: sweeping.Sweeper, database: sqlite3.Connection) -> int:
        waits_ms.append(database.execute("PRAGMA busy_timeout").fetchone()[0])
        return original(sweeper, database)

    async with SqliteStore(tmp_path) as store:
        churn = Churn(store, 12)
        for _ in range(20):
            await churn.step()
        monkeypatch.setattr(sweeping.Sweeper, "sweep", noted)
        with closing(sqlite3.connect(tmp_path / DATABASE_FILE_NAME, isolation_level=None)) as reader:
            reader.execute("BEGIN")
            reader.execute("SELECT count(*) FROM frames").fetchall()
            for _ in range(60):
                await churn.step()
            log_bytes = (tmp_path / f"{DATABASE_FILE_NAME}-wal").stat().st_size
        assert set(waits_ms) == {0}
        assert len(waits_ms) <= log_bytes // limit + 1
        for _ in range(60):
            await churn.step()
        await store.sweep()
        await churn.check(tmp_path)
    assert waits_ms[-1] > 0


async def test_a_sweep_that_cannot_be_noted_is_one_all_the_same(tmp_path: Path) -> None:
    """Else the connection goes on with its own copies of what was overwritten, and no erasure can be confirmed."""
    note = tmp_path / f"{DATABASE_FILE_NAME}-swept"
    async with SqliteStore(tmp_path) as store:
        churn = Churn(store, 14)
        for _ in range(5):
            for _ in range(20):
                await churn.step()
            note.unlink(missing_ok=True)
            note.mkdir()  # so that no file of this name can be written
            await store.sweep()
            note.rmdir()
            await churn.check(tmp_path)


def test_no_log_and_an_empty_one_name_no_pages(tmp_path: Path) -> None:
    (tmp_path / "empty").touch()
    assert read_written_pages(tmp_path / "none") == read_written_pages(tmp_path / "empty") == frozenset()

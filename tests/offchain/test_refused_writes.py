"""What a store says of clips that it did not write: of these nothing is there, also not later."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pymongo.errors import ConnectionFailure

from consensus.errors import BlockRobotError
from node.clips_place import read_place
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.open_store import open_store
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import refused
from tests.offchain.stored_clips import make_clip

FAILING_COMMIT = """
PRAGMA foreign_keys = ON;
CREATE TABLE parents (id INTEGER PRIMARY KEY);
CREATE TABLE children (parent INTEGER REFERENCES parents DEFERRABLE INITIALLY DEFERRED);
CREATE TRIGGER broken AFTER INSERT ON clips BEGIN INSERT INTO children VALUES (1); END;
"""


async def test_a_blob_that_its_place_refuses_keeps_no_other_clip_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = [make_clip(number) for number in range(3)]
    place = read_place("folder:blobs", tmp_path)
    async with open_store("sqlite", tmp_path / "custody", clips=place) as opened:
        store: Any = opened
        (bad, frames), text = clips[1], clips[1][1][0].ciphertext
        put = store._blobs.put

        async def refuse(name: str, content: bytes) -> None:
            if content.startswith(text):
                raise BlockRobotError("STORE_UNAVAILABLE", "too large")
            await put(name, content)

        with monkeypatch.context() as patch:
            patch.setattr(store._blobs, "put", refuse)
            unwritten = await store.stage_all(clips)
            assert [(key, error.code) for key, error in unwritten.items()] == [(bad.record_id, "STORE_UNAVAILABLE")]
            assert bad.record_id not in await store.clips([clip.record_id for clip, _ in clips])
            await refused("STORE_UNAVAILABLE", store.stage(bad, frames))
            await refused("STORE_UNAVAILABLE", store.replace_frames(bad.record_id, frames))
        assert await store.stage_all(clips) == {}
        for clip, rows in clips:
            assert await store.frames(clip.record_id) == list(rows)


async def test_without_room_nothing_is_written_and_nothing_in_doubt(tmp_path: Path) -> None:
    def no_room() -> None:
        raise BlockRobotError("DISK_RESERVE_REACHED")

    async with SqliteStore(tmp_path) as store:
        store._require_space = no_room
        unwritten = await store.stage_all([make_clip(1), make_clip(2)])
    assert {error.code for error in unwritten.values()} == {"DISK_RESERVE_REACHED"}
    assert len(unwritten) == 2


async def test_a_commit_that_fails_is_in_doubt_and_the_next_write_is_done(tmp_path: Path) -> None:
    first, second = make_clip(1), make_clip(2)
    async with SqliteStore(tmp_path) as store:
        await store._in_worker(lambda: store._opened().executescript(FAILING_COMMIT))
        await refused("STORE_UNAVAILABLE", store.stage_all([first]))
        await store._in_worker(lambda: store._opened().executescript("DROP TRIGGER broken"))
        assert await store.stage_all([second]) == {}
        assert list(await store.clips([first[0].record_id, second[0].record_id])) == [second[0].record_id]


@pytest.mark.parametrize("has_transactions", [True, False])
async def test_only_a_transaction_that_was_not_committed_is_no_doubt(
    mongo_database: str, monkeypatch: pytest.MonkeyPatch, has_transactions: bool
) -> None:
    clip, frames = make_clip(1)

    async def fail(_store: MongoStore, _name: str, _rows: object) -> None:
        raise BlockRobotError("STORE_UNAVAILABLE") from ConnectionFailure("lost")

    async with MongoStore(mongo_database) as store:
        store.has_transactions = has_transactions
        with monkeypatch.context() as patch:
            patch.setattr(MongoStore, "_insert", fail)
            if has_transactions:
                assert list(await store.stage_all([(clip, frames)])) == [clip.record_id]
            await refused("STORE_UNAVAILABLE", store.stage(clip, frames))
        assert await store.clips([clip.record_id]) == {}
        assert await store.stage_all([(clip, frames)]) == {}
        assert await store.clips([clip.record_id]) == {clip.record_id: clip}

"""A move of a custodian that was cut off: begun again after its node ran, or given up for another place."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from consensus.errors import BlockRobotError
from network.cli.node.custody_move_commands import move
from node.clips_place import ClipsPlace, read_place
from node.config import load_config
from node.custody import moving
from node.custody.blobs import place_file
from node.custody.blobs.blob_store import OWNER_NAME
from node.custody.moving import COPYING_NAME, MOVED_NAME, MOVING_NAME, give_up_move, move_custody
from node.custody.stores import copying
from node.custody.stores.custody_store import BlockEffects, CustodyStore
from node.custody.stores.open_store import open_index, open_store
from node.custody.uploads.upload_usage import DayUse
from tests.offchain.house import read_all
from tests.offchain.small_chain import erasure
from tests.offchain.stored_clips import make_clip
from tests.offchain.test_moving_custody import Life, config_in

ROBOT, BACKGROUND = b"\x02" * 33, b"\xf1" * 32
CLIPS_COUNT = 5


@pytest.fixture
async def life(tmp_path: Path) -> Life:
    config_in(tmp_path / "node")
    life = Life(tmp_path / "node")
    await life.begin()
    async with life.house.open():
        await life.house.store.add_use(DayUse(3, ROBOT, 70))
    return life


def cut_at(step: int) -> Any:
    def tell(done: int, _all: int) -> None:
        if done == step:
            raise OSError("power cut")

    return tell


async def cut_off(life: Life, store: str, clips: ClipsPlace | None, step: int = 3) -> None:
    with pytest.raises(OSError, match="power cut"):
        await move_custody(load_config(life.data_dir), store, clips, cut_at(step))


async def run_meanwhile(life: Life) -> None:
    """Something of each kind goes or changes while the node runs."""
    house = life.house
    async with house.open() as custodian:
        await house.store.delete_backgrounds([BACKGROUND])
        await house.store.add_use(DayUse(3, ROBOT, 5))
        await house.store.apply(BlockEffects(settled=tuple(row.key for row in await custodian.ready_outbox(9))))
        await custodian.eraser.drop_staged([life.staged.record_id])
        await house.follow(erasure(b"\xe7" * 32, life.shared), erasure(b"\xe8" * 32, life.kept, frames=(0,)))


async def rows_of(store: CustodyStore) -> dict[str, Any]:
    found: dict[str, Any] = {name: [row async for row in rows] for name, rows in copying._all_rows(store).items()}
    found["frames"] = {clip.record_id: await store.frames(clip.record_id) for clip in found["clips"]}
    found["part"] = [await store.part(place.grant_id, place.record_id) for place in found["parts of keys"]]
    found |= {"outbox": await copying._outbox(store), "restrictions": await store.visit_restrictions()}
    found |= {"backgrounds": await store.background_digests(), "uses": await store.day_uses()}
    counts = dataclasses.replace(await store.counts(), size_bytes=None)
    return found | {"checkpoint": await store.checkpoint(), "counts": counts}


async def typed(life: Life, *options: str) -> Result:
    return await asyncio.to_thread(CliRunner().invoke, move, [str(life.data_dir), *options])


def files_in(folder: Path | None) -> list[str]:
    assert folder is not None
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


async def check_finished(life: Life, store: str, clips: ClipsPlace | None) -> None:
    async with open_store("sqlite", life.data_dir / MOVED_NAME) as old:
        before = await rows_of(old)
    async with life.store() as new:
        assert await rows_of(new) == before
        assert await new.sweep_blobs() == 0
    assert (load_config(life.data_dir).custody_store, load_config(life.data_dir).clips) == (store, clips)
    assert not (life.data_dir / COPYING_NAME).exists()
    assert not (life.data_dir / MOVING_NAME).exists()
    if clips is not None:
        assert len(files_in(clips.folder)) == 1 + sum(bool(frames) for frames in before["frames"].values())
    async with life.house.open() as custodian:
        assert read_all(life.cut, await custodian.export(life.cut.record_id))[1] is None


@pytest.mark.parametrize("step", [1, CLIPS_COUNT])
async def test_a_move_begun_again_after_the_node_ran_keeps_what_there_is_now(life: Life, step: int) -> None:
    there = read_place("folder:blobs", life.data_dir)
    await cut_off(life, "sqlite", there, step)
    await run_meanwhile(life)
    await move_custody(load_config(life.data_dir), "sqlite", there)
    await check_finished(life, "sqlite", there)


@pytest.mark.parametrize("what", ["_require_same", "_outbox"])
async def test_one_that_is_cut_off_when_it_compares_is_begun_again_as_well(
    life: Life, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    there = read_place("folder:blobs", life.data_dir)

    async def cut(*_: Any) -> Any:
        raise OSError("power cut")

    for _ in range(2):
        with monkeypatch.context() as patch:
            patch.setattr(copying, what, cut)
            await cut_off(life, "sqlite", there, step=99)
    await run_meanwhile(life)
    await move_custody(load_config(life.data_dir), "sqlite", there)
    await check_finished(life, "sqlite", there)


async def test_one_that_is_cut_off_when_all_is_copied_is_begun_again_as_well(
    life: Life, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, original = read_place("folder:blobs", life.data_dir), Path.replace

    def cut(path: Path, target: Path) -> Path:
        if path.name == COPYING_NAME:
            raise OSError("power cut")
        return original(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", cut)
        await cut_off(life, "sqlite", there, step=99)
    await run_meanwhile(life)
    await move_custody(load_config(life.data_dir), "sqlite", there)
    await check_finished(life, "sqlite", there)


@pytest.mark.parametrize("has_blobs", [False, True])
async def test_a_move_to_mongodb_is_begun_again_with_an_empty_database(
    life: Life, mongo_database: str, has_blobs: bool
) -> None:
    there = read_place("folder:blobs", life.data_dir) if has_blobs else None
    await cut_off(life, mongo_database, there)
    async with open_index(mongo_database, life.data_dir) as index:
        await index.put_background(b"\xf2" * 32, b"stale")
    await run_meanwhile(life)
    await move_custody(load_config(life.data_dir), mongo_database, there)
    await check_finished(life, mongo_database, there)


async def test_a_database_of_another_custodian_is_refused_and_not_emptied(
    life: Life, mongo_database: str, tmp_path: Path
) -> None:
    clip, frames = make_clip(1)
    async with open_index(mongo_database, tmp_path) as index:
        await index.stage(clip, frames)
    for _ in range(2):
        with pytest.raises(BlockRobotError, match=r"^FILE_EXISTS: .*name an empty one"):
            await move_custody(load_config(life.data_dir), mongo_database, None)
        with pytest.raises(BlockRobotError, match=r"^NO_MOVE_CUT_OFF"):
            await give_up_move(load_config(life.data_dir))
    async with open_index(mongo_database, tmp_path) as index:
        assert await index.frames(clip.record_id) == frames


async def test_what_differs_at_the_new_place_ends_the_move(life: Life, monkeypatch: pytest.MonkeyPatch) -> None:
    there, outbox = read_place("folder:blobs", life.data_dir), copying._outbox

    async def forgetful(store: CustodyStore) -> Any:
        return (await outbox(store))[type(store).__name__ != "SqliteStore" :]

    with monkeypatch.context() as patch:
        patch.setattr(copying, "_outbox", forgetful)
        with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE: .*other owed transactions"):
            await move_custody(load_config(life.data_dir), "sqlite", there)
    await life.check()


async def test_a_move_that_was_cut_off_is_given_up_for_another_place(life: Life) -> None:
    first, other = (read_place(f"folder:{name}", life.data_dir) for name in ("first", "other"))
    await cut_off(life, "sqlite", first)
    refusal = r"cut off \(rows to SQLite, clips to folder:first\).*is where it was.*--give-up"
    with pytest.raises(BlockRobotError, match=refusal):
        await move_custody(load_config(life.data_dir), "sqlite", other)
    assert len(files_in(first.folder)) > 1
    result = await typed(life, "--give-up", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["clips"] == 0
    assert files_in(first.folder) == []
    assert not (life.data_dir / MOVING_NAME).exists()
    assert json.loads((await typed(life, "--give-up", "--json")).stdout)["error"]["code"] == "NO_MOVE_CUT_OFF"
    assert "takes no new place" in (await typed(life, "--give-up", "--clips", "store")).output
    await move_custody(load_config(life.data_dir), "sqlite", other)
    shutil.rmtree(life.data_dir / MOVED_NAME)
    await move_custody(load_config(life.data_dir), "sqlite", first)
    await life.check()


async def test_giving_up_that_is_cut_off_is_begun_again(life: Life, monkeypatch: pytest.MonkeyPatch) -> None:
    there = read_place("folder:first", life.data_dir)
    await cut_off(life, "sqlite", there)

    def cut(*_: Any, **__: Any) -> None:
        raise OSError("power cut")

    for module, name in ((place_file, "_note"), (moving, "_remove_folder")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, cut)
            with pytest.raises(OSError, match="power cut"):
                await give_up_move(load_config(life.data_dir))
    await give_up_move(load_config(life.data_dir))
    assert files_in(there.folder) == []
    await life.check()


async def test_a_disk_that_is_not_mounted_has_nothing_to_give_up(life: Life, tmp_path: Path) -> None:
    there = read_place("folder:first", life.data_dir)
    await cut_off(life, "sqlite", there)
    assert there.folder is not None
    there.folder.rename(tmp_path / "disk")
    for work in (give_up_move(load_config(life.data_dir)), move_custody(load_config(life.data_dir), "sqlite", there)):
        with pytest.raises(BlockRobotError, match=r"^CLIPS_NOT_THERE"):
            await work
    (tmp_path / "disk").rename(there.folder)
    await give_up_move(load_config(life.data_dir))
    assert files_in(there.folder) == []


async def test_a_place_that_could_not_be_taken_has_to_be_given_up_by_nobody(life: Life, tmp_path: Path) -> None:
    taken, free = (read_place(f"folder:{name}", life.data_dir) for name in ("taken", "free"))
    async with open_store("sqlite", tmp_path / "other", clips=taken):
        pass
    with pytest.raises(BlockRobotError, match="another custodian's"):
        await move_custody(load_config(life.data_dir), "sqlite", taken)
    await move_custody(load_config(life.data_dir), "sqlite", free)
    assert files_in(taken.folder) == [OWNER_NAME]
    await life.check()


async def test_a_move_of_the_rows_alone_that_is_given_up_leaves_the_clips(life: Life, mongo_database: str) -> None:
    there = read_place("folder:blobs", life.data_dir)
    await move_custody(load_config(life.data_dir), "sqlite", there)
    shutil.rmtree(life.data_dir / MOVED_NAME)
    before = files_in(there.folder)
    await cut_off(life, mongo_database, there)
    await give_up_move(load_config(life.data_dir))
    assert files_in(there.folder) == before
    await cut_off(life, mongo_database, there)
    other_words = dataclasses.replace(there, region="elsewhere")
    with pytest.raises(BlockRobotError, match="another custodian's"):
        await move_custody(load_config(life.data_dir), mongo_database, other_words)
    assert files_in(there.folder) == before
    await move_custody(load_config(life.data_dir), mongo_database, there)
    assert files_in(there.folder) == before
    await life.check()


async def test_a_clip_that_is_half_written_stays_behind(tmp_path: Path, mongo_database: str) -> None:
    config_in(tmp_path / "node", mongo_database)
    life = Life(tmp_path / "node")
    await life.begin()
    clip, frames = make_clip(1)
    async with life.store() as store:
        await store.stage(clip, frames)
        await store._collection("clips").update_one({"_id": clip.record_id}, {"$set": {"status": "staging"}})
    counts = await move_custody(load_config(life.data_dir), "sqlite", None)
    assert (counts.staged, counts.confirmed, counts.erased) == (1, 3, 1)
    await life.check()

"""A custodian's clips moved to another store or place: none is lost, and a power cut anywhere leaves it before or after."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.cli.node.custody_move_commands import move
from node.clips_place import ClipsPlace, read_place
from node.config import NodeConfig, config_to_toml, load_config
from node.custody import moving
from node.custody.moving import MOVED_NAME, finish_move, move_custody, require_no_move
from node.custody.stores.open_store import open_store
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import ALICE, EXPIRES_MS, access, erasure, record_clip, recorded
from tests.offchain.test_sharing import asked, granted, parts_for, request

STEPS_MAX_COUNT = 40
GRANT_ID = b"\xb7" * 32


def config_in(data_dir: Path, store: str = "sqlite", clips: ClipsPlace | None = None) -> NodeConfig:
    paths = {name: data_dir / "keys" / name for name in ("tls.crt", "tls.key", "custodian.key")}
    config = NodeConfig(
        data_dir,
        "node-1",
        data_dir / "genesis.json",
        "127.0.0.1",
        7001,
        7002,
        7003,
        paths["tls.crt"],
        paths["tls.key"],
        None,
        paths["custodian.key"],
        store,
        "info",
        clips=clips,
    )
    data_dir.mkdir(exist_ok=True)
    (data_dir / "node.toml").write_text(config_to_toml(config))
    assert load_config(data_dir) == config
    return config


class Life:
    """A custodian with clips of every kind, and what must still hold of them after a move."""

    def __init__(self, data_dir: Path) -> None:
        self.data_dir = data_dir
        self.house = CustodianHarness(self.store, data_dir / "erase-keys")
        self.kept, self.cut, self.gone, self.shared, self.staged, self.absent = (record_clip() for _ in range(6))

    def store(self) -> Any:
        config = load_config(self.data_dir)
        require_no_move(self.data_dir)
        return open_store(config.custody_store, config.custody_dir, clips=config.clips)

    async def begin(self) -> None:
        house = self.house
        async with house.open() as custodian:
            for clip in (self.kept, self.cut, self.gone, self.shared, self.staged):
                await custodian.stage(clip.upload)
            held = (self.kept, self.cut, self.gone, self.shared, self.absent)
            await house.follow(*(recorded(clip, expires_at_ms=EXPIRES_MS + 9_999_999) for clip in held))
            await custodian.stage_part(
                parts_for(self.shared, GRANT_ID, valid_until_ms=house.chain.time_ms + 60_000)[custodian._member], ALICE
            )
            await house.follow(granted(self.shared, grant_id=GRANT_ID))
            await house.follow(asked(self.shared, grant_id=GRANT_ID, access_id=GRANT_ID))
            await house.follow(
                access(ACCESS_ID, self.kept),
                erasure(ERASURE_ID, self.cut, frames=(1,)),
                erasure(b"\xe9" * 32, self.gone),
            )
            await house.store.put_background(b"\xf1" * 32, b"empty")
            self.owed = await house.ready_outbox()

    async def check(self) -> None:
        house = self.house
        async with house.open() as custodian:
            assert await house.ready_outbox() == self.owed
            found = await custodian.download(self.kept.record_id, ACCESS_ID, ALICE)
            assert read_all(self.kept, found) == list(self.kept.plaintexts)
            cut = await custodian.export(self.cut.record_id)
            assert read_all(self.cut, cut) == [self.cut.plaintexts[0], None, self.cut.plaintexts[2]]
            await refused("CLIP_ERASED", custodian.export(self.gone.record_id))
            assert (await custodian.download_shared(request(self.shared, GRANT_ID), GRANT_ID)).package
            assert [facts.record_id for facts in await custodian.missing(9)] == [self.absent.record_id]
            assert await custodian.get_background(b"\xf1" * 32) == b"empty"
            assert sorted([slot async for slot in house.store.slots_in_use()]) == house.keys.held
            await house.follow(recorded(self.staged))
            assert read_all(self.staged, await custodian.export(self.staged.record_id)) == list(self.staged.plaintexts)


@pytest.fixture
async def life(tmp_path: Path) -> Life:
    config_in(tmp_path / "node")
    life = Life(tmp_path / "node")
    await life.begin()
    return life


async def test_from_rows_to_a_folder_and_back(life: Life) -> None:
    config = load_config(life.data_dir)
    there = read_place("folder:blobs", life.data_dir)
    told: list[tuple[int, int]] = []
    counts = await move_custody(config, "sqlite", there, lambda done, all_of: told.append((done, all_of)))
    assert (counts.confirmed, counts.staged, counts.erased, told[-1]) == (3, 1, 1, (5, 5))
    moved = load_config(life.data_dir)
    assert moved == dataclasses.replace(config, clips=there)
    with pytest.raises(BlockRobotError, match="delete it"):
        await move_custody(moved, "sqlite", None)
    shutil.rmtree(life.data_dir / MOVED_NAME)
    await move_custody(moved, "sqlite", None)
    assert load_config(life.data_dir) == config
    await life.check()


async def test_from_sqlite_to_mongodb_and_an_s3_bucket_and_back(
    life: Life, mongo_database: str, s3_place: ClipsPlace
) -> None:
    config = load_config(life.data_dir)
    await move_custody(config, mongo_database, s3_place)
    async with life.house.open() as custodian:
        assert read_all(life.kept, await custodian.export(life.kept.record_id)) == list(life.kept.plaintexts)
    shutil.rmtree(life.data_dir / MOVED_NAME)
    moved = load_config(life.data_dir)
    with pytest.raises(BlockRobotError, match="name a new database"):
        await move_custody(moved, mongo_database, None)
    await move_custody(moved, "sqlite", None)
    await life.check()


async def test_the_rows_move_alone_and_the_clips_stay_where_they_are(life: Life, mongo_database: str) -> None:
    there = read_place("folder:blobs", life.data_dir)
    await move_custody(load_config(life.data_dir), "sqlite", there)
    assert there.folder is not None
    before = {path: path.stat().st_ino for path in there.folder.rglob("*")}
    for store in (mongo_database, "sqlite"):
        shutil.rmtree(life.data_dir / MOVED_NAME)
        counts = await move_custody(load_config(life.data_dir), store, there)
        assert (counts.confirmed, counts.staged, counts.erased) == (3, 1, 1)
        assert (load_config(life.data_dir).custody_store, load_config(life.data_dir).clips) == (store, there)
        assert {path: path.stat().st_ino for path in there.folder.rglob("*")} == before
    await life.check()


def test_the_same_command_finishes_a_move_that_was_cut_off_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data_dir = tmp_path / "node"
    safe = tmp_path / "safe"
    text = config_to_toml(config_in(data_dir)).replace("keys/", f"{safe}/")
    (data_dir / "node.toml").write_text(text)
    life = Life(data_dir)
    asyncio.run(life.begin())
    typed = [str(data_dir), "--clips", "folder:blobs", "--json"]
    with monkeypatch.context() as patches:
        patches.setattr(moving, "finish_move", lambda _data_dir: os._exit(9))
        child = os.fork()
        if not child:
            CliRunner().invoke(move, typed)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    assert load_config(data_dir).clips is None
    again = CliRunner().invoke(move, typed)
    assert again.exit_code == 0, again.output
    answer = json.loads(again.stdout)
    assert (answer["clips"], answer["old"], answer["left"]) == (4, str(data_dir / MOVED_NAME), [])
    assert load_config(data_dir).tls_key_path == safe / "tls.key"
    refusal = json.loads(CliRunner().invoke(move, typed).stdout)["error"]
    assert refusal["code"] == "CONFIGURATION_INVALID"
    asyncio.run(life.check())
    shutil.rmtree(data_dir / MOVED_NAME)
    was = load_config(data_dir).clips
    onward = CliRunner().invoke(move, [str(data_dir), "--clips", "folder:elsewhere", "--json"])
    assert was is not None
    assert json.loads(onward.stdout)["left"] == [was.url], "the old place is left full, so it is named"
    asyncio.run(life.check())


async def test_a_move_to_where_it_is_or_onto_another_custodians_clips_is_refused(life: Life, tmp_path: Path) -> None:
    config = load_config(life.data_dir)
    with pytest.raises(BlockRobotError, match="there already"):
        await move_custody(config, "sqlite", None)
    taken = read_place(f"folder:{tmp_path / 'taken'}", tmp_path)
    async with open_store("sqlite", tmp_path / "other", clips=taken):
        pass
    with pytest.raises(BlockRobotError, match="another custodian's"):
        await move_custody(config, "sqlite", taken)
    await life.check()


async def test_a_move_that_is_cut_off_anywhere_is_finished_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut before each clip, each file that gets its name, and each folder."""
    for step in range(1, STEPS_MAX_COUNT):
        data_dir, done = tmp_path / str(step), [0]
        config_in(data_dir)
        life = Life(data_dir)
        await life.begin()

        def cut(step: int = step, done: list[int] = done) -> None:
            done[0] += 1
            if done[0] == step:
                raise OSError("power cut")

        def before(original: Any, cut: Any = cut) -> Any:
            return lambda *arguments: (cut(), original(*arguments))[1]

        there = read_place("folder:blobs", data_dir)
        with monkeypatch.context() as patches:
            for name in ("rename", "replace"):
                patches.setattr(Path, name, before(getattr(Path, name)))
            try:
                await move_custody(load_config(data_dir), "sqlite", there, lambda _done, _all, cut=cut: cut())
                was_cut = False
            except (OSError, BlockRobotError):
                was_cut = True
        if (data_dir / moving.SETTINGS_NAME).exists():
            with pytest.raises(BlockRobotError, match="cut off"):
                require_no_move(data_dir)
        if not finish_move(data_dir) and was_cut:
            await move_custody(load_config(data_dir), "sqlite", there)
        assert load_config(data_dir).clips == there
        await life.check()
        if not was_cut:
            break
    assert 12 < step < STEPS_MAX_COUNT - 1

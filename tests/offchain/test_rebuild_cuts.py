"""A rebuild that ends at any single write: no byte that is right is lost, whatever the server has of transactions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from pymongo import MongoClient

from node.custody.stores.custody_store import BlockEffects, CustodyStore
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.desk import CustodyHarness, Peer
from tests.offchain.house import CustodianHarness, read_all
from tests.offchain.small_chain import EXPIRES_MS, RecordedClip, record_clip
from tests.offchain.test_every_write_point import Cutter, PowerCutError

STEPS_MAX_COUNT = 60


class RowCutter(Cutter):
    """Cuts a server's writes of clips and frames alone, so that few commands are to be tried."""

    def install(self, patches: pytest.MonkeyPatch) -> None:
        for name in ("_bulk", "_insert", "_delete"):
            original = getattr(MongoStore, name)
            patches.setattr(MongoStore, name, self._around_rows(original))

    def _around_rows(self, original: Callable[..., Any]) -> Callable[..., Any]:
        guarded = self.around_async(original)

        async def write(store: MongoStore, name: str, what: Any) -> None:
            await (guarded if what and name in {"clips", "frames"} else original)(store, name, what)

        return write


async def _differ(desk: CustodyHarness, clip: RecordedClip) -> None:
    """The index says another expiry than the chain; every frame is sound."""
    await desk.house.store.apply(BlockEffects(expiries=((clip.record_id, EXPIRES_MS + 1),)))


async def _damage(desk: CustodyHarness, clip: RecordedClip) -> None:
    """The bytes of the first frame are not what they were; the others are sound."""
    store = desk.house.store
    [held], frames = (await store.clips([clip.record_id])).values(), await store.frames(clip.record_id)
    await store.stage(held, [replace(frames[0], ciphertext=bytes(len(frames[0].ciphertext))), *frames[1:]])


Harm = Callable[[CustodyHarness, RecordedClip], object]


async def _cut_off(house: CustodianHarness, harm: Harm, cutter: Cutter, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Rebuild with one power cut; return whether there still was a write to cut. Sound frames must be there throughout."""
    clip, sound, desk = record_clip(), 0 if harm is _differ else 1, CustodyHarness(house)
    async with house.open():
        await desk.hold(clip)
        await harm(desk, clip)  # type: ignore[misc]
        with monkeypatch.context() as patches:
            cutter.install(patches)
            try:
                await desk.rebuild(Peer(clip))
                was_cut = False
            except PowerCutError:
                was_cut = True
    async with house.open() as custodian:
        held = await custodian.look_at(clip.record_id)
        for index, frame in enumerate(held.frames):
            text, key = clip.upload.ciphertexts[index], clip.upload.sealed_keys[index]
            assert index < sound or (frame.ciphertext, frame.sealed_key) == (text, key)
        await house.follow()
        assert (await desk.rebuild(Peer(clip))).is_whole
        assert read_all(clip, await custodian.export(clip.record_id)) == list(clip.plaintexts)
        assert (await desk.scrub()).is_clean
        assert house.keys.held_count == len(clip.plaintexts)
    return was_cut


@pytest.mark.parametrize("harm", [_differ, _damage])
@pytest.mark.parametrize("kind", ["sqlite", "mongo", "single mongo"])
async def test_a_rebuild_cut_off_at_any_write_loses_no_byte_that_is_right(
    kind: str, harm: Harm, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    uri = None if kind == "sqlite" else request.getfixturevalue("mongo_database")
    if kind == "single mongo":
        monkeypatch.setattr("node.custody.stores.mongo_store._tells_of_transactions", lambda _hello: False)
    for step in range(1, STEPS_MAX_COUNT):
        folder = tmp_path / str(step)

        def make_store(folder: Path = folder) -> CustodyStore:
            return SqliteStore(folder / "custody") if uri is None else MongoStore(uri)

        cutter = (Cutter if uri is None else RowCutter)(step, after=True)
        if not await _cut_off(CustodianHarness(make_store, folder / "keys"), harm, cutter, monkeypatch):
            break
        if uri is not None:
            with MongoClient(uri) as client:
                database = client[urlsplit(uri).path.lstrip("/")]
                for name in set(database.list_collection_names()) - {"format"}:
                    database[name].delete_many({})
    assert 1 < step < STEPS_MAX_COUNT - 1

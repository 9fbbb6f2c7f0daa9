"""A power cut at every write by which shares begin and end: a key's bytes, a transaction, a command to the server."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

import pytest
from pymongo import MongoClient

from consensus.errors import BlockRobotError
from node.custody.finalized_events import FinalizedEvents
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import ERASURE_ID, House
from tests.offchain.small_chain import ALICE, CUSTODIAN, EXPIRES_MS, START_MS, erasure, record_clip, recorded
from tests.offchain.test_every_write_point import STEPS_MAX_COUNT, Cutter, PowerCutError
from tests.offchain.test_sharing import asked, granted, parts_for, request, revoked

GRANTED, REVOKED, OVER, ERASED, LAPSED = (bytes((0xA0 + number,)) * 32 for number in range(5))
AT_MS = START_MS + 50_000
CHUNKS_COUNT = 6


class Story:
    """One block that makes a grant final, revokes one, erases a shared record, and ends two shares by time."""

    def __init__(self, house: House) -> None:
        self.house = house
        self.clips = {name: record_clip() for name in (GRANTED, REVOKED, OVER, ERASED, LAPSED)}

    async def prepare(self) -> FinalizedEvents:
        custodian, clips = self.house.custodian, self.clips
        for clip in clips.values():
            await custodian.stage(clip.upload)
        await self.house.follow(*(recorded(clip, expires_at_ms=EXPIRES_MS) for clip in clips.values()))
        for name, clip in clips.items():
            valid_until_ms = AT_MS if name == LAPSED else AT_MS + 60_000
            await custodian.stage_part(parts_for(clip, name, valid_until_ms=valid_until_ms)[CUSTODIAN], ALICE)
        early = [granted(clips[name], grant_id=name) for name in (REVOKED, ERASED)]
        await self.house.follow(*early, granted(clips[OVER], grant_id=OVER, until_ms=AT_MS))
        await self.house.follow(asked(clips[REVOKED], grant_id=REVOKED))
        events = (
            granted(clips[GRANTED], grant_id=GRANTED, until_ms=EXPIRES_MS),
            asked(clips[GRANTED], grant_id=GRANTED, access_id=GRANTED),
            revoked(REVOKED),
            erasure(ERASURE_ID, clips[ERASED]),
        )
        return self.house.chain.block(*events, at_ms=AT_MS)

    async def check(self) -> None:
        custodian, store, keys = self.house.custodian, self.house.store, self.house.keys
        kept = [(place.grant_id, place.status) async for place in store.all_parts()]
        assert kept == [(GRANTED, "confirmed")]
        assert [share.grant_id async for share in store.all_shares()] == [GRANTED, ERASED]
        found = await custodian.download_shared(request(self.clips[GRANTED], GRANTED), GRANTED)
        assert found.package
        assert sorted([slot async for slot in store.slots_in_use()]) == keys.held
        assert keys.check_destroyed() == 0
        assert ("access.released", [GRANTED, [self.clips[GRANTED].record_id]]) in await self.house.owed()

    async def check_revoked(self) -> None:
        """From the first destroyed key on nothing of the revoked grant leaves, also before the block is repeated."""
        with pytest.raises(BlockRobotError) as refusal:
            await self.house.custodian.download_shared(request(self.clips[REVOKED]), REVOKED)
        assert refusal.value.code in {"GRANT_ENDED", "GRANT_PARTS_MISSING"}


async def play(house: House, cutter: Cutter, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Play the story with one power cut; return whether there still was a write to cut."""
    async with house.open() as custodian:
        story = Story(house)
        block = await story.prepare()
        with monkeypatch.context() as patches:
            cutter.install(patches)
            try:
                await custodian.on_finalized_block(block)
                was_cut = False
            except PowerCutError:
                was_cut = True
    async with house.open() as custodian:
        for _ in range(2):
            await custodian.on_finalized_block(block)
        await story.check()
        await story.check_revoked()
    return was_cut


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
async def test_a_power_cut_at_every_write_of_the_embedded_store_and_of_the_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    steps = 0
    for step in range(1, STEPS_MAX_COUNT):
        folder = tmp_path / str(step)
        house = House(lambda folder=folder: SqliteStore(folder / "custody"), folder / "erase-keys")
        if not await play(house, Cutter(step, after=after), monkeypatch):
            break
        steps = step
    assert 25 < steps < STEPS_MAX_COUNT - 1


@pytest.mark.parametrize(
    "first", [1, *(pytest.param(first, marks=pytest.mark.long) for first in range(2, 1 + CHUNKS_COUNT))]
)
async def test_a_power_cut_at_every_command_to_the_server(
    tmp_path: Path, mongo_database: str, monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
    """Without transactions, so that the order of the commands has to bear it."""
    monkeypatch.setattr("node.custody.stores.mongo_store._tells_of_transactions", lambda _hello: False)
    steps = 0
    with MongoClient(mongo_database) as client:
        database = client[urlsplit(mongo_database).path.lstrip("/")]
        for step in range(first, STEPS_MAX_COUNT, CHUNKS_COUNT):
            house = House(lambda: MongoStore(mongo_database), tmp_path / str(step))
            if not await play(house, Cutter(step, after=False), monkeypatch):
                break
            steps = step
            for name in set(database.list_collection_names()) - {"format"}:
                database[name].delete_many({})
    assert 20 < steps < STEPS_MAX_COUNT - CHUNKS_COUNT

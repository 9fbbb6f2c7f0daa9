"""A power cut at every single write of a block and of a fetch, down to a key's bytes or a command; and stores that fail.

Two blocks are cut: one by which clips begin and end, and one by which shares do; and clips that are fetched.

What is cut here is lower than in `test_custodian_crashes`: a file's single write, a database's single transaction, a
server's single command, each of them just before it and just after it.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count, product
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
import pytest
from pymongo import MongoClient
from pymongo.errors import NotPrimaryError

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace, read_place
from node.custody.blobs.blob_store import OWNER_NAME
from node.custody.blobs.folder_blobs import FolderBlobs
from node.custody.blobs.s3_blobs import S3Blobs
from node.custody.erase_keys import EraseKeys
from node.custody.finalized_events import FinalizedEvents
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.open_store import open_store
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME, SqliteStore
from tests.offchain import secantus
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import (
    ALICE,
    CUSTODIAN,
    EXPIRES_MS,
    START_MS,
    access,
    empty_frames_withdrawn,
    erasure,
    record_clip,
    recorded,
)
from tests.offchain.test_fetching import Peer, held_by_peer
from tests.offchain.test_sharing import asked, granted, parts_for, request, revoked

LATER_MS = EXPIRES_MS + 9_999_999
SECOND_ID = b"\xe2" * 32
FRAME = b"\xf1" * 32
STEPS_MAX_COUNT = 400
GRANTED, REVOKED, OVER, ERASED, LAPSED = (bytes((0xA0 + number,)) * 32 for number in range(5))
AT_MS = START_MS + 50_000


class PowerCutError(Exception):
    """The process ends here."""


class Cutter:
    """Lets the power fail just before, or just after, the n-th low write."""

    def __init__(self, step: int, *, after: bool) -> None:
        self.step, self.after, self.done = step, after, 0

    def around(self, original: Callable[..., Any]) -> Callable[..., Any]:
        def guarded(*arguments: Any, **named: Any) -> Any:
            self.done += 1
            if self.done == self.step and not self.after:
                raise PowerCutError
            result = original(*arguments, **named)
            if self.done == self.step:
                raise PowerCutError
            return result

        return guarded

    def around_async(self, original: Callable[..., Any]) -> Callable[..., Any]:
        async def guarded(*arguments: Any, **named: Any) -> Any:
            self.done += 1
            if self.done == self.step and not self.after:
                raise PowerCutError
            result = await original(*arguments, **named)
            if self.done == self.step:
                raise PowerCutError
            return result

        return guarded

    def install(self, patches: pytest.MonkeyPatch) -> None:
        patches.setattr(EraseKeys, "_write", self.around(EraseKeys._write))
        patches.setattr(SqliteStore, "_write", self.around_async(SqliteStore._write))
        patches.setattr(SqliteStore, "sweep", self.around_async(SqliteStore.sweep))
        for blobs, name in product((FolderBlobs, S3Blobs), ("put", "delete")):
            patches.setattr(blobs, name, self.around_async(getattr(blobs, name)))
        for name in ("_bulk", "_insert", "_delete"):
            patches.setattr(MongoStore, name, self.around_async(getattr(MongoStore, name)))


class Story:
    """One block that confirms, releases, erases frames, erases a record, purges and expires; and what must come of it."""

    chunks_count, commands_min_count = 4, 25

    def __init__(self, house: CustodianHarness) -> None:
        self.house = house
        self.kept, self.cut, self.gone, self.lapsed, self.expiring = (record_clip() for _ in range(5))

    async def prepare(self) -> FinalizedEvents:
        custodian, chain = self.house.custodian, self.house.chain
        for clip in (self.kept, self.cut, self.gone, self.expiring):
            await custodian.stage(clip.upload)
        early = (recorded(self.cut, expires_at_ms=LATER_MS), recorded(self.gone, expires_at_ms=LATER_MS))
        await self.house.follow(*early, recorded(self.expiring, expires_at_ms=START_MS + 50_000))
        await custodian.stage(msgspec.structs.replace(self.lapsed.upload, valid_until_ms=START_MS + 50_000))
        requests = (erasure(ERASURE_ID, self.cut, frames=(0, 2)), erasure(SECOND_ID, self.gone))
        await self.house.store.put_background(FRAME, b"empty")
        events = (
            recorded(self.kept, expires_at_ms=LATER_MS),
            access(ACCESS_ID, self.kept),
            *requests,
            empty_frames_withdrawn(FRAME, gone=(FRAME,)),
        )
        return chain.block(*events, at_ms=START_MS + 50_000)

    async def act(self, block: FinalizedEvents) -> None:
        await self.house.custodian.on_finalized_block(block)

    async def check(self) -> None:
        custodian, keys = self.house.custodian, self.house.keys
        kept = await custodian.download(self.kept.record_id, ACCESS_ID, ALICE)
        assert read_all(self.kept, kept) == list(self.kept.plaintexts)
        cut = await custodian.export(self.cut.record_id)
        assert read_all(self.cut, cut) == [None, self.cut.plaintexts[1], None]
        for clip in (self.gone, self.expiring):
            await refused("CLIP_ERASED", custodian.export(clip.record_id))
        await refused("NOT_FOUND", custodian.export(self.lapsed.record_id))
        assert keys.held_count == 3 + 1
        assert keys.check_destroyed() == 0
        assert await custodian.get_background(FRAME) is None
        owed = await self.house.ready_outbox()
        assert len(owed) == 4
        receipts = {told[0]: told[1:3] for call, told in owed if call == "erasure.receipt"}
        assert receipts == {ERASURE_ID: [2, "commitment-leaves"], SECOND_ID: [3, "nothing"]}


class SharesStory:
    """One block that makes a grant final, revokes one, erases a shared record, and ends two shares by time."""

    chunks_count, commands_min_count = 6, 20

    def __init__(self, house: CustodianHarness) -> None:
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

    async def act(self, block: FinalizedEvents) -> None:
        await self.house.custodian.on_finalized_block(block)

    async def check(self) -> None:
        custodian, store, keys = self.house.custodian, self.house.store, self.house.keys
        kept = [(place.grant_id, place.status) async for place in store.all_parts()]
        assert kept == [(GRANTED, "confirmed")]
        assert [share.grant_id async for share in store.all_shares()] == [GRANTED, ERASED]
        found = await custodian.download_shared(request(self.clips[GRANTED], GRANTED), GRANTED)
        assert found.package
        assert sorted([slot async for slot in store.slots_in_use()]) == keys.held
        assert keys.check_destroyed() == 0
        assert ("access.released", [GRANTED, [self.clips[GRANTED].record_id]]) in await self.house.ready_outbox()
        with pytest.raises(BlockRobotError) as refusal:
            await self.house.custodian.download_shared(request(self.clips[REVOKED]), REVOKED)
        assert refusal.value.code in {"GRANT_ENDED", "GRANT_PARTS_MISSING"}


class FetchStory:
    """What was missed is fetched, one of it asked for and one in part erased, and a block ends it."""

    chunks_count, commands_min_count = 2, 10

    def __init__(self, house: CustodianHarness) -> None:
        self.house = house
        self.clips = [record_clip() for _ in range(4)]
        self.peer = Peer(*(held_by_peer(clip) for clip in self.clips))

    async def prepare(self) -> FinalizedEvents:
        asked_for, _, cut, _ = self.clips
        await self.house.follow(*(recorded(clip, expires_at_ms=LATER_MS) for clip in self.clips))
        await self.house.follow(access(ACCESS_ID, asked_for), erasure(ERASURE_ID, cut, frames=(1,)))
        return self.house.chain.block()

    async def act(self, block: FinalizedEvents) -> None:
        while await self.house.custodian.fetch_missing([self.peer]):
            pass
        await self.house.custodian.on_finalized_block(block)

    async def check(self) -> None:
        custodian, keys, store = self.house.custodian, self.house.keys, self.house.store
        for clip in self.clips:
            whole = list(clip.plaintexts)
            expected = [whole[0], None, whole[2]] if clip is self.clips[2] else whole
            assert read_all(clip, await custodian.export(clip.record_id)) == expected
        assert await custodian.missing(10) == []
        assert sorted([slot async for slot in store.slots_in_use()]) == keys.held
        assert keys.check_destroyed() == 0
        assert ("access.released", [ACCESS_ID, [self.clips[0].record_id]]) in await self.house.ready_outbox()


class BehindStory:
    """Blocks that only record, and are one write, before one that erases and by which a clip expires."""

    chunks_count, commands_min_count = 3, 6

    def __init__(self, house: CustodianHarness) -> None:
        self.house = house
        self.here, self.gone, self.expiring, self.missed = (record_clip() for _ in range(4))
        self.blocks: list[FinalizedEvents] = []

    async def prepare(self) -> FinalizedEvents:
        for clip in (self.here, self.gone, self.expiring):
            await self.house.custodian.stage(clip.upload)
        block, late = self.house.chain.block, {"expires_at_ms": LATER_MS}
        self.blocks = [
            block(recorded(self.here, **late), recorded(self.missed, **late)),
            block(recorded(self.gone, **late)),
            block(recorded(self.expiring, expires_at_ms=AT_MS)),
            block(erasure(ERASURE_ID, self.gone), at_ms=AT_MS),
        ]
        return self.blocks[-1]

    async def act(self, _block: FinalizedEvents) -> None:
        await self.house.custodian.on_finalized_blocks(self.blocks)

    async def check(self) -> None:
        custodian, keys, store = self.house.custodian, self.house.keys, self.house.store
        assert (await custodian.checkpoint()) == self.blocks[-1].checkpoint
        assert read_all(self.here, await custodian.export(self.here.record_id)) == list(self.here.plaintexts)
        assert [facts.record_id for facts in await custodian.missing(10)] == [self.missed.record_id]
        for clip in (self.gone, self.expiring):
            await refused("CLIP_ERASED", custodian.export(clip.record_id))
        assert sorted([slot async for slot in store.slots_in_use()]) == keys.held
        assert {call for call, _ in await self.house.ready_outbox()} == {"erasure.receipt", "erasure.expired"}


Kind = type[Story] | type[SharesStory] | type[FetchStory] | type[BehindStory]


async def play(kind: Kind, house: CustodianHarness, cutter: Cutter, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Play a story with one power cut; return whether there still was a write to cut."""
    async with house.open():
        story = kind(house)
        block = await story.prepare()
        with monkeypatch.context() as patches:
            cutter.install(patches)
            try:
                await story.act(block)
                was_cut = False
            except PowerCutError:
                was_cut = True
    async with house.open():
        for _ in range(2):
            await story.act(block)
        await story.check()
    return was_cut


IN_TURN = pytest.mark.parametrize("first", [1, pytest.param(2, marks=pytest.mark.long)])
"""A cut just after a write leaves what one just before the next leaves: cut both ways, every second write shows all."""


@IN_TURN
@pytest.mark.parametrize("kind", [Story, SharesStory, FetchStory, BehindStory])
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
async def test_a_power_cut_at_every_write_of_the_embedded_store_and_of_the_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool, kind: Kind, first: int
) -> None:
    steps = 0
    for step in range(first, STEPS_MAX_COUNT, 2):
        folder = tmp_path / str(step)
        house = CustodianHarness(lambda folder=folder: SqliteStore(folder / "custody"), folder / "erase-keys")
        if not await play(kind, house, Cutter(step, after=after), monkeypatch):
            break
        steps = step
    assert kind.commands_min_count < steps < STEPS_MAX_COUNT - 2


@IN_TURN
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
async def test_a_power_cut_at_every_write_of_a_folder_of_clips(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool, first: int
) -> None:
    steps = range(first, STEPS_MAX_COUNT, 2)
    await cut_everywhere_with_clips_apart(
        lambda data: read_place("folder:blobs", data), tmp_path, monkeypatch, after, steps
    )


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
async def test_a_power_cut_at_every_write_to_an_s3_server(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool, s3_place: ClipsPlace
) -> None:
    places = (replace(s3_place, prefix=f"{number}/") for number in count())
    steps = range(1, STEPS_MAX_COUNT, 4 + after)  # an answer takes its time: the two cuts share the steps
    await cut_everywhere_with_clips_apart(lambda _data: next(places), tmp_path, monkeypatch, after, steps)


async def cut_everywhere_with_clips_apart(
    place_of: Callable[[Path], ClipsPlace], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool, steps: range
) -> None:
    last = 0
    for step in steps:
        data = tmp_path / str(step)
        make = partial(open_store, "sqlite", data / "custody", clips=place_of(data))
        house = CustodianHarness(make, data / "erase-keys")
        if not await play(Story, house, Cutter(step, after=after), monkeypatch):
            break
        last = step
        async with house.open():
            store: Any = house.store
            assert await store.sweep_blobs() in {0, 1}
            left = [store._names.read(name) async for name in store._blobs.names() if name != OWNER_NAME]
            held = [record_id async for record_id in store.records_with_frames()]
            assert sorted(meant[0] for meant in left) == sorted(held)
    assert 30 < last < steps[-1]


@pytest.mark.parametrize(
    ("kind", "first", "has_transactions"),
    [
        *((kind, 1, True) for kind in (Story, FetchStory, BehindStory)),
        *((kind, 1, False) for kind in (Story, SharesStory, FetchStory, BehindStory)),
        *(
            pytest.param(kind, first, False, marks=pytest.mark.long)
            for kind in (Story, SharesStory, FetchStory, BehindStory)
            for first in range(2, 1 + kind.chunks_count)
        ),
    ],
)
async def test_a_power_cut_at_every_command_to_the_server(
    tmp_path: Path,
    mongo_database: str,
    monkeypatch: pytest.MonkeyPatch,
    kind: Kind,
    first: int,
    has_transactions: bool,
) -> None:
    """Without transactions the order of the commands has to bear it: each is cut, most of them in the long run of tests."""
    if not has_transactions:
        monkeypatch.setattr("node.custody.stores.mongo_store._tells_of_transactions", lambda _hello: False)
    steps = 0
    with MongoClient(mongo_database) as client:
        database = client[urlsplit(mongo_database).path.lstrip("/")]
        for step in range(first, STEPS_MAX_COUNT, kind.chunks_count):
            house = CustodianHarness(lambda: MongoStore(mongo_database), tmp_path / str(step))
            if not await play(kind, house, Cutter(step, after=False), monkeypatch):
                break
            steps = step
            for name in set(database.list_collection_names()) - {"format"}:
                database[name].delete_many({})
    assert kind.commands_min_count < steps < STEPS_MAX_COUNT - kind.chunks_count


async def test_a_disk_that_fills_up_in_the_middle_of_a_block_stops_it_and_freed_it_is_completed(tmp_path: Path) -> None:
    for room in range(12):
        left = [10_000]

        def require_space(left: list[int] = left) -> None:
            left[0] -= 1
            if left[0] < 0:
                raise OSError(28, "No space left on device")

        folder = tmp_path / str(room)
        house = CustodianHarness(
            lambda folder=folder, need=require_space: SqliteStore(folder, need), folder / "erase-keys"
        )
        async with house.open() as custodian:
            story = Story(house)
            block = await story.prepare()
            left[0] = room
            await refused("STORE_UNAVAILABLE", custodian.on_finalized_block(block))
            await refused("STORE_UNAVAILABLE", custodian.stage(record_clip(valid_until_ms=START_MS + 90_000).upload))
            left[0] = 10_000
            await custodian.on_finalized_block(block)
        async with house.open():
            await story.check()


async def test_a_store_that_somebody_holds_up_is_waited_for(tmp_path: Path) -> None:
    """Slow is not broken: another program's lock on the database delays the block, no more."""
    house = CustodianHarness(lambda: SqliteStore(tmp_path / "custody"), tmp_path / "erase-keys")
    async with house.open() as custodian:
        story = Story(house)
        block = await story.prepare()
        holder = sqlite3.connect(
            tmp_path / "custody" / DATABASE_FILE_NAME, isolation_level=None, check_same_thread=False
        )
        holder.execute("BEGIN IMMEDIATE")
        release = threading.Timer(0.5, lambda: holder.execute("ROLLBACK"))
        release.start()
        await custodian.on_finalized_block(block)
        release.join()
        holder.close()
        await story.check()


async def test_a_server_that_dies_in_the_middle_of_a_block_and_comes_back_has_all_of_it(
    tmp_path: Path, driver_sockets: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real server process, killed under the custodian and started again over the same files."""
    storage, port = tmp_path / "server", secantus.choose_port()
    storage.mkdir()
    child = secantus.start(storage, port)
    uri = secantus.uri_of(port).replace("/?", "/custody?")
    bulk = MongoStore._bulk
    calls: list[str] = []

    async def killed_at_the_fourth(store: MongoStore, name: str, operations: Any) -> None:
        calls.append(name)
        if len(calls) == 4:
            child.kill()
            child.wait()
        await bulk(store, name, operations)

    try:
        house = CustodianHarness(lambda: MongoStore(uri), tmp_path / "erase-keys")
        async with house.open() as custodian:
            story = Story(house)
            block = await story.prepare()
            with monkeypatch.context() as patches:
                patches.setattr(MongoStore, "_bulk", killed_at_the_fourth)
                await refused("STORE_UNAVAILABLE", custodian.on_finalized_block(block))
                await refused("STORE_UNAVAILABLE", custodian.export(story.kept.record_id))
            child = secantus.start(storage, port)
            await custodian.on_finalized_block(block)
            await custodian.on_finalized_block(block)
            await story.check()
    finally:
        secantus.stop(child)


async def test_a_failover_in_the_middle_of_a_block_is_got_over(
    tmp_path: Path, mongo_database: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The primary steps down at each command once: the driver's own error, put in by hand for want of a replica set."""
    house = CustodianHarness(lambda: MongoStore(mongo_database), tmp_path / "erase-keys")
    async with house.open() as custodian:
        story = Story(house)
        block = await story.prepare()
        bulk, fresh = MongoStore._bulk, [True]

        async def stepping_down(store: MongoStore, name: str, operations: Any) -> None:
            fresh[0] = not fresh[0]
            if not fresh[0]:
                raise NotPrimaryError("not primary", {"code": 10107, "errorLabels": ["TransientTransactionError"]})
            await bulk(store, name, operations)

        with monkeypatch.context() as patches:
            patches.setattr(MongoStore, "_bulk", stepping_down)
            for _ in range(STEPS_MAX_COUNT):
                try:
                    await custodian.on_finalized_block(block)
                except (BlockRobotError, NotPrimaryError):
                    point = await custodian.checkpoint()
                    if point is None or point.height < block.height:
                        continue
                break
            patches.undo()
        await custodian.on_finalized_block(block)
        await story.check()

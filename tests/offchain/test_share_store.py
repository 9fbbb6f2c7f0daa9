"""What every custody store keeps of shares, and what it makes of a store that is not whole or not its own."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymongo import MongoClient
from pymongo.asynchronous.collection import AsyncCollection
from pymongo.errors import ConnectionFailure

from consensus.errors import BlockRobotError
from node.custody.stores import sqlite_store
from node.custody.stores.custody_store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    CustodyStore,
    FrameRow,
    Grant,
    RecordFacts,
)
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.share_store import PartPlace, PartRow, ShareRow
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME, SqliteStore

OWNER, OTHER = b"\x02" * 33, b"\x03" * 33


def grant_id(number: int) -> bytes:
    return number.to_bytes(32, "big")


def record_id(number: int) -> bytes:
    return number.to_bytes(16, "big")


def part(grant: int, record: int, slot: int, owner: bytes = OWNER, valid_until_ms: int = 1000) -> PartRow:
    return PartRow(grant_id(grant), record_id(record), owner, valid_until_ms, "staged", 0, slot, b"wrapped %d" % slot)


def place(row: PartRow) -> PartPlace:
    return PartPlace(row.grant_id, row.record_id, row.owner, row.status, row.height, row.slot)


async def test_a_share_is_kept_found_by_its_end_and_forgotten(store: CustodyStore) -> None:
    rows = [ShareRow(grant_id(n), OWNER, (record_id(n), record_id(9)), 1000 * n, 5) for n in (3, 1, 2)]
    for row in rows:
        await store.put_share(row)
    assert await store.share(grant_id(3)) == rows[0]
    assert await store.share(grant_id(7)) is None
    assert await store.shares_over(2000, 10) == [grant_id(1), grant_id(2)]
    assert await store.shares_over(2000, 1) == [grant_id(1)]
    await store.put_share(replace(rows[0], until_ms=10))
    assert await store.shares_over(10, 10) == [grant_id(3)]
    assert [row.grant_id async for row in store.all_shares()] == [grant_id(1), grant_id(2), grant_id(3)]
    await store.forget_share(grant_id(1))
    await store.forget_share(grant_id(1))
    assert (await store.counts()).shares == 2


async def test_the_shares_of_a_visit_are_found_without_the_others(store: CustodyStore) -> None:
    rows = [ShareRow(grant_id(n), OTHER if n == 2 else OWNER, (record_id(n),), 1000, n) for n in (3, 1, 2)]
    for row in rows:
        await store.put_share(row)
    assert await store.shares_of(OWNER) == [rows[1], rows[0]]
    assert await store.shares_of(OTHER) == [rows[2]]
    await store.forget_share(grant_id(2))
    assert await store.shares_of(OTHER) == []


async def test_clips_that_are_missing_and_over_are_told_the_oldest_first(store: CustodyStore) -> None:
    """The same from every store, and all of them: what is held of their keys has to go before they are forgotten."""
    ends = ((1, 30), (2, 10), (3, 20), (4, 20), (5, 31))
    missing = tuple(
        RecordFacts(record_id(number), b"\x01" * 32, OWNER, b"\x02" * 32, b"\x03" * 32, end_ms, 5)
        for number, end_ms in ends
    )
    await store.apply(BlockEffects(missing=missing))
    assert await store.missing_over(30) == [record_id(number) for number in (2, 3, 4, 1)]
    assert await store.missing_over(9) == []
    await store.apply(BlockEffects(checkpoint=Checkpoint(6, b"\x04" * 32, 30)))
    assert await store.missing_over(40) == [record_id(5)]


async def test_parts_are_found_by_grant_record_owner_and_slot(store: CustodyStore) -> None:
    parts = [part(1, 1, 10), part(1, 2, 11), part(2, 1, 12, OTHER)]
    for row in parts:
        await store.put_part(row)
    assert await store.part(grant_id(1), record_id(2)) == parts[1]
    assert await store.part(grant_id(2), record_id(2)) is None
    assert await store.parts_of("grant_id", [grant_id(1)]) == [place(parts[0]), place(parts[1])]
    assert await store.parts_of("record_id", [record_id(1), record_id(5)]) == [place(parts[0]), place(parts[2])]
    assert await store.parts_of("owner", [OTHER]) == [place(parts[2])]
    assert await store.parts_of("owner", []) == []
    assert [row async for row in store.all_parts()] == [place(row) for row in parts]
    await store.erase_parts([11, 12, 99])
    assert [row.slot async for row in store.all_parts()] == [10]
    assert (await store.counts()).parts == 1


async def test_a_part_put_again_takes_the_place_of_the_first(store: CustodyStore) -> None:
    await store.put_part(part(1, 1, 10))
    again = replace(part(1, 1, 20), status="confirmed", height=4)
    await store.put_part(again)
    assert await store.part(grant_id(1), record_id(1)) == again
    assert [slot async for slot in store.slots_in_use()] == [20]


async def test_only_staged_parts_lapse(store: CustodyStore) -> None:
    for row in (part(1, 1, 10), part(1, 2, 11, valid_until_ms=2000), part(2, 1, 12)):
        await store.put_part(row)
    await store.confirm_parts(grant_id(1), [record_id(1), record_id(7)], 8)
    confirmed = await store.part(grant_id(1), record_id(1))
    assert confirmed is not None
    assert (confirmed.status, confirmed.height) == ("confirmed", 8)
    assert await store.part(grant_id(1), record_id(7)) is None
    assert [row.slot for row in await store.lapsed_parts(1000, 10)] == [12]
    assert [row.slot for row in await store.lapsed_parts(2000, 10)] == [12, 11]
    assert len(await store.lapsed_parts(2000, 1)) == 1


async def test_slots_of_parts_are_in_use_as_those_of_frames_are(store: CustodyStore) -> None:
    await store.stage(ClipRow(record_id(1), b"", 0, "staged", (), ()), [FrameRow(record_id(1), 0, b"c", b"w", 5)])
    await store.put_part(part(1, 1, 4))
    await store.put_part(part(1, 2, 6))
    assert sorted([slot async for slot in store.slots_in_use()]) == [4, 5, 6]


async def test_a_long_walk_sees_each_part_and_share_once(store: CustodyStore) -> None:
    for number in range(520):
        await store.put_part(part(number // 8, number % 8, number))
    await store.put_share(ShareRow(grant_id(1), OWNER, (), 0, 0))
    assert [row.slot async for row in store.all_parts()] == list(range(520))
    assert sorted([slot async for slot in store.slots_in_use()]) == list(range(520))
    assert len([row async for row in store.all_shares()]) == 1


async def test_a_request_keeps_the_share_under_which_it_was_made(store: CustodyStore) -> None:
    own = Grant(b"\xa1" * 32, OWNER, (), 5)
    hers = Grant(b"\xa2" * 32, OWNER, (record_id(1),), 6, grant_id(1))
    await store.apply(BlockEffects(grants=(own, hers)))
    assert await store.grant(hers.access_id) == hers
    assert await store.grants_of_owners([OWNER]) == [own, hers]


@pytest.mark.parametrize("version", [sqlite_store.FORMAT_VERSION - 1, sqlite_store.FORMAT_VERSION + 1])
async def test_an_embedded_store_of_another_format_is_refused_untouched(tmp_path: Path, version: int) -> None:
    async with SqliteStore(tmp_path):
        pass
    with closing(sqlite3.connect(tmp_path / DATABASE_FILE_NAME)) as database:
        database.execute(f"PRAGMA user_version = {version}")
        with pytest.raises(BlockRobotError, match=f"STORE_UNAVAILABLE.*format {version}"):
            await SqliteStore(tmp_path).__aenter__()
        assert database.execute("PRAGMA user_version").fetchone() == (version,)


async def test_a_networked_store_that_was_cut_off_while_it_was_made_is_made_on(
    mongo_database: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its mark comes last: whatever was made before is found there, and made no second time."""
    real, made = AsyncCollection.create_index, 0

    async def cut_off(self: Any, fields: Any) -> Any:
        nonlocal made
        if made == 7:
            raise ConnectionFailure("it was cut off here")
        made += 1
        return await real(self, fields)

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(AsyncCollection, "create_index", cut_off)
        with pytest.raises(BlockRobotError, match="STORE_UNAVAILABLE"):
            await MongoStore(mongo_database).__aenter__()
    with MongoClient[dict[str, Any]](mongo_database) as client:
        assert client.get_default_database()["format"].find_one() is None
    async with MongoStore(mongo_database) as store:
        assert await store.shares_of(OWNER) == []

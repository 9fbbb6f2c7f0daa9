"""What MongoDB alone can get wrong: foreign databases, half documents, URIs with passwords, queries without an index."""

from __future__ import annotations

import inspect
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from pymongo import MongoClient
from pymongo.database import Database
from pymongo.errors import ConnectionFailure

from consensus.errors import BlockRobotError
from node.custody.stores.custody_store import BlockEffects, Checkpoint, ClipRow, FrameRow, Grant, OutboxRow
from node.custody.stores.mongo_documents import Document
from node.custody.stores.mongo_store import (
    _DURABLE,
    FORMAT_VERSION,
    MAJORITY_MAX_MS,
    TRANSACTION_ATTEMPTS_MAX_COUNT,
    MongoStore,
    _tells_of_transactions,
)
from node.custody.stores.open_store import open_store
from node.custody.stores.sqlite_store import SqliteStore
from node.custody.uploads.upload_usage import DayUse, Use
from tests.offchain.recorded_commands import recorded_commands
from tests.offchain.stored_clips import make_clip

RECORD_ID, OWNER, TXID = b"\x01" * 16, b"\x02" * 33, b"\x03" * 32
Query = Callable[[MongoStore], Any]


@pytest.fixture
def database(mongo_database: str) -> Iterator[Database[Document]]:
    """The store's database, seen from outside of it."""
    with MongoClient[Document](mongo_database) as client:
        yield client[urlsplit(mongo_database).path.lstrip("/")]


async def _refusal_of(uri: str) -> BlockRobotError:
    with pytest.raises(BlockRobotError) as refusal:
        async with MongoStore(uri):
            pass
    return refusal.value


async def test_a_database_of_another_format_is_refused_untouched(
    mongo_database: str, database: Database[Document]
) -> None:
    async with MongoStore(mongo_database):
        pass
    database["format"].update_one({}, {"$set": {"version": FORMAT_VERSION + 1}})
    assert (await _refusal_of(mongo_database)).code == "STORAGE_DAMAGED"
    assert [found["version"] for found in database["format"].find()] == [FORMAT_VERSION + 1]


async def test_somebody_elses_database_is_refused_untouched(mongo_database: str, database: Database[Document]) -> None:
    database["invoices"].insert_one({"_id": 1})
    assert (await _refusal_of(mongo_database)).code == "STORAGE_DAMAGED"
    assert database.list_collection_names() == ["invoices"]


async def test_a_document_that_lacks_a_field_is_damage_and_not_a_guess(
    mongo_database: str, database: Database[Document]
) -> None:
    async with MongoStore(mongo_database) as store:
        await store.apply(BlockEffects(checkpoint=Checkpoint(5, TXID, 1000)))
        database["checkpoint"].update_one({}, {"$unset": {"block_id": ""}})
        with pytest.raises(BlockRobotError) as refusal:
            await store.checkpoint()
    assert refusal.value.code == "STORAGE_DAMAGED"


async def test_a_clip_whose_staging_was_cut_off_counts_for_its_robot(
    mongo_database: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip, frames = make_clip(1)
    async with MongoStore(mongo_database) as store:
        store.has_transactions = False
        monkeypatch.setattr(store, "_delete", _cut_off)
        with pytest.raises(ConnectionFailure):
            await store.stage(replace(clip, robot=OWNER, size_bytes=7), frames)
        assert (await store.counts()).staged == 1
        assert await store.use_by_robot("staged") == {OWNER: Use(1, 7)}


async def _cut_off(*_: Any) -> None:
    raise ConnectionFailure


@pytest.mark.parametrize(
    "uri",
    [
        "mongodb://reader:hidden-word@127.0.0.1:27017",
        "mongodb://reader:hidden-word@127.0.0.1:27017/?directConnection=true",
        "mongodb://reader:hidden-word@127.0.0.1:hidden-word/x",
    ],
)
async def test_a_uri_without_a_database_or_port_is_refused_without_being_quoted(uri: str) -> None:
    refusal = await _refusal_of(uri)
    assert refusal.code == "CONFIGURATION_INVALID"
    assert "hidden-word" not in str(refusal)


def test_the_configured_name_chooses_the_store(tmp_path: Path) -> None:
    assert isinstance(open_store("sqlite", tmp_path), SqliteStore)
    assert isinstance(open_store("mongodb://127.0.0.1/x", tmp_path), MongoStore)
    assert isinstance(open_store("mongodb+srv://cluster.example/x", tmp_path), MongoStore)


@pytest.mark.parametrize("name", ["", "postgres://127.0.0.1/x", "sqlite:///x", "MONGODB"])
def test_another_name_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID:"):
        open_store(name, tmp_path)


BY_KEY_ALONE = {
    *("add_outbox", "remove_outbox", "mark_outbox_ready", "put_background", "delete_backgrounds"),
    *("stage", "correct", "extend_staged", "erase_frames"),
    *("confirm_parts", "erase_parts", "forget_share", "part", "put_part", "put_share", "share"),
}
"""What reads and writes single documents by their ids, or by the slots of their keys."""
LOOK_AT_ALL = {
    "clear",
    "absent",
    "count_missing",
    "counts",
    "leftovers",
    "sweep",
    "sweep_blobs",
    "all_grants",
    "all_parts",
    "all_shares",
    "background_digests",
}
"""What an operator asks for, and what walks over everything at a start."""


async def _drain(found: Any) -> None:
    async for _ in found:
        pass


QUERIES: Mapping[str, Query] = {
    "checkpoint": lambda store: store.checkpoint(),
    "visit_restrictions": lambda store: store.visit_restrictions([OWNER]),
    "clips": lambda store: store.clips([RECORD_ID, b"\x09" * 16]),
    "clips_of_owner": lambda store: store.clips_of_owner(OWNER),
    "frames": lambda store: store.frames(RECORD_ID),
    "frame_places": lambda store: store.frame_places([RECORD_ID, b"\x09" * 16]),
    "stage_all": lambda store: store.stage_all([make_clip(1), make_clip(2)]),
    "erase_clips": lambda store: store.erase_clips([RECORD_ID, b"\x09" * 16]),
    "references": lambda store: store.references([RECORD_ID, b"\x09" * 16], 16),
    "replace_frames": lambda store: store.replace_frames(RECORD_ID, [FrameRow(RECORD_ID, 0, b"new", b"wrapped", 8)]),
    "drop_staged": lambda store: store.drop_staged([RECORD_ID]),
    "lapsed": lambda store: store.lapsed(5000, 10),
    "expired": lambda store: store.expired(5000, 10),
    "missing": lambda store: store.missing(10),
    "missing_of_owner": lambda store: store.missing_of_owner(OWNER),
    "missing_clips": lambda store: store.missing_clips([RECORD_ID]),
    "missing_over": lambda store: store.missing_over(5000),
    "apply": lambda store: store.apply(BlockEffects(checkpoint=Checkpoint(5, TXID, 5000))),
    "grant": lambda store: store.grant(TXID),
    "grants_of_owners": lambda store: store.grants_of_owners([OWNER]),
    "background": lambda store: store.background(TXID),
    "outbox": lambda store: store.outbox("ready", "access", 10),
    "outbox_of": lambda store: store.outbox_of("access.released", TXID),
    "all_clips": lambda store: _drain(store.all_clips()),
    "slots_in_use": lambda store: _drain(store.slots_in_use()),
    "shares_of": lambda store: store.shares_of(OWNER),
    "shares_over": lambda store: store.shares_over(1000, 10),
    "lapsed_parts": lambda store: store.lapsed_parts(1000, 10),
    "parts_of grants": lambda store: store.parts_of("grant_id", [TXID]),
    "parts_of records": lambda store: store.parts_of("record_id", [RECORD_ID]),
    "parts_of owners": lambda store: store.parts_of("owner", [OWNER]),
    "records_with_frames": lambda store: _drain(store.records_with_frames()),
    "use_by_robot": lambda store: store.use_by_robot("staged"),
    "add_use": lambda store: store.add_use(DayUse(20_000, TXID, 5)),
    "day_uses": lambda store: store.day_uses(),
}


def _is_served(where: Document, sort: Sequence[tuple[str, int]], index: Sequence[tuple[str, int]]) -> bool:
    """Whether an index finds these documents in this order: first what is fixed, then the order, which bears ranges."""
    fixed = {field for field, value in where.items() if not isinstance(value, dict)}
    ranges = {field for field, value in where.items() if isinstance(value, dict) and "$ne" not in value}
    if "_id" in fixed:
        return index[0][0] == "_id"
    fields = [field for field, _ in index]
    if set(fields[: len(fixed)]) != fixed:
        return False
    order = [place for place in sort if place[0] not in fixed]
    rest = index[len(fixed) :]
    in_order = list(rest[: len(order)]) == order
    return in_order and ranges <= set(fields) and (not ranges or fields[len(fixed)] in ranges)


def _stages(database: Database[Document], name: str, where: Document) -> set[str]:
    answer = database.command("explain", {"find": name, "filter": where}, verbosity="queryPlanner")
    return set(re.findall(r"'stage': '(\w+)'", str(answer["queryPlanner"]["winningPlan"])))


@pytest.mark.parametrize("query", QUERIES)
async def test_every_query_goes_by_an_index(
    query: str, mongo_database: str, database: Database[Document], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, Document, Sequence[tuple[str, int]]]] = []
    many, delete, summed, walk = MongoStore._many, MongoStore._delete, MongoStore._summed, MongoStore._walk

    async def noted_many(store: MongoStore, name: str, where: Document, **options: Any) -> list[Document]:
        asked.append((name, where, options.get("sort", (("_id", 1),))))
        return await many(store, name, where, **options)

    async def noted_delete(store: MongoStore, name: str, where: Document) -> None:
        asked.append((name, where, ()))
        await delete(store, name, where)

    async def noted_summed(store: MongoStore, name: str, where: Document, groups: Document) -> list[Document]:
        asked.append((name, where, ()))
        return await summed(store, name, where, groups)

    def noted_walk(store: MongoStore, name: str, order: Sequence[tuple[str, int]], field: str) -> AsyncIterator[int]:
        assert field in dict(order), "else each document would be read"
        asked.append((name, {}, order))
        return walk(store, name, order, field)

    async with MongoStore(mongo_database) as store:
        clip = ClipRow(RECORD_ID, TXID, 1000, "staged", (TXID,), (TXID,))
        await store.stage(clip, [FrameRow(RECORD_ID, 0, b"ciphertext", b"wrapped", 7)])
        monkeypatch.setattr(MongoStore, "_many", noted_many)
        monkeypatch.setattr(MongoStore, "_delete", noted_delete)
        monkeypatch.setattr(MongoStore, "_summed", noted_summed)
        monkeypatch.setattr(MongoStore, "_walk", noted_walk)
        await QUERIES[query](store)
    assert asked
    for name, where, sort in asked:
        indexes = [[("_id", 1)], *(index["key"] for index in database[name].index_information().values())]
        assert any(_is_served(where, sort, index) for index in indexes), where
        if where and "_id" not in where:  # the test server says COLLSCAN of ranges of the primary key
            assert "IXSCAN" in _stages(database, name, where)
            assert "COLLSCAN" not in _stages(database, name, where)


def test_no_method_of_the_store_is_left_out() -> None:
    public = {name for name, value in inspect.getmembers(MongoStore, callable) if not name.startswith("_")}
    assert public - {name.split()[0] for name in QUERIES} == BY_KEY_ALONE | LOOK_AT_ALL


def test_a_query_without_an_index_would_be_noticed(database: Database[Document]) -> None:
    """Were everything said to go by an index, the test above could not fail."""
    database["frames"].insert_one({"ciphertext": b"x"})
    assert "COLLSCAN" in _stages(database, "frames", {"ciphertext": b"x"})
    rising = [("status", 1), ("height", 1)]
    assert _is_served({"status": "ready"}, [("height", 1)], rising)
    assert not _is_served({"status": "ready"}, [("height", -1), ("_id", 1)], rising)
    assert not _is_served({"height": {"$lt": 5}}, [], rising)
    assert not _is_served({"owner": OWNER}, [], rising)


async def test_what_writes_single_frames_names_their_shard(mongo_database: str) -> None:
    clip, frames = make_clip(1)
    with recorded_commands() as commands:
        async with MongoStore(mongo_database) as store:
            await store.stage(clip, frames)
            await store.replace_frames(clip.record_id, frames)
            await store.erase_frames(clip.record_id, [0])
            await store.erase_clips([clip.record_id])
    asked = [where for command in commands.sent if command.collection == "frames" for where in command.filters]
    assert len(asked) > len(frames)
    assert all("record_id" in where for where in asked)


EFFECTS = BlockEffects(
    outbox=(OutboxRow("access.released", TXID, 0, "access", "released", b"\x90", 5),),
    grants=(Grant(TXID, OWNER, (), 5),),
    checkpoint=Checkpoint(5, TXID, 1000),
)


@pytest.mark.parametrize("has_transactions", [True, False])
async def test_a_block_cut_off_in_the_middle_leaves_nothing_or_what_a_repetition_completes(
    mongo_database: str, monkeypatch: pytest.MonkeyPatch, has_transactions: bool
) -> None:
    bulk = MongoStore._bulk

    async def cut_off(store: MongoStore, name: str, operations: Sequence[Any]) -> None:
        if name == "checkpoint":
            raise BlockRobotError("STORE_UNAVAILABLE")
        await bulk(store, name, operations)

    async with MongoStore(mongo_database) as store:
        assert store.has_transactions, "the server that the tests run on speaks as a replica set"
        store.has_transactions = has_transactions
        with monkeypatch.context() as patches:
            patches.setattr(MongoStore, "_bulk", cut_off)
            with pytest.raises(BlockRobotError):
                await store.apply(EFFECTS)
        assert await store.checkpoint() is None
        assert (await store.grant(TXID) is None) == has_transactions
        assert (await store.outbox("ready", "access", 10) == []) == has_transactions
        for _ in range(2):
            await store.apply(EFFECTS)
        assert await store.checkpoint() == EFFECTS.checkpoint
        assert await store.grant(TXID) == EFFECTS.grants[0]
        assert await store.outbox("ready", "access", 10) == list(EFFECTS.outbox)


async def test_a_transaction_that_a_failover_cut_off_is_begun_again_but_not_for_ever(
    mongo_database: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []
    ordered = MongoStore._apply_in_order

    async with MongoStore(mongo_database) as store:

        async def fail_over(_: MongoStore, effects: BlockEffects) -> None:
            begun.append("")
            if len(begun) % 4:
                lost = ConnectionFailure("the primary stepped down")
                lost._add_error_label("TransientTransactionError")
                raise lost
            await ordered(store, effects)

        monkeypatch.setattr(MongoStore, "_apply_in_order", fail_over)
        with pytest.raises(BlockRobotError) as refusal:
            await store.apply(EFFECTS)
        assert (refusal.value.code, len(begun)) == ("STORE_UNAVAILABLE", TRANSACTION_ATTEMPTS_MAX_COUNT)
        await store.apply(EFFECTS)
        assert await store.checkpoint() == EFFECTS.checkpoint


@pytest.mark.parametrize(
    ("hello", "has"),
    [
        ({"setName": "ward", "logicalSessionTimeoutMinutes": 30}, True),
        ({"msg": "isdbgrid", "logicalSessionTimeoutMinutes": 30}, True),
        ({"logicalSessionTimeoutMinutes": 30}, False),
        ({"setName": "old"}, False),
        ({}, False),
    ],
)
def test_a_single_server_is_not_asked_for_transactions(hello: Document, has: bool) -> None:
    assert _tells_of_transactions(hello) == has


async def test_every_write_waits_for_the_journals_of_the_majority(mongo_database: str) -> None:
    async with MongoStore(mongo_database) as store:
        for name in ("clips", "frames", "missing", "grants", "outbox", "backgrounds", "checkpoint", "restrictions"):
            collection = store._collection(name)
            assert collection.write_concern.document == {"w": "majority", "j": True, "wtimeout": MAJORITY_MAX_MS}
            assert collection.read_concern.level == "majority"
    assert _DURABLE.document["j"]

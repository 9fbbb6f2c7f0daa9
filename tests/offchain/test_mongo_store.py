"""What MongoDB alone can get wrong: foreign databases, half documents, URIs with passwords, queries without an index."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from pymongo import MongoClient
from pymongo.database import Database

from consensus.errors import BlockRobotError
from node.offchain.mongo_documents import Document
from node.offchain.mongo_store import FORMAT_VERSION, MongoStore
from node.offchain.open_store import open_store
from node.offchain.sqlite_store import SqliteStore
from node.offchain.store import BlockEffects, Checkpoint, ClipRow, FrameRow

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
    with pytest.raises(BlockRobotError) as refusal:
        open_store(name, tmp_path)
    assert refusal.value.code == "CONFIGURATION_INVALID"


async def _drain(found: Any) -> None:
    async for _ in found:
        pass


QUERIES: Mapping[str, Query] = {
    "checkpoint": lambda store: store.checkpoint(),
    "standings": lambda store: store.standings([OWNER]),
    "clips": lambda store: store.clips([RECORD_ID, b"\x09" * 16]),
    "clips_of_owner": lambda store: store.clips_of_owner(OWNER),
    "frames": lambda store: store.frames(RECORD_ID),
    "frame_places": lambda store: store.frame_places([RECORD_ID, b"\x09" * 16]),
    "erase_clip": lambda store: store.erase_clip(RECORD_ID),
    "drop_staged": lambda store: store.drop_staged(RECORD_ID),
    "lapsed": lambda store: store.lapsed(5000, 10),
    "expired": lambda store: store.expired(5000, 10),
    "missing": lambda store: store.missing(10),
    "missing_clip": lambda store: store.missing_clip(RECORD_ID),
    "apply": lambda store: store.apply(BlockEffects(checkpoint=Checkpoint(5, TXID, 5000))),
    "grant": lambda store: store.grant(TXID),
    "grants_of_owner": lambda store: store.grants_of_owner(OWNER),
    "background": lambda store: store.background(TXID),
    "outbox": lambda store: store.outbox("ready", 10),
    "outbox_of": lambda store: store.outbox_of("access.released", TXID),
    "all_clips": lambda store: _drain(store.all_clips()),
    "slots_in_use": lambda store: _drain(store.slots_in_use()),
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
    many, delete = MongoStore._many, MongoStore._delete

    async def noted_many(store: MongoStore, name: str, where: Document, **options: Any) -> list[Document]:
        asked.append((name, where, options.get("sort", (("_id", 1),))))
        return await many(store, name, where, **options)

    async def noted_delete(store: MongoStore, name: str, where: Document) -> None:
        asked.append((name, where, ()))
        await delete(store, name, where)

    async with MongoStore(mongo_database) as store:
        clip = ClipRow(RECORD_ID, TXID, 1000, "staged", (TXID,), (TXID,))
        await store.stage(clip, [FrameRow(RECORD_ID, 0, b"ciphertext", b"wrapped", 7)])
        monkeypatch.setattr(MongoStore, "_many", noted_many)
        monkeypatch.setattr(MongoStore, "_delete", noted_delete)
        await QUERIES[query](store)
    assert asked
    for name, where, sort in asked:
        indexes = [[("_id", 1)], *(index["key"] for index in database[name].index_information().values())]
        assert any(_is_served(where, sort, index) for index in indexes), where
        if where and "_id" not in where:  # the test server says COLLSCAN of ranges of the primary key
            assert "IXSCAN" in _stages(database, name, where)
            assert "COLLSCAN" not in _stages(database, name, where)


def test_a_query_without_an_index_would_be_noticed(database: Database[Document]) -> None:
    """Were everything said to go by an index, the test above could not fail."""
    database["frames"].insert_one({"ciphertext": b"x"})
    assert "COLLSCAN" in _stages(database, "frames", {"ciphertext": b"x"})
    rising = [("status", 1), ("height", 1)]
    assert _is_served({"status": "ready"}, [("height", 1)], rising)
    assert not _is_served({"status": "ready"}, [("height", -1), ("_id", 1)], rising)
    assert not _is_served({"height": {"$lt": 5}}, [], rising)
    assert not _is_served({"owner": OWNER}, [], rising)

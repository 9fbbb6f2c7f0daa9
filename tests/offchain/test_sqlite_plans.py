"""Every query of the embedded store goes by a key or an index, also where a partial index or a view stands between."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from consensus.limits import CLIP_FRAMES_MAX_COUNT
from node.custody.stores.sqlite_schema import PLACES_COUNT, SCHEMA
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.stored_clips import make_clip
from tests.offchain.test_mongo_store import QUERIES, _drain

CHANGES_AND_WALKS = {
    "erase_frames": lambda store: store.erase_frames(make_clip(1)[0].record_id, [0]),
    "extend_staged": lambda store: store.extend_staged(make_clip(1)[0].record_id, bytes(32), 1),
    "absent": lambda store: store.absent(b"", 10),
    "all_grants": lambda store: _drain(store.all_grants()),
    "all_parts": lambda store: _drain(store.all_parts()),
    "all_shares": lambda store: _drain(store.all_shares()),
}
"""Beside those that the networked store is asked for."""
ALLOWED = ("SCAN checkpoint", "SCAN day_uses", "SCAN missing USING INDEX missing_by_height")
"""A table of one row, one of a few weeks, and an index of just what is asked for, in its order."""


def _slow_steps(database: sqlite3.Connection, statement: str) -> list[str]:
    steps = [row[3] for row in database.execute(f"EXPLAIN QUERY PLAN {statement}")]
    return [step for step in steps if step.startswith(("SCAN", "USE TEMP")) and step not in ALLOWED]


@pytest.mark.parametrize("query", [*QUERIES, *CHANGES_AND_WALKS])
async def test_every_query_goes_by_an_index(query: str, tmp_path: Path) -> None:
    asked: list[str] = []
    async with SqliteStore(tmp_path) as store:
        await store.stage(*make_clip(1))
        store._opened().set_trace_callback(asked.append)
        await (QUERIES | CHANGES_AND_WALKS)[query](store)
        store._opened().set_trace_callback(None)
        statements = [text for text in asked if text.startswith(("SELECT", "UPDATE", "DELETE", "INSERT"))]
        slow = await store._in_worker(
            lambda: [step for each in statements for step in _slow_steps(store._opened(), each)]
        )
    assert statements
    assert slow == []


def test_a_query_without_an_index_would_be_noticed() -> None:
    with sqlite3.connect(":memory:") as database:
        database.executescript(SCHEMA)
        assert _slow_steps(database, "SELECT 1 FROM clips WHERE height = 1") == ["SCAN clips"]
        assert _slow_steps(database, "SELECT id FROM frames WHERE record_id = x'00' ORDER BY place") != []
        assert _slow_steps(database, "DELETE FROM clips WHERE record_id = x'00'") == []
    database.close()


def test_frames_of_two_clips_never_share_an_id() -> None:
    assert PLACES_COUNT >= CLIP_FRAMES_MAX_COUNT

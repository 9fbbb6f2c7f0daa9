"""Shares where there are no blocks to follow, in a scrub, and as the hunt sees them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from network.custody.hunt import explain, files_below
from network.custody.searching import Search
from network.custody.traces import Trace, trace_store
from node.custody.chain_facts import ChainFacts
from node.custody.repair.scrub import scrub
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import ERASURE_ID, CustodianHarness
from tests.offchain.house import refused as refused_with
from tests.offchain.small_chain import ALICE, CUSTODIAN, START_MS, RecordedClip, erasure, record_clip
from tests.offchain.small_state import State
from tests.offchain.test_sharing import (
    GRANT_ID,
    HER_ACCESS_ID,
    OTHER_GRANT_ID,
    granted,
    parts_for,
    request,
    revoked,
    share,
)

AT_MS = START_MS + 20_000


async def keep_staged(house: CustodianHarness, *clips: RecordedClip) -> None:
    """Keep clips and parts for them, of which no grant is final yet as far as this custodian knows."""
    for clip in clips:
        await house.keep(clip)
        await house.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE)


async def places(house: CustodianHarness) -> list[tuple[bytes, str]]:
    return [(place.record_id, place.status) async for place in house.store.all_parts()]


async def test_a_custodian_without_blocks_takes_the_grants_that_stand_from_the_state(opened: CustodianHarness) -> None:
    clip = record_clip()
    await keep_staged(opened, clip)
    state = State()
    state.record(clip)
    state.grant(GRANT_ID, clip)
    state.access(clip, grant=GRANT_ID)
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    assert await places(opened) == [(clip.record_id, "confirmed")]
    share_row = await opened.store.share(GRANT_ID)
    assert share_row is not None
    assert (share_row.owner, share_row.height) == (ALICE, 6)


@pytest.mark.parametrize("end", ["revoked", "over", "unknown", "denied", "erasing"])
async def test_a_custodian_without_blocks_lets_go_of_what_ended_meanwhile(opened: CustodianHarness, end: str) -> None:
    clip = record_clip()
    await share(opened, clip)
    state = State()
    state.record(clip, status="erasing" if end == "erasing" else "active")
    if end != "unknown":
        changes: dict[str, Any] = {"revoked": {"status": "revoked"}, "over": {"until_ms": AT_MS}}.get(end, {})
        state.grant(GRANT_ID, clip, **changes)
    if end == "denied":
        state.quarantine()
    if end == "erasing":
        state.erasure(clip)
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    assert await places(opened) == []
    assert sorted([slot async for slot in opened.store.slots_in_use()]) == opened.keys.held


async def test_a_part_whose_grant_may_still_become_final_stays(opened: CustodianHarness) -> None:
    clip = record_clip()
    await keep_staged(opened, clip)
    state = State()
    state.record(clip)
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    assert await places(opened) == [(clip.record_id, "staged")]


async def test_an_erasure_of_frames_that_came_before_a_share_takes_nothing_of_it_when_it_is_replayed(
    opened: CustodianHarness,
) -> None:
    clip = record_clip()
    await keep_staged(opened, clip)
    state = State()
    state.record(clip)
    state.erasure(clip, frames=(1,))
    state.grant(GRANT_ID, clip, height=8)
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    assert await places(opened) == [(clip.record_id, "confirmed")]


async def test_a_scrub_tells_of_parts_that_should_be_gone(opened: CustodianHarness) -> None:
    kept, ended = record_clip(), record_clip()
    await share(opened, kept)
    await opened.keep(ended)
    await opened.custodian.stage_part(parts_for(ended, OTHER_GRANT_ID)[CUSTODIAN], ALICE)
    await opened.follow(granted(ended, grant_id=OTHER_GRANT_ID))
    state = State()
    for height, clip in ((1, kept), (4, ended)):
        state.record(clip, height=height)
    state.grant(GRANT_ID, kept)
    state.grant(OTHER_GRANT_ID, ended, status="revoked")

    @contextmanager
    def open_facts() -> Iterator[ChainFacts]:
        yield state.facts(opened.chain.height, opened.chain.time_ms)

    report = await scrub(opened.custodian, opened.store, opened.keys, open_facts)
    assert report.parts_held_though_ended == [(OTHER_GRANT_ID, ended.record_id)]
    assert not report.nothing_erased_is_left
    await opened.follow(revoked(OTHER_GRANT_ID))
    report = await scrub(opened.custodian, opened.store, opened.keys, open_facts)
    assert report.is_clean


# The hunt


@pytest.mark.parametrize("how", ["erased", "revoked"])
async def test_the_hunt_finds_nothing_of_a_share_after_its_end(tmp_path: Path, how: str) -> None:
    house = CustodianHarness(lambda: SqliteStore(tmp_path / "custody"), tmp_path / "erase-keys")
    config = SimpleNamespace(
        clips=None,
        name="node-1",
        custody_store="sqlite:",
        custody_dir=tmp_path / "custody",
        erase_keys_dir=tmp_path / "erase-keys",
    )
    async with house.open():
        clip = record_clip()
        upload = await share(house, clip)
        trace = Trace(clip.record_id)
        trace_store(trace, config)  # type: ignore[arg-type]
        assert {"wrapped-part", "package", "key-part", "erase-key"} <= set(trace.pieces)
        assert found_of(trace, tmp_path) >= {"wrapped-part", "erase-key"}
        assert not found_of(trace, tmp_path) & {"package", "key-part"}, "nothing of a part stands bare"
        await house.follow(erasure(ERASURE_ID, clip) if how == "erased" else revoked())
        left = found_of(trace, tmp_path)
        assert not left & {"wrapped-part", "package", "key-part"}
        if how == "erased":
            assert not left - {"id"}
        code = "CLIP_ERASED" if how == "erased" else "GRANT_ENDED"
        await refused_with(code, house.custodian.download_shared(request(clip, HER_ACCESS_ID), upload.grant_txid))


def found_of(trace: Trace, folder: Path) -> set[str]:
    """Return the kinds of pieces that lie anywhere in a folder's files."""
    lying = set()
    for kind, pieces in trace.pieces.items():
        search = Search(pieces)
        if any(search.in_file(path) for path in files_below(folder, [])):
            lying.add(kind)
    return lying


@pytest.mark.parametrize("what", ["wrapped-part", "package", "key-part"])
def test_a_part_may_be_in_the_store_wrapped_and_nowhere_else(what: str) -> None:
    places = ("store", "erase-keys", "ledger", "journal", "snapshots", "log", "other")
    assert not [place for place in places if explain(place, what, is_gone=True)]
    allowed = [place for place in places if explain(place, what, is_gone=False)]
    assert allowed == (["store"] if what == "wrapped-part" else [])

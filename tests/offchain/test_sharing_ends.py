"""Ends of shares that a custodian hears of late: from the state, after an upload, or while its clip was away."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from network.custody import hunt as hunting
from network.custody.hunt import gather, hunt
from network.custody.traces import read_traces, write_traces
from node.custody.chain_facts import ChainFacts
from node.custody.repair.scrub import scrub
from node.custody.stores.custody_store import BlockEffects, RecordFacts
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness
from tests.offchain.house import refused as refused_with
from tests.offchain.small_chain import (
    ALICE,
    CUSTODIAN,
    EXPIRES_MS,
    START_MS,
    RecordedClip,
    erasure,
    record_clip,
    recorded,
)
from tests.offchain.small_state import State
from tests.offchain.test_sharing import GRANT_ID, OTHER_GRANT_ID, granted, parts_for, revoked, share

AT_MS = START_MS + 20_000


async def places(house: CustodianHarness) -> list[tuple[bytes, str]]:
    return [(place.record_id, place.status) async for place in house.store.all_parts()]


def state_of(*clips: RecordedClip) -> State:
    state = State()
    for clip in clips:
        state.record(clip)
    return state


# A quarantine


@pytest.mark.parametrize(("denied_height", "is_kept"), [(50, False), (1, True)])
async def test_from_the_state_after_a_quarantine_ended_parts_from_before_it_are_gone(
    opened: CustodianHarness, denied_height: int, is_kept: bool
) -> None:
    """What the custodian followed itself it has carried out: a part brought again after it is not taken for an old one."""
    clip = record_clip()
    await share(opened, clip)
    state = state_of(clip)
    state.grant(GRANT_ID, clip, height=1 if is_kept else 6)
    state.said("denied", denied_height, breach_id=bytes(32))
    state.said("breach_closed", denied_height + 1, outcome="released")
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    assert await places(opened) == ([(clip.record_id, "confirmed")] if is_kept else [])
    assert sorted([slot async for slot in opened.store.slots_in_use()]) == opened.keys.held


async def test_a_grant_from_after_a_quarantine_that_was_missed_keeps_its_parts(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE)
    state = state_of(clip)
    state.grant(GRANT_ID, clip, height=60)
    state.said("denied", 50, breach_id=bytes(32))
    state.said("breach_closed", 51, outcome="released")
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    assert await places(opened) == [(clip.record_id, "confirmed")]


# Uploads after the end


async def test_a_package_with_keys_of_erased_frames_is_not_taken_again(house: CustodianHarness) -> None:
    clip = record_clip()
    async with house.open():
        upload = await share(house, clip)
        await house.follow(erasure(ERASURE_ID, clip, frames=(1,)))
        await refused_with("NOT_PERMITTED", house.custodian.stage_part(upload, ALICE))
    async with house.open():
        await refused_with("NOT_PERMITTED", house.custodian.stage_part(upload, ALICE))
        assert await places(house) == []
        anew = parts_for(clip, OTHER_GRANT_ID)[CUSTODIAN]
        await house.custodian.stage_part(anew, ALICE)
        await house.follow(granted(clip, grant_id=OTHER_GRANT_ID))
        assert await places(house) == [(clip.record_id, "confirmed")]


async def test_nor_by_a_custodian_that_heard_of_the_erasure_from_the_state(opened: CustodianHarness) -> None:
    clip, whole = record_clip(), record_clip()
    for each in (clip, whole):
        await opened.keep(each)
    state = state_of(clip, whole)
    state.grant(GRANT_ID, clip, whole)
    state.erasure(clip, frames=(1,))
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    opened.chain.time_ms = AT_MS
    await refused_with("NOT_PERMITTED", opened.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE))
    assert await opened.custodian.stage_part(parts_for(whole)[CUSTODIAN], ALICE) == "confirmed"


async def test_a_scrub_tells_of_a_package_with_keys_of_erased_frames(opened: CustodianHarness) -> None:
    clip = record_clip()
    upload = await share(opened, clip)
    row = await opened.store.part(GRANT_ID, clip.record_id)
    assert row is not None
    state = State()
    state.record(clip, height=1)
    state.grant(GRANT_ID, clip)
    state.erasure(clip, frames=(1,))

    @contextmanager
    def open_facts() -> Iterator[ChainFacts]:
        yield state.facts(opened.chain.height, opened.chain.time_ms)

    await opened.follow(erasure(ERASURE_ID, clip, frames=(1,)))
    report = await scrub(opened.custodian, opened.store, opened.keys, open_facts)
    assert report.parts_held_though_ended == []
    await opened.store.put_part(row)
    report = await scrub(opened.custodian, opened.store, opened.keys, open_facts)
    assert report.parts_held_though_ended == [(upload.grant_txid, clip.record_id)]


async def test_an_upload_is_refused_if_the_state_says_so_and_leaves_no_key(opened: CustodianHarness) -> None:
    """The store forgets a grant that ended; the state does not."""
    clip = record_clip()
    upload = await share(opened, clip)
    await opened.follow(revoked())

    def refuse() -> None:
        raise BlockRobotError("GRANT_ENDED")

    await refused_with("GRANT_ENDED", opened.custodian.stage_part(upload, ALICE, refuse))
    assert await places(opened) == []
    assert sorted([slot async for slot in opened.store.slots_in_use()]) == opened.keys.held


# A clip that is away


async def test_a_record_that_expires_while_its_clip_is_away_takes_its_parts_with_it(opened: CustodianHarness) -> None:
    clip, other = await opened.keep(), await opened.keep()
    for each in (clip, other):
        await opened.custodian.stage_part(parts_for(each)[CUSTODIAN], ALICE)
    await opened.follow(granted(clip, other, until_ms=EXPIRES_MS + 3_600_000))
    held = (await opened.store.clips([clip.record_id]))[clip.record_id]
    data = recorded(clip)[2]
    roots = (data["commitment_root"], data["ciphertext_root"])
    facts = RecordFacts(clip.record_id, held.txid, ALICE, *roots, EXPIRES_MS, held.height)
    await opened.custodian.eraser.forget(clip.record_id)
    await opened.store.apply(BlockEffects(missing=(facts,)))
    await opened.follow(at_ms=EXPIRES_MS - 1)
    assert len(await places(opened)) == 2
    await opened.follow(at_ms=EXPIRES_MS)
    assert await places(opened) == []
    assert opened.keys.held == []


# What a store that was put back owes


@pytest.mark.parametrize("end", ["revoked", "over"])
async def test_nothing_is_owed_for_an_old_request_of_a_grant_that_has_ended(opened: CustodianHarness, end: str) -> None:
    clip = await opened.keep()
    state = state_of(clip)
    state.grant(GRANT_ID, clip, **({"status": "revoked"} if end == "revoked" else {"until_ms": AT_MS}))
    state.access(clip, grant=GRANT_ID)
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    assert await opened.ready_outbox() == []
    assert await opened.store.grant(ACCESS_ID) is not None


@pytest.mark.parametrize("has_released", [True, False])
async def test_who_has_released_does_not_refuse_because_its_store_was_put_back(
    opened: CustodianHarness, has_released: bool
) -> None:
    clip = await opened.keep()
    state = state_of(clip)
    state.grant(GRANT_ID, clip)
    state.access(clip, grant=GRANT_ID, released={CUSTODIAN: 1} if has_released else {})
    await opened.custodian.reconcile(state.facts(at_ms=AT_MS))
    refusal = ("access.refused", [ACCESS_ID, "GRANT_PARTS_MISSING"])
    assert await opened.ready_outbox() == ([] if has_released else [refusal])


# The hunt


class Ledger:
    """A node's ledger for the hunt: a state, without blocks."""

    def __init__(self, state: State) -> None:
        self._rows = {key: encode_value(value) for key, value in state.rows.items()}
        self.position = SimpleNamespace(timestamp_ms=AT_MS)

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def snapshot(self) -> Ledger:
        return self

    def get(self, key: bytes) -> bytes | None:
        return self._rows.get(key)

    def block(self, _height: int) -> None:
        return None


@pytest.mark.parametrize("store", ["sqlite", "mongo"])
@pytest.mark.parametrize("end", ["revoked", "over", "denied"])
async def test_the_hunt_finds_a_part_that_is_left_after_the_end_of_its_grant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, store: str, end: str
) -> None:
    node = tmp_path / "network" / "nodes" / "node-1"
    uri = request.getfixturevalue("mongo_database") if store == "mongo" else "sqlite:"
    make = (lambda: MongoStore(uri)) if store == "mongo" else (lambda: SqliteStore(node / "custody"))
    folders = {"custody_dir": node / "custody", "erase_keys_dir": node / "erase-keys", "ledger_dir": node / "ledger"}
    config = SimpleNamespace(name="node-1", custody_store=uri, custodian_key_path=node, clips=None, **folders)
    cluster: Any = SimpleNamespace(folder=tmp_path / "network", configs={"node-1": config})
    clip = record_clip()
    state = state_of(clip)
    state.grant(GRANT_ID, clip)
    monkeypatch.setattr(hunting, "LedgerFile", lambda _folder: Ledger(state))
    house = CustodianHarness(make, node / "erase-keys")
    async with house.open():
        await share(house, clip)
        traces = gather(cluster, [clip.record_id])
        assert hunt(cluster, traces).is_clean, "while the grant stands the part may be there"
        write_traces(tmp_path / "before.json", traces)
        match end:
            case "revoked":
                state.grant(GRANT_ID, clip, status="revoked")
            case "over":
                state.grant(GRANT_ID, clip, until_ms=AT_MS)
            case _:
                state.quarantine()
        report = hunt(cluster, gather(cluster, [clip.record_id], read_traces(tmp_path / "before.json")))
        assert {finding.what for finding in report.forbidden} == {"wrapped-part", "erase-key"}
        await house.follow(revoked())
        report = hunt(cluster, gather(cluster, [clip.record_id], read_traces(tmp_path / "before.json")))
        assert report.is_clean, report.forbidden
        assert {"ciphertext", "wrapped-key", "erase-key"} <= {finding.what for finding in report.findings}

"""A custodian that has no blocks to follow takes the finalized state instead, and ends where the blocks would have led."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from consensus.state.audit import ENTRY
from consensus.state.identity import CUSTODIANS
from consensus.state.records import RECORD
from node.custody.chain_facts import ChainFacts, StateReader
from node.custody.erasure import RECORDS_A_CALL_MAX_COUNT
from node.custody.repair.reconciliation import RECORDS_AT_ONCE_COUNT
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import (
    ALICE,
    BOB,
    CUSTODIAN,
    EXPIRES_MS,
    OTHER_CUSTODIAN,
    START_MS,
    access,
    record_clip,
    recorded,
)
from tests.offchain.small_state import BOTH, State

LATER_ID = b"\xa2" * 32


async def reconcile(house: CustodianHarness, state: State, **options: Any) -> None:
    facts = state.facts(**options)
    await house.custodian.reconcile(facts)
    await house.custodian.reconcile(facts)
    house.chain.height, house.chain.time_ms = facts.point.height, facts.point.timestamp_ms
    assert await house.custodian.checkpoint() == facts.point


async def test_records_that_are_not_here_are_missing_and_can_be_fetched(opened: CustodianHarness) -> None:
    clip, bobs = record_clip(), record_clip()
    state = State()
    state.record(clip)
    state.record(bobs, BOB, erased_frames=[1])
    state.access(clip)
    await reconcile(opened, state)
    missing = {facts.record_id: facts for facts in await opened.custodian.missing(10)}
    assert missing.keys() == {clip.record_id, bobs.record_id}
    assert missing[bobs.record_id].erased_frames == (1,)
    await opened.custodian.stage(clip.upload)
    download = await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    assert read_all(clip, download) == list(clip.plaintexts)
    assert await opened.ready_outbox() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_a_staged_clip_that_became_final_meanwhile_is_confirmed_and_a_lapsed_one_goes(
    opened: CustodianHarness,
) -> None:
    final, lapsed, other = record_clip(), record_clip(), record_clip()
    for clip in (final, lapsed, other):
        await opened.custodian.stage(clip.upload)
    state = State()
    state.record(final)
    state.record(other, commitment_root=bytes(32))
    await reconcile(opened, state)
    clips = await opened.store.clips([final.record_id, lapsed.record_id, other.record_id])
    assert {record_id: clip.status for record_id, clip in clips.items()} == {final.record_id: "confirmed"}
    assert [facts.record_id for facts in await opened.custodian.missing(10)] == [other.record_id]


async def test_the_next_block_follows_the_state(opened: CustodianHarness) -> None:
    clip, late = record_clip(), record_clip(valid_until_ms=START_MS + 560_000)
    await opened.custodian.stage(clip.upload)
    state = State()
    state.record(clip)
    await reconcile(opened, state)
    await opened.custodian.stage(late.upload)
    await opened.follow(recorded(late), access(ACCESS_ID))
    for each in (clip, late):
        assert (await opened.custodian.download(each.record_id, ACCESS_ID, ALICE)).record_id == each.record_id


async def test_a_whole_visit_is_released_up_to_its_request_and_no_further(opened: CustodianHarness) -> None:
    before, after = record_clip(), record_clip()
    for clip in (before, after):
        await opened.custodian.stage(clip.upload)
    state = State()
    state.record(before, height=5)
    state.record(after, height=8)
    state.access(height=6)
    await reconcile(opened, state)
    assert (await opened.custodian.download(before.record_id, ACCESS_ID, ALICE)).record_id == before.record_id
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(after.record_id, ACCESS_ID, ALICE))


async def test_what_the_chain_knows_already_is_not_owed_again(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    state = State()
    state.record(clip)
    state.access(clip)
    state.released(clip)
    await reconcile(opened, state)
    assert await opened.ready_outbox() == []
    await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)


async def test_another_custodians_release_is_not_ones_own(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    state = State()
    state.record(clip)
    state.access(clip)
    state.released(clip, custodian=OTHER_CUSTODIAN)
    await reconcile(opened, state)
    assert await opened.ready_outbox() == [("access.released", [ACCESS_ID, [clip.record_id]])]


@pytest.mark.parametrize(
    ("awaited", "custodians", "owes"),
    [
        ([CUSTODIAN, OTHER_CUSTODIAN], BOTH, True),
        ([OTHER_CUSTODIAN], BOTH, False),
        ([OTHER_CUSTODIAN], [CUSTODIAN], True),
        ([CUSTODIAN], [OTHER_CUSTODIAN], False),
    ],
    ids=["awaits this one", "awaits another", "awaits one that was removed", "this one was removed"],
)
async def test_an_expired_record_that_waits_for_a_report_gets_it(
    opened: CustodianHarness, awaited: list[bytes], custodians: list[bytes], owes: bool
) -> None:
    clip, state = record_clip(), State()
    state.record(clip, status="expired", awaited=awaited)
    state.rows[b"identity\x00custodians"] = custodians
    await reconcile(opened, state)
    assert [(kind, told[0]) for kind, told in await opened.ready_outbox()] == [
        ("erasure.expired", [clip.record_id])
    ] * owes


async def test_a_refusal_that_was_told_is_not_told_again(opened: CustodianHarness) -> None:
    clip = record_clip()
    state = State()
    state.record(clip, status="erased")
    state.access(clip, refused={CUSTODIAN: "CLIP_ERASED"})
    await reconcile(opened, state)
    assert await opened.ready_outbox() == []


async def test_an_erasure_asked_for_meanwhile_is_carried_out_and_owed(opened: CustodianHarness) -> None:
    clip, framed = record_clip(), record_clip()
    for each in (clip, framed):
        await opened.keep(each)
    state = State()
    state.record(clip, status="erasing")
    state.record(framed)
    state.erasure(clip)
    await reconcile(opened, state)
    ((call, arguments),) = await opened.ready_outbox()
    assert (call, arguments[:2]) == ("erasure.receipt", [ERASURE_ID, 3])
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].status == "erased"
    assert (await opened.store.clips([framed.record_id]))[framed.record_id].status == "confirmed"


async def test_frames_erased_meanwhile_go_from_what_is_held(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    state = State()
    state.record(clip)
    state.access(clip)
    state.erasure(clip, frames=(1,))
    await reconcile(opened, state)
    download = await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    assert read_all(clip, download) == [clip.plaintexts[0], None, clip.plaintexts[2]]


async def test_a_store_put_back_from_a_backup_erases_what_it_had_erased(opened: CustodianHarness) -> None:
    """Its receipt is on the chain: nothing is owed, and nothing is kept."""
    clip = await opened.keep()
    state = State()
    state.record(clip, status="erased")
    state.erasure(clip, receipts=BOTH, status="complete")
    await reconcile(opened, state)
    assert await opened.ready_outbox() == []
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].status == "erased"
    assert await opened.store.frames(clip.record_id) == []


async def test_an_erasure_from_before_this_custodian_came_is_carried_out_without_a_receipt(
    opened: CustodianHarness,
) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    state = State()
    state.record(clip, status="erasing")
    state.erasure(clip, custodians=[OTHER_CUSTODIAN])
    await reconcile(opened, state)
    assert await opened.ready_outbox() == []
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].status == "erased"


async def test_what_expired_meanwhile_is_erased_and_reported(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    state = State()
    state.record(clip, status="expired", custodians=[OTHER_CUSTODIAN])
    await reconcile(opened, state, at_ms=EXPIRES_MS + 1)
    ((call, arguments),) = await opened.ready_outbox()
    assert (call, arguments[0]) == ("erasure.expired", [clip.record_id])
    assert await opened.store.frames(clip.record_id) == []


async def test_a_state_older_than_the_store_changes_nothing(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    before = await opened.custodian.checkpoint()
    state = State()
    state.record(clip, status="erasing")
    state.erasure(clip)
    await opened.custodian.reconcile(state.facts(height=1))
    assert await opened.custodian.checkpoint() == before
    assert await opened.ready_outbox() == []


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("restricted", {"ground": "accuracy"}),
        ("objected", {"purposes": ["research"]}),
        ("denied", {}),
        ("transferred", {"transfers": 1}),
        ("breach_closed", {"outcome": "released"}),
    ],
)
async def test_a_request_from_before_a_word_that_was_taken_back_since_is_void_and_a_later_one_is_not(
    opened: CustodianHarness, kind: str, data: dict[str, Any]
) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    state = State()
    state.record(clip)
    state.access(clip, height=6)
    state.said(kind, 6, **data)
    await reconcile(opened, state, height=50)
    await refused("ACCESS_ENDED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    assert await opened.ready_outbox() == []
    await opened.follow(access(LATER_ID, clip))
    assert (await opened.custodian.download(clip.record_id, LATER_ID, ALICE)).record_id == clip.record_id


@pytest.mark.parametrize(
    ("kind", "owner", "height", "data"),
    [
        ("restricted", ALICE, 5, {}),
        ("restricted", BOB, 9, {}),
        ("restriction_lifted", ALICE, 9, {}),
        ("breach_closed", ALICE, 9, {"outcome": "erased"}),
    ],
    ids=["before it", "of another visit", "of no matter", "without an end of it"],
)
async def test_a_request_after_all_that_was_said_is_heeded_by_a_custodian_that_only_has_the_state(
    opened: CustodianHarness, kind: str, owner: bytes, height: int, data: dict[str, Any]
) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    state = State()
    state.record(clip)
    state.access(clip, height=6)
    state.said(kind, height, owner=owner, **data)
    await reconcile(opened, state, height=50)
    assert (await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)).record_id == clip.record_id


async def test_a_word_that_blocks_told_is_not_forgotten_over_a_state_that_does_not_tell_it(
    house: CustodianHarness,
) -> None:
    clip = record_clip()
    async with house.open():
        await house.keep(clip)
        await house.follow(access(ACCESS_ID, clip))
        told = {"owner": ALICE, "whole": True, "whole_since_ms": START_MS, "until_ms": 0, "records": []}
        await house.follow(("rights", "restricted", told))
    state = State()
    state.record(clip, height=1)
    state.access(clip, height=2)
    async with house.open():
        await reconcile(house, state, height=50)
        await refused("ACCESS_ENDED", house.custodian.download(clip.record_id, ACCESS_ID, ALICE))


async def test_the_audit_is_walked_once_however_many_requests_there_are(opened: CustodianHarness) -> None:
    """A custodian of a large hospital starts from the state: a walk for each request would take it days."""
    state, walks = State(), []
    state.access(height=6)
    state.erasure(receipts=[CUSTODIAN, OTHER_CUSTODIAN])
    facts = state.facts()
    scan = facts._state.scan
    facts._state.scan = lambda prefix, limit: walks.append(prefix) or scan(prefix, limit)  # type: ignore[method-assign]
    assert [access.height for access in facts.accesses()] == [6]
    assert [erasure.height for erasure in facts.erasures()] == [7]
    assert list(facts.open_erasures()) == []
    assert walks.count(ENTRY.flat) == 1


class _Watched:
    """A state that notes how many rows are read on the event loop's own thread from one turn of the loop to the next."""

    def __init__(self, state: StateReader) -> None:
        self._state, self._loop_thread = state, threading.current_thread()
        self.rows_of_turn_count = self.rows_max_count = 0
        self.is_held, self.read_on = threading.Event(), threading.Event()
        self.read_on.set()

    def get(self, key: bytes) -> bytes | None:
        return self._state.get(key)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return self._watch(self._state.scan(prefix, limit))

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        return self._watch(self._state.scan_range(start, end))

    def _watch(self, rows: Iterator[tuple[bytes, bytes]]) -> Iterator[tuple[bytes, bytes]]:
        for row in rows:
            self.is_held.set()
            self.read_on.wait(10)
            self.rows_of_turn_count += threading.current_thread() is self._loop_thread
            self.rows_max_count = max(self.rows_max_count, self.rows_of_turn_count)
            yield row

    async def turn(self) -> None:
        while True:
            self.rows_of_turn_count = 0
            await asyncio.sleep(0)


def _of_many() -> tuple[_Watched, ChainFacts]:
    """A state with hundreds of records, each with words in the audit, of which most were erased or have expired."""
    clip, state = record_clip(), State()
    state.record(clip)
    row = state.rows.pop(RECORD.key(clip.record_id))
    for number in range(600):
        status = ("active", "erased", "expired")[number % 3]
        awaited = [CUSTODIAN] if status == "expired" else []
        state.rows[RECORD.key(number.to_bytes(16, "big"))] = row | {"status": status, "awaited": awaited}
        state.said("access_requested", 5, owner=number.to_bytes(33, "big"))
    state.rows[CUSTODIANS.flat] = BOTH
    facts = state.facts()
    watched = _Watched(facts._state)
    return watched, ChainFacts(watched, facts.point)


@pytest.mark.parametrize("name", ["reconcile", "report_expired"])
async def test_however_many_records_there_are_the_event_loop_goes_on(opened: CustodianHarness, name: str) -> None:
    watched, facts = _of_many()
    turning = asyncio.ensure_future(watched.turn())
    await getattr(opened.custodian, name)(facts)
    turning.cancel()
    assert watched.rows_max_count <= RECORDS_AT_ONCE_COUNT
    assert len(await opened.ready_outbox()) == -(-200 // RECORDS_A_CALL_MAX_COUNT)


async def test_a_cancelled_reconciliation_ends_when_nothing_reads_the_state_any_more(opened: CustodianHarness) -> None:
    watched, facts = _of_many()
    watched.read_on.clear()
    work = asyncio.ensure_future(opened.custodian.reconcile(facts))
    await asyncio.to_thread(watched.is_held.wait, 10)
    work.cancel()
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert not work.done()
    watched.read_on.set()
    with pytest.raises(asyncio.CancelledError):
        await work

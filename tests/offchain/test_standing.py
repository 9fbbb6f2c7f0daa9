"""What a custodian does of restrictions, objections and denials, on every store: nothing narrowed leaves it.

Also for requests that were open before, in blocks that come twice, after a restart, and where the state is all there is.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from node.custody.custodian import Custodian
from node.custody.finalized_events import FinalizedEvents
from node.custody.repair.scrub import RecordComparer, ScrubReport
from node.custody.restrictions import find_restrictions
from node.custody.stores.custody_store import BlockEffects, VisitRestrictions
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, refused
from tests.offchain.small_chain import (
    ALICE,
    BOB,
    EXPIRES_MS,
    START_MS,
    RecordedClip,
    access,
    erasure,
    record_clip,
    recorded,
)
from tests.offchain.small_state import State
from tests.offchain.test_reconciling import reconcile

SECOND_ACCESS = b"\xa2" * 32
YEAR_MS = 366 * 24 * 3600 * 1000
Event = tuple[str, str, dict[str, Any]]


def restricted(*clips: RecordedClip, until_ms: int = 0, whole: bool = False, owner: bytes = ALICE) -> Event:
    """All that is restricted now, as the contract says it each time."""
    data = {
        "owner": owner,
        "whole": whole,
        "whole_since_ms": START_MS if whole else 0,
        "until_ms": until_ms,
        "records": [clip.record_id for clip in clips],
    }
    return "rights", "restricted", data


def lifted(*left: RecordedClip, until_ms: int = 0, owner: bytes = ALICE) -> Event:
    return "rights", "lifted", restricted(*left, until_ms=until_ms, owner=owner)[2]


def denied(owner: bytes = ALICE) -> Event:
    return "rights", "quarantined", {"owner": owner, "breach_id": b"\xb1" * 32, "org": "ward", "due_ms": 0, "number": 0}


def cleared(owner: bytes = ALICE) -> Event:
    return "rights", "quarantine_ended", {"owner": owner, "breach_id": b"\xb1" * 32}


def objected(owner: bytes = ALICE) -> Event:
    return "rights", "objected", {"owner": owner, "purposes": ["research"]}


def transferred(owner: bytes = ALICE) -> Event:
    return "records", "transferred", {"owner": owner, "new_owner": b"\x02" + b"\xa1" * 32, "sequence": 3}


NARROWED = [
    ("ACCESS_ENDED", restricted),
    ("ACCESS_ENDED", objected),
    ("ACCESS_ENDED", transferred),
    ("CLIP_QUARANTINED", denied),
]


@pytest.mark.parametrize(("code", "said"), NARROWED)
async def test_a_request_that_was_open_before_is_void(opened: CustodianHarness, code: str, said: Any) -> None:
    clip, others = await opened.keep(), await opened.keep(owner=BOB)
    await opened.follow(access(ACCESS_ID, clip), access(SECOND_ACCESS, others, owner=BOB))
    assert await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    await opened.follow(said())
    await refused(code, opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    assert await opened.custodian.download(others.record_id, SECOND_ACCESS, BOB), "nobody else is touched"


@pytest.mark.parametrize("is_asked_first", [True, False])
async def test_a_request_of_the_same_block_is_void_in_either_order(
    opened: CustodianHarness, is_asked_first: bool
) -> None:
    """A custodian keeps heights, not places: who asked in the very block asks once more."""
    clip = await opened.keep()
    events = [access(ACCESS_ID, clip), restricted(clip)]
    await opened.follow(*(events if is_asked_first else events[::-1]))
    await refused("ACCESS_ENDED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))


@pytest.mark.parametrize(("code", "said"), NARROWED)
async def test_it_stays_void_over_a_restart_and_a_block_that_comes_twice(
    house: CustodianHarness, code: str, said: Any
) -> None:
    clip = record_clip()
    async with house.open():
        await house.keep(clip)
        await house.follow(access(ACCESS_ID, clip))
        await house.follow(said())
    async with house.open() as custodian:
        for block in house.chain.blocks:
            await custodian.on_finalized_block(block)
        await refused(code, custodian.download(clip.record_id, ACCESS_ID, ALICE))
        await house.follow()
        await refused(code, custodian.download(clip.record_id, ACCESS_ID, ALICE))


async def test_what_the_chain_lets_her_ask_for_afterwards_is_released(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(restricted(clip))
    await opened.follow(access(ACCESS_ID, clip))
    assert await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    await opened.follow(lifted())
    assert await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE), "lifting narrows nothing"


async def test_a_denied_visit_is_released_to_nobody_until_an_officer_ends_it(opened: CustodianHarness) -> None:
    clip, late = record_clip(), record_clip()
    await opened.keep(clip)
    await opened.follow(denied())
    await opened.keep(late)
    await opened.follow(access(ACCESS_ID, clip, late))
    for one in (clip, late):
        await refused("CLIP_QUARANTINED", opened.custodian.download(one.record_id, ACCESS_ID, ALICE))
        await refused("CLIP_QUARANTINED", opened.custodian.export(one.record_id))
    assert (await opened.custodian.look_at(clip.record_id)).frames, "upkeep still reads it"
    assert await opened.ready_outbox() == [], "nothing is said to have been released"
    await opened.follow(cleared())
    await refused("ACCESS_ENDED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    await opened.follow(access(SECOND_ACCESS, clip, late))
    for one in (clip, late):
        assert await opened.custodian.download(one.record_id, SECOND_ACCESS, ALICE)


async def test_a_restricted_clip_is_still_copied_to_other_custodians(opened: CustodianHarness) -> None:
    """Article 18(2): storing goes on."""
    clip = await opened.keep()
    await opened.follow(restricted(clip))
    assert (await opened.custodian.export(clip.record_id)).record_id == clip.record_id


async def test_a_word_that_becomes_final_while_frames_are_read_stops_the_release(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = await opened.keep()
    await opened.follow(access(ACCESS_ID, clip))
    reading, go_on = asyncio.Event(), asyncio.Event()
    frames = opened.store.frames

    async def slow(record_id: bytes) -> Any:
        found = await frames(record_id)
        reading.set()
        await go_on.wait()
        return found

    monkeypatch.setattr(opened.store, "frames", slow)
    download = asyncio.create_task(opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    await reading.wait()
    await opened.follow(denied())
    go_on.set()
    await refused("CLIP_QUARANTINED", download)


async def test_a_clip_that_comes_late_is_not_released_under_a_void_request(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    await opened.follow(access(ACCESS_ID, clip))
    await opened.follow(restricted(clip))
    await opened.custodian.stage(clip.upload)
    assert await opened.ready_outbox() == []
    await refused("ACCESS_ENDED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))


# Keeping beyond the expiry


async def test_what_is_kept_for_a_claim_outlives_its_expiry_until_it_is_lifted(opened: CustodianHarness) -> None:
    clip, other = await opened.keep(), await opened.keep()
    await opened.follow(restricted(clip, until_ms=START_MS + YEAR_MS))
    await opened.follow(at_ms=EXPIRES_MS + 1)
    await opened.follow(access(ACCESS_ID, clip))
    assert await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    assert [arguments[0] for kind, arguments in await opened.ready_outbox() if kind == "erasure.expired"] == [
        [other.record_id]
    ]
    await opened.follow(lifted())
    await refused("CLIP_ERASED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    restrictions = await find_restrictions(opened.store, ALICE)
    assert restrictions is not None
    assert restrictions.natural == ()


async def test_a_lift_before_the_expiry_gives_the_clip_its_own_time_again(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(restricted(clip, until_ms=START_MS + YEAR_MS))
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].expires_at_ms == START_MS + YEAR_MS
    await opened.follow(lifted())
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].expires_at_ms == EXPIRES_MS


async def test_keeping_ends_by_itself(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(restricted(clip, until_ms=START_MS + YEAR_MS))
    await opened.follow(at_ms=START_MS + YEAR_MS)
    assert [kind for kind, _ in await opened.ready_outbox()] == ["erasure.expired"]


async def test_what_is_recorded_into_a_visit_that_is_kept_is_kept_too(opened: CustodianHarness) -> None:
    held, missing = record_clip(), record_clip()
    await opened.follow(restricted(whole=True, until_ms=START_MS + YEAR_MS))
    await opened.keep(held)
    await opened.follow(recorded(missing))
    await opened.follow(at_ms=EXPIRES_MS + 1)
    await opened.custodian.stage(record_clip(valid_until_ms=EXPIRES_MS + 60_000).upload)
    assert await opened.store.missing_clips([missing.record_id]), "it is still to be fetched"
    assert (await opened.store.clips([held.record_id]))[held.record_id].status == "confirmed"
    await opened.follow(lifted())
    assert not await opened.store.missing_clips([missing.record_id])
    assert (await opened.store.clips([held.record_id]))[held.record_id].status == "erased"


async def test_all_that_is_missing_of_a_visit_is_kept_and_nothing_of_others(opened: CustodianHarness) -> None:
    old, newer = record_clip(), record_clip(owner=BOB)
    await opened.follow(recorded(old))
    await opened.follow(recorded(newer, owner=BOB))
    await opened.follow(restricted(old, until_ms=START_MS + YEAR_MS))
    found = (await opened.store.missing_clips([old.record_id])).get(old.record_id)
    assert found is not None
    assert found.expires_at_ms == START_MS + YEAR_MS
    assert [one.record_id for one in await opened.store.missing_of_owner(ALICE)] == [old.record_id]


async def test_an_owner_who_denies_keeps_nothing(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(restricted(clip, until_ms=START_MS + YEAR_MS))
    await opened.follow(denied())
    await opened.follow(at_ms=EXPIRES_MS + 1)
    assert [kind for kind, _ in await opened.ready_outbox()] == ["erasure.expired"]


async def test_a_restricted_clip_is_erased_when_its_owner_asks(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(restricted(clip, until_ms=START_MS + YEAR_MS))
    await opened.follow(erasure(ERASURE_ID, clip))
    assert [kind for kind, _ in await opened.ready_outbox()] == ["erasure.receipt"]


@pytest.mark.parametrize("events", [[restricted], [restricted, lifted]])
async def test_a_crash_between_any_two_writes_loses_no_expiry(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch, events: list[Any]
) -> None:
    """Every write of the hook in turn is the last one; after the restart the block is carried out again."""
    clip = record_clip()
    until_ms = START_MS + YEAR_MS
    async with house.open():
        await house.keep(clip)
    for event in events:
        said = event(clip, until_ms=until_ms) if event is restricted else event()
        block = house.chain.block(said)
        for writes in range(8):
            async with house.open() as custodian:
                if not await _dies_after(custodian, house, block, writes, monkeypatch):
                    break
        async with house.open() as custodian:
            await custodian.on_finalized_block(block)
            kept = (await house.store.clips([clip.record_id]))[clip.record_id]
            assert kept.expires_at_ms == (until_ms if event is restricted else EXPIRES_MS)


async def _dies_after(
    custodian: Custodian, house: CustodianHarness, block: FinalizedEvents, writes: int, monkeypatch: pytest.MonkeyPatch
) -> bool:
    left = [writes]
    apply = house.store.apply

    async def dying(effects: BlockEffects) -> None:
        if left[0] == 0:
            raise BlockRobotError("STORE_UNAVAILABLE", "The power is gone.")
        left[0] -= 1
        await apply(effects)

    with monkeypatch.context() as patched:
        patched.setattr(house.store, "apply", dying)
        try:
            await custodian.on_finalized_block(block)
        except BlockRobotError:
            return True
    return False


async def test_a_store_keeps_one_standing_for_each_owner_over_a_restart(house: CustodianHarness) -> None:
    first = VisitRestrictions(ALICE, 4, quarantined=True, natural=((b"\x01" * 16, 9),))
    second = VisitRestrictions(BOB, 5, whole=True, whole_since_ms=3, until_ms=1 << 50, records=(b"\x02" * 16,))
    async with house.open():
        await house.store.apply(BlockEffects(visit_restrictions=(VisitRestrictions(ALICE), second)))
        await house.store.apply(BlockEffects(visit_restrictions=(first,)))
    async with house.open():
        assert await house.store.visit_restrictions() == {ALICE: first, BOB: second}
        assert await house.store.visit_restrictions([BOB, b"\x07" * 33]) == {BOB: second}
        assert await house.store.visit_restrictions([]) == {}


async def test_only_a_confirmed_clip_gets_another_expiry(opened: CustodianHarness) -> None:
    staged, kept = record_clip(), record_clip()
    await opened.keep(kept)
    await opened.custodian.stage(staged.upload)
    unknown = b"\x09" * 16
    changes = tuple((key, EXPIRES_MS + 7) for key in (staged.record_id, kept.record_id, unknown))
    await opened.store.apply(BlockEffects(expiries=changes))
    found = await opened.store.clips([staged.record_id, kept.record_id, unknown])
    assert {key: clip.expires_at_ms for key, clip in found.items()} == {
        staged.record_id: 0,
        kept.record_id: EXPIRES_MS + 7,
    }


# Where the state is all there is


def _state(clip: RecordedClip, height: int = 5) -> State:
    state = State()
    state.record(clip, height=height)
    state.rows[b"records\x00of-visit/" + ALICE + clip.record_id] = True
    return state


def _restriction(clip: RecordedClip) -> dict[str, Any]:
    told = restricted(clip, until_ms=START_MS + YEAR_MS)[2]
    return {**told, "ground": "legal-claim", "time": START_MS}


async def test_a_custodian_that_only_has_the_state_heeds_the_same(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    state = _state(clip)
    state.access(clip)
    state.rows[b"rights\x00quarantine/" + ALICE] = b"\xb1" * 32
    await reconcile(opened, state)
    await refused("CLIP_QUARANTINED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    await refused("CLIP_QUARANTINED", opened.custodian.export(clip.record_id))
    assert await opened.ready_outbox() == []


@pytest.mark.parametrize("is_here", [True, False])
async def test_a_clip_that_is_kept_for_a_claim_is_there_after_a_reconciliation(
    opened: CustodianHarness, is_here: bool
) -> None:
    clip = record_clip(valid_until_ms=START_MS + 500)
    if is_here:
        await opened.custodian.stage(clip.upload)
    state = _state(clip)
    state.access(clip)
    state.rows[b"rights\x00restriction/" + ALICE] = _restriction(clip)
    await reconcile(opened, state, at_ms=EXPIRES_MS + 10)
    if not is_here:
        await opened.custodian.stage(clip.upload)
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].expires_at_ms == START_MS + YEAR_MS
    await refused("ACCESS_ENDED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    report = await scrub_of(opened, state, EXPIRES_MS + 10)
    assert (report.other_facts, report.held_though_erased, report.missing) == ([], [], [])
    await opened.follow(lifted())
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].status == "erased"


async def scrub_of(house: CustodianHarness, state: State, at_ms: int) -> ScrubReport:
    facts, report = state.facts(at_ms=at_ms), ScrubReport()
    judge = RecordComparer(house.custodian, house.store, facts)
    for record in facts.records():
        clip = (await house.store.clips([record.facts.record_id])).get(record.facts.record_id)
        await judge.compare(record.facts.record_id, record, clip, report)
    return report


async def test_what_was_lifted_while_a_custodian_was_away_is_let_go(house: CustodianHarness) -> None:
    clip = record_clip()
    async with house.open():
        await house.keep(clip)
        await house.follow(restricted(clip, until_ms=START_MS + YEAR_MS), denied(BOB))
    async with house.open():
        await reconcile(house, _state(clip, height=1), at_ms=EXPIRES_MS - 10)
        assert (await house.store.clips([clip.record_id]))[clip.record_id].expires_at_ms == EXPIRES_MS
        bobs = (await house.store.visit_restrictions([BOB]))[BOB]
        assert not bobs.quarantined
        await house.follow(at_ms=EXPIRES_MS)
        assert (await house.store.clips([clip.record_id]))[clip.record_id].status == "erased"


@pytest.mark.parametrize("left", ["objected", "denied", "of another record"])
async def test_what_was_lifted_while_away_is_let_go_though_something_else_stands_of_the_visit(
    house: CustodianHarness, left: str
) -> None:
    clip, other = record_clip(), record_clip()
    async with house.open():
        await house.keep(clip)
        await house.keep(other)
        await house.follow(restricted(clip, other, until_ms=START_MS + YEAR_MS))
    state = _state(clip, height=1)
    state.record(other, height=2)
    state.rows[b"records\x00of-visit/" + ALICE + other.record_id] = True
    if left == "objected":
        state.rows[b"rights\x00objection/" + ALICE] = {"research": START_MS}
    elif left == "denied":
        state.rows[b"rights\x00quarantine/" + ALICE] = b"\xb1" * 32
    else:
        state.rows[b"rights\x00restriction/" + ALICE] = _restriction(other)
    async with house.open():
        await reconcile(house, state, at_ms=EXPIRES_MS - 10)
        assert (await house.store.clips([clip.record_id]))[clip.record_id].expires_at_ms == EXPIRES_MS
        await house.follow(at_ms=EXPIRES_MS)
        kept = await house.store.clips([clip.record_id, other.record_id])
        assert kept[clip.record_id].status == "erased"
        assert kept[other.record_id].status == ("confirmed" if left == "of another record" else "erased")

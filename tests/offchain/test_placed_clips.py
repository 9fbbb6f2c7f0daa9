"""Clips that others keep: neither missing nor fetched, and yet erased, reported, shared, and taken over when due."""

from __future__ import annotations

from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from consensus.records.placement import Placement
from consensus.state.identity import CUSTODIANS
from consensus.state.settings import CUSTODY_COPIES, QUOTA
from node.custody.clip_fetching import PLACED_AT_ONCE_COUNT
from node.custody.stores.copying import copy_store
from node.custody.stores.custody_store import RecordFacts
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.desk import CustodyHarness
from tests.offchain.desk import Peer as HelpfulPeer
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import (
    ALICE,
    CUSTODIAN,
    EXPIRES_MS,
    OTHER_CUSTODIAN,
    RecordedClip,
    access,
    erasure,
    record_clip,
    recorded,
)
from tests.offchain.small_state import State
from tests.offchain.test_fetching import Peer, held_by_peer
from tests.offchain.test_reconciling import reconcile
from tests.offchain.test_sharing import GRANT_ID, HER_ACCESS_ID, OTHER_GRANT_ID, asked, granted, parts_for, request

THIRD = b"\x02" + b"\x33" * 32
OF_THREE = Placement.even([CUSTODIAN, OTHER_CUSTODIAN, THIRD], 2)
OF_TWO = Placement.even([CUSTODIAN, OTHER_CUSTODIAN], 2)


def clip_of(placement: Placement = OF_THREE, *, kept_here: bool) -> RecordedClip:
    while True:
        clip = record_clip()
        if placement.is_keeper(CUSTODIAN, clip.record_id) == kept_here:
            return clip


@pytest.fixture
async def placed(opened: CustodianHarness) -> CustodianHarness:
    opened.placement = OF_THREE
    await opened.custodian.follow_placement()
    return opened


async def missing(house: CustodianHarness) -> list[bytes]:
    return [facts.record_id for facts in await house.custodian.missing(10)]


async def test_only_what_is_to_be_kept_here_is_missing(placed: CustodianHarness) -> None:
    mine, others = clip_of(kept_here=True), clip_of(kept_here=False)
    await placed.follow(recorded(mine), recorded(others))
    assert await missing(placed) == [mine.record_id]
    counts = await placed.store.counts()
    assert (counts.missing, counts.elsewhere) == (1, 1)
    peer = Peer(held_by_peer(mine), held_by_peer(others))
    assert await placed.custodian.fetch_missing([peer]) == 1
    assert not await placed.custodian.holds(others.record_id)


async def test_a_request_is_answered_by_who_has_the_clip_and_refused_by_nobody(placed: CustodianHarness) -> None:
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip))
    await placed.follow(access(ACCESS_ID, clip))
    assert await placed.ready_outbox() == []
    await refused("NOT_FOUND", placed.custodian.download(clip.record_id, ACCESS_ID, ALICE))


async def test_what_was_taken_is_kept_whoever_is_to_keep_it(placed: CustodianHarness) -> None:
    """Membership may change between upload and record: then nobody but those that took it has it."""
    clip = await placed.keep(clip_of(kept_here=False))
    await placed.follow(access(ACCESS_ID, clip))
    assert read_all(clip, await placed.custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(clip.plaintexts)


async def test_a_late_upload_is_taken_too(placed: CustodianHarness) -> None:
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip))
    await placed.custodian.stage(clip.upload)
    assert (await placed.store.clips([clip.record_id]))[clip.record_id].status == "confirmed"
    assert (await placed.store.counts()).elsewhere == 0


async def test_an_erasure_is_confirmed_with_nothing_destroyed(placed: CustodianHarness) -> None:
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip))
    await placed.follow(erasure(ERASURE_ID, clip))
    ((kind, arguments),) = await placed.ready_outbox()
    assert (kind, arguments[:3]) == ("erasure.receipt", [ERASURE_ID, 0, "nothing"])
    assert (await placed.store.counts()).elsewhere == 0


async def test_what_is_over_is_reported_and_forgotten(placed: CustodianHarness) -> None:
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip))
    await placed.follow(at_ms=EXPIRES_MS)
    assert [(kind, arguments[0]) for kind, arguments in await placed.ready_outbox()] == [
        ("erasure.expired", [clip.record_id])
    ]
    assert (await placed.store.counts()).elsewhere == 0


async def test_when_a_custodian_leaves_its_clips_are_missing_and_fetched_without_what_was_erased(
    placed: CustodianHarness,
) -> None:
    clip, gone = clip_of(kept_here=False), clip_of(kept_here=False)
    await placed.follow(recorded(clip), recorded(gone))
    await placed.follow(erasure(ERASURE_ID, clip, frames=(1,)), erasure(bytes(32), gone))
    placed.placement = OF_TWO
    assert await placed.custodian.follow_placement() == 1
    assert await missing(placed) == [clip.record_id]
    assert await placed.custodian.fetch_missing([Peer(held_by_peer(clip), held_by_peer(gone))]) == 1
    await placed.follow(access(ACCESS_ID, clip))
    opened = read_all(clip, await placed.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    assert opened == [clip.plaintexts[0], None, clip.plaintexts[2]]


async def test_when_one_joins_nothing_is_dropped_and_what_is_its_is_missing_no_more(opened: CustodianHarness) -> None:
    opened.placement = OF_TWO
    await opened.custodian.follow_placement()
    held, absent = await opened.keep(clip_of(kept_here=False)), clip_of(kept_here=False)
    await opened.follow(recorded(absent))
    assert await missing(opened) == [absent.record_id]
    opened.placement = OF_THREE
    assert await opened.custodian.follow_placement() == 1
    assert await missing(opened) == []
    assert await opened.custodian.holds(held.record_id)


async def test_a_long_list_is_sorted_to_its_end_once(placed: CustodianHarness) -> None:
    clips = [record_clip(1) for _ in range(PLACED_AT_ONCE_COUNT + 9)]
    await placed.follow(*(recorded(clip) for clip in clips))
    others = (await placed.store.counts()).elsewhere
    placed.placement = OF_TWO
    assert await placed.custodian.follow_placement() == others
    assert await placed.custodian.follow_placement() == 0
    assert (await placed.store.counts()).missing == len(clips)


async def test_what_came_while_others_were_to_keep_it_is_sorted_anew_when_all_is_as_before(
    placed: CustodianHarness,
) -> None:
    placed.placement = OF_TWO
    await placed.custodian.follow_placement()
    placed.placement = OF_THREE
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip))
    placed.placement = OF_TWO
    assert await placed.custodian.follow_placement() == 1
    assert await missing(placed) == [clip.record_id]


async def test_a_change_while_a_long_list_is_sorted_ends_that_and_the_next_time_it_begins_anew(
    placed: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = [record_clip(1) for _ in range(PLACED_AT_ONCE_COUNT + 9)]
    await placed.follow(*(recorded(clip) for clip in clips))
    read, placed.placement = placed.store.absent, OF_TWO

    async def absent(after: bytes, limit: int) -> list[RecordFacts]:
        if after:
            placed.placement = OF_THREE
        return await read(after, limit)

    monkeypatch.setattr(placed.store, "absent", absent)
    changed = [await placed.custodian.follow_placement() for _ in range(2)]
    assert 0 < changed[0] < PLACED_AT_ONCE_COUNT
    assert changed[1] == changed[0], "what was missing for a moment is kept elsewhere again"
    mine = sum(OF_THREE.is_keeper(CUSTODIAN, clip.record_id) for clip in clips)
    assert (await placed.store.counts()).missing == mine


async def test_keepers_are_asked_before_who_answered_faster(placed: CustodianHarness) -> None:
    mine = clip_of(kept_here=True)
    await placed.follow(recorded(mine))
    other, quick = Peer(held_by_peer(mine)), Peer()
    keeper = next(key for key in OF_THREE.keepers(mine.record_id) if key != CUSTODIAN)
    other.name, other.member, quick.name, quick.member = "slow", keeper, "quick", bytes(33)
    placed.custodian._waited_s["slow"] = 60.0
    asked_names: list[str] = []
    for peer in (other, quick):
        fetch = peer.fetch

        async def noted(record_id: bytes, name: str = peer.name, fetch=fetch):
            asked_names.append(name)
            return await fetch(record_id)

        peer.fetch = noted  # type: ignore[method-assign]
    assert await placed.custodian.fetch_missing([quick, other]) == 1
    assert asked_names == ["slow"]


async def test_parts_of_a_key_are_kept_and_given_without_the_clip(placed: CustodianHarness) -> None:
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip))
    upload = parts_for(clip)[CUSTODIAN]
    assert await placed.custodian.stage_part(upload, ALICE) == "staged"
    await placed.follow(granted(clip))
    await placed.follow(asked(clip))
    assert await placed.ready_outbox() == [("access.released", [HER_ACCESS_ID, [clip.record_id]])]
    found = await placed.custodian.download_shared(request(clip), GRANT_ID)
    assert (found.package, found.parts, found.frames) == (upload.package, upload.parts, [])
    placed.placement = OF_TWO
    await placed.custodian.follow_placement()
    await refused("CLIP_NOT_CONFIRMED", placed.custodian.download_shared(request(clip), GRANT_ID))
    await placed.custodian.fetch_missing([Peer(held_by_peer(clip))])
    assert len(await placed.ready_outbox()) == 1, "it is told once"
    assert (await placed.custodian.download_shared(request(clip), GRANT_ID)).frames


async def test_parts_that_come_late_are_told_of_and_those_that_never_come_too(placed: CustodianHarness) -> None:
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip), granted(clip))
    await placed.follow(asked(clip))
    assert await placed.ready_outbox() == [("access.refused", [HER_ACCESS_ID, "GRANT_PARTS_MISSING"])]
    assert await placed.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE) == "confirmed"
    assert ("access.released", [HER_ACCESS_ID, [clip.record_id]]) in await placed.ready_outbox()


async def test_an_erasure_destroys_the_parts_of_a_clip_kept_elsewhere(placed: CustodianHarness) -> None:
    clip = clip_of(kept_here=False)
    await placed.follow(recorded(clip))
    await placed.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE)
    await placed.follow(granted(clip))
    await placed.follow(erasure(ERASURE_ID, clip))
    assert [place async for place in placed.store.all_parts()] == []
    assert placed.keys.held == []
    with pytest.raises(BlockRobotError, match=r"^CLIP_ERASED"):
        await placed.custodian.stage_part(parts_for(clip, grant_id=OTHER_GRANT_ID)[CUSTODIAN], ALICE)


async def test_a_moved_store_knows_what_others_keep(placed: CustodianHarness, tmp_path: Path) -> None:
    mine, others = clip_of(kept_here=True), clip_of(kept_here=False)
    await placed.follow(recorded(mine), recorded(others))
    async with SqliteStore(tmp_path / "other") as store:
        copied = await copy_store(placed.store, store)
        assert (copied.missing, copied.elsewhere) == (1, 1)


def state_of_three() -> State:
    state = State()
    state.rows |= {CUSTODIANS.flat: sorted(OF_THREE.rooms), QUOTA.key(CUSTODY_COPIES): OF_THREE.copies}
    return state


async def test_a_state_is_taken_as_blocks_are(opened: CustodianHarness) -> None:
    opened.placement = OF_THREE
    mine, others, state = clip_of(kept_here=True), clip_of(kept_here=False), state_of_three()
    for clip in (mine, others):
        state.record(clip)
    await reconcile(opened, state)
    assert await missing(opened) == [mine.record_id]
    assert (await opened.store.counts()).elsewhere == 1


async def test_a_scrub_finds_missing_what_is_to_be_kept_here_and_a_rebuild_fetches_that(
    placed: CustodianHarness,
) -> None:
    desk = CustodyHarness(placed)
    desk.state = state_of_three()
    mine, others = clip_of(kept_here=True), clip_of(kept_here=False)
    await placed.follow(recorded(mine), recorded(others))
    for clip in (mine, others):
        desk.record(clip)
    assert (await desk.scrub()).missing == [mine.record_id]
    rebuilt = await desk.rebuild(HelpfulPeer(mine, others))
    assert (rebuilt.fetched_count, rebuilt.is_whole) == (1, True)
    assert (await desk.scrub()).is_clean

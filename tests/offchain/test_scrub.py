"""The scrub and the rebuild: every way in which chain and store can differ is found, and put right where that is proven."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from consensus.records.clips import ClipDownload
from node.custody import custodian as custodian_module
from node.custody.chain_facts import ChainFacts
from node.custody.custodian import Custodian
from node.custody.repair import scrub
from node.custody.repair.scrub import find_unclaimed_keys
from node.custody.stores.custody_store import BlockEffects, ClipRow, RecordFacts
from node.custody.uploads.upload_queue import PendingUpload
from tests.offchain.desk import CustodyHarness, Peer
from tests.offchain.house import ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import BOB, EXPIRES_MS, RecordedClip, erasure, record_clip, recorded
from tests.offchain.small_state import BOTH


@pytest.fixture
def desk(opened: CustodianHarness) -> CustodyHarness:
    return CustodyHarness(opened)


async def test_a_store_that_agrees_with_the_chain_is_clean(desk: CustodyHarness) -> None:
    clips = [record_clip() for _ in range(3)]
    await desk.hold(*clips)
    report = await desk.scrub()
    assert report.is_clean
    assert (report.records_count, report.clips_compared_count, report.frames_compared_count) == (3, 3, 9)


async def test_a_scrub_that_broke_off_goes_on_after_the_last_record_before_which_nothing_was_wrong(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("node.custody.repair.scrub.RECORDS_AT_ONCE_COUNT", 2)
    clips = sorted((record_clip() for _ in range(7)), key=lambda clip: clip.record_id)
    await desk.hold(*clips[:4], *clips[5:])
    desk.record(clips[4])
    told: list[bytes] = []

    def hear(what: str, done: int, total: int, last: bytes = b"") -> None:
        if what == "records":
            told.append(last)

    ids = [clip.record_id for clip in clips]
    assert (await desk.scrub(hear)).missing == [ids[4]]
    assert told == [ids[1], ids[3], ids[3], ids[3], ids[6]], "what is missing is listed, once that is for certain"
    rest = await desk.scrub(after=ids[3])
    assert (rest.after, rest.records_count, rest.clips_compared_count) == (ids[3], 3, 2)
    assert rest.missing == [ids[4]]
    assert (await desk.scrub(after=ids[6])).records_count == 0
    told.clear()
    await _change_a_byte(desk, clips[5])
    assert (await desk.scrub(hear)).corrupted == [(ids[5], 2)]
    assert told[-1] == ids[3], "what is damaged is told at the end only"


async def test_a_scrub_holds_no_version_of_the_ledger_for_long(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As long as one is held, the ledger's file grows; and what was erased since would look wrong."""
    monkeypatch.setattr(scrub, "RECORDS_AT_ONCE_COUNT", 2)
    monkeypatch.setattr(scrub, "FACTS_HELD_MAX_S", 0.0)
    clips = sorted((record_clip() for _ in range(5)), key=lambda clip: clip.record_id)
    await desk.hold(*clips)
    last: list[bytes] = []

    def erase_one(what: str, done: int, total: int, sound: bytes = b"") -> None:
        if done == 2 and not last:
            desk.record(clips[3], status="erased", height=1)
            desk.state.erasure(clips[3], receipts=BOTH, status="complete")
        last.append(sound)

    report = await desk.scrub(erase_one)
    assert (report.records_count, report.held_though_erased) == (5, [clips[3].record_id])


async def test_after_an_erasure_and_an_expiry_nothing_is_left_and_the_scrub_says_so(desk: CustodyHarness) -> None:
    gone, cut, expiring = (record_clip() for _ in range(3))
    await desk.hold(gone, cut, expiring)
    await desk.house.follow(erasure(ERASURE_ID, gone), erasure(b"\xe2" * 32, cut, frames=(1,)), at_ms=EXPIRES_MS - 1)
    desk.record(gone, status="erasing", height=1)
    desk.record(cut, height=2)
    desk.state.erasure(cut, frames=(1,))
    assert (await desk.scrub()).is_clean
    await desk.house.follow(at_ms=EXPIRES_MS)
    report = await desk.scrub()
    assert report.is_clean
    assert report.clips_compared_count == 0
    assert desk.house.keys.held_count == 0


async def test_what_the_store_lost_is_put_among_the_missing_and_a_rebuild_fetches_it(desk: CustodyHarness) -> None:
    held, lost = record_clip(), record_clip()
    await desk.hold(held)
    desk.record(lost)
    report = await desk.scrub()
    assert report.missing == [lost.record_id]
    assert report.nothing_erased_is_left
    assert not report.is_clean
    assert [facts.record_id for facts in await desk.house.custodian.missing(10)] == [lost.record_id]
    rebuilt = await desk.rebuild(Peer(lost))
    assert rebuilt.is_whole
    assert rebuilt.fetched_count == 1
    assert await desk.opens(lost)
    assert (await desk.scrub()).is_clean


async def test_what_should_not_be_there_is_reported_by_the_scrub_and_erased_by_the_rebuild(
    desk: CustodyHarness,
) -> None:
    erased, unknown, foreign = record_clip(), record_clip(), record_clip()
    await desk.hold(erased, foreign)
    await desk.house.keep(unknown)
    desk.record(erased, status="erased", height=1)
    desk.record(foreign, owner=BOB, height=2)
    desk.state.erasure(erased, receipts=BOTH, status="complete")
    report = await desk.scrub()
    assert report.held_though_erased == [erased.record_id]
    assert report.unknown_to_chain == [unknown.record_id]
    assert report.other_facts == [foreign.record_id]
    assert not report.nothing_erased_is_left
    assert len(await desk.house.store.clips([erased.record_id, unknown.record_id, foreign.record_id])) == 3
    rebuilt = await desk.rebuild()
    assert (rebuilt.erased_again, rebuilt.corrected) == ([erased.record_id], [foreign.record_id])
    assert rebuilt.unknown_to_chain == [unknown.record_id]
    assert not rebuilt.is_whole
    await refused("CLIP_ERASED", desk.house.custodian.export(erased.record_id))
    clips = await desk.house.store.clips([foreign.record_id])
    assert clips[foreign.record_id].owner == BOB
    assert await desk.house.custodian.ready_outbox(10) == []


async def test_a_record_that_expired_on_chain_alone_is_erased_again(desk: CustodyHarness) -> None:
    """No request names it, and the store's own expiry is wrong: only the state tells."""
    clip = record_clip()
    await desk.house.custodian.stage(clip.upload)
    await desk.house.follow(recorded(clip, expires_at_ms=EXPIRES_MS + 10**9))
    desk.record(clip, status="expired")
    assert (await desk.scrub()).held_though_erased == [clip.record_id]
    assert (await desk.rebuild()).erased_again == [clip.record_id]
    assert (await desk.scrub()).is_clean
    assert desk.house.keys.held_count == 0


@pytest.mark.parametrize("status", ["active", "expired"])
async def test_what_is_held_beyond_its_time_is_erased_and_reported_as_expired(
    desk: CustodyHarness, status: str
) -> None:
    """The chain waits for a report from each custodian, whichever way the clip went."""
    clip, erasing = record_clip(), record_clip()
    for one in (clip, erasing):
        await desk.house.custodian.stage(one.upload)
        await desk.house.follow(recorded(one, expires_at_ms=EXPIRES_MS + 10**9))
    desk.record(clip, status=status)
    desk.record(erasing, status="erasing")
    await desk.house.follow(at_ms=EXPIRES_MS + 1)
    rebuilt = await desk.rebuild()
    assert sorted(rebuilt.erased_again) == sorted([clip.record_id, erasing.record_id])
    (owed,) = [arguments for kind, arguments in await desk.house.ready_outbox() if kind == "erasure.expired"]
    assert owed[0] == [clip.record_id]
    assert await desk.house.store.frame_places([clip.record_id]) == []
    await desk.rebuild()
    assert len(await desk.house.ready_outbox()) == 1


async def _change_a_byte(desk: CustodyHarness, clip: RecordedClip) -> None:
    store = desk.house.store
    row, frames = (await store.clips([clip.record_id]))[clip.record_id], await store.frames(clip.record_id)
    changed = frames[2].ciphertext[:-1] + bytes((frames[2].ciphertext[-1] ^ 1,))
    await store.stage(row, [*frames[:2], replace(frames[2], ciphertext=changed)])


async def test_a_changed_byte_is_found_in_its_frame_and_mended_from_a_sound_copy(desk: CustodyHarness) -> None:
    clip = record_clip()
    await desk.hold(clip)
    store = desk.house.store
    await _change_a_byte(desk, clip)
    report = await desk.scrub()
    assert report.corrupted == [(clip.record_id, 2)]
    alone = await desk.rebuild()
    assert (alone.still_damaged, alone.is_whole) == ([clip.record_id], False)
    assert len(await store.frames(clip.record_id)) == 3
    lacking = await desk.rebuild(Peer(clip, erased=(0,)))
    assert lacking.still_damaged == [clip.record_id]
    assert (await desk.rebuild(Peer(clip))).mended == [clip.record_id]
    assert await desk.opens(clip)
    assert desk.house.keys.held_count == 3
    assert (await desk.scrub()).is_clean


async def test_frames_that_are_gone_though_nobody_erased_them_come_back_and_erased_ones_do_not(
    desk: CustodyHarness,
) -> None:
    clip = record_clip()
    await desk.hold(clip)
    await desk.house.follow(erasure(ERASURE_ID, clip, frames=(0,)))
    desk.state.erasure(clip, frames=(0,))
    await desk.house.store.erase_frames(clip.record_id, [2])
    report = await desk.scrub()
    assert report.corrupted == [(clip.record_id, 2)]
    assert len(report.unclaimed_keys) == 1
    rebuilt = await desk.rebuild(Peer(clip))
    assert (rebuilt.mended, rebuilt.keys_destroyed_count) == ([clip.record_id], 1)
    download = await desk.house.custodian.export(clip.record_id)
    assert read_all(clip, download) == [None, *clip.plaintexts[1:]]
    assert (await desk.scrub()).is_clean


async def test_a_frame_that_is_back_though_it_was_erased_is_found_and_goes(desk: CustodyHarness) -> None:
    clip = record_clip()
    await desk.hold(clip)
    store, keys = desk.house.store, desk.house.keys
    row, frames = (await store.clips([clip.record_id]))[clip.record_id], await store.frames(clip.record_id)
    desk.state.erasure(clip, frames=(1,), receipts=BOTH, status="complete")
    report = await desk.scrub()
    assert report.frames_held_though_erased == [(clip.record_id, 1)]
    assert not report.nothing_erased_is_left
    await desk.rebuild()
    assert [frame.index for frame in await store.frames(clip.record_id)] == [0, 2]
    assert keys.held_count == 2
    await store.stage(row, frames)
    assert (await desk.scrub()).is_clean, "the row is back from a backup, but nothing opens it any more"


async def test_frames_without_a_clip_and_keys_without_a_frame_are_found_and_go(desk: CustodyHarness) -> None:
    clip, orphan = record_clip(), record_clip()
    await desk.hold(clip)
    store, keys = desk.house.store, desk.house.keys
    await desk.house.custodian.stage(orphan.upload)
    frames = await store.frames(orphan.record_id)
    await store.erase_clips([orphan.record_id])
    await store.stage(ClipRow(orphan.record_id, b"", 0, "erased", (), ()), frames)
    ((lone, _),) = keys.allocate(1)
    report = await desk.scrub()
    assert report.unclaimed_frames == [orphan.record_id]
    assert report.unclaimed_keys == [lone]
    rebuilt = await desk.rebuild()
    assert rebuilt.erased_again == [orphan.record_id]
    assert rebuilt.keys_destroyed_count == 1
    assert keys.held_count == 3
    assert (await desk.scrub()).is_clean


async def test_an_index_that_is_lost_whole_is_made_again_from_the_state(desk: CustodyHarness) -> None:
    clips = [record_clip() for _ in range(3)]
    await desk.hold(*clips)
    for clip in clips:
        await desk.house.store.stage(ClipRow(clip.record_id, b"", 0, "staged", (), ()), [])
        await desk.house.store.drop_staged([clip.record_id])
    assert (await desk.scrub()).missing == sorted(clip.record_id for clip in clips)
    rebuilt = await desk.rebuild(Peer(*clips))
    assert rebuilt.is_whole
    for clip in clips:
        assert await desk.opens(clip)
    assert desk.house.keys.held_count == 9


async def test_a_mark_of_erasure_that_the_chain_does_not_know_gives_way_to_the_clip(desk: CustodyHarness) -> None:
    clip = record_clip()
    await desk.hold(clip)
    await desk.house.custodian.eraser.erase_again([clip.record_id])
    assert (await desk.scrub()).missing == [clip.record_id]
    rebuilt = await desk.rebuild(Peer(clip))
    assert rebuilt.forgotten == [clip.record_id]
    assert rebuilt.is_whole
    assert await desk.opens(clip)


async def test_what_nobody_has_stays_missing_and_the_rebuild_ends_and_says_so(desk: CustodyHarness) -> None:
    lost = record_clip()
    await desk.hold(record_clip())
    desk.record(lost)
    rebuilt = await desk.rebuild(Peer())
    assert (rebuilt.still_missing_count, rebuilt.is_whole) == (1, False)


async def test_a_custodian_that_is_behind_its_ledger_says_nothing_yet(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    await desk.hold(record_clip())
    desk.house.chain.height += 1
    monkeypatch.setattr("node.custody.repair.scrub.caught_up.__wrapped__.__defaults__", (0.0,))
    await refused("CUSTODY_CATCHING_UP", desk.scrub())


async def test_of_a_store_in_which_nothing_looks_wrong_little_is_read_at_rest(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Uploads and blocks wait for that: it may not grow with what is kept."""
    await desk.hold(*(record_clip() for _ in range(3)))
    house, walked = desk.house, dict[str, set[bool]]()

    def watch(owner: Any, name: str) -> None:
        walk = getattr(owner, name)

        def watched(*arguments: Any) -> Any:
            walked.setdefault(name, set()).add(house.custodian._writing.locked())
            return walk(*arguments)

        monkeypatch.setattr(owner, name, watched)

    for name in ("all_clips", "records_with_frames", "slots_in_use", "all_parts"):
        watch(house.store, name)
    watch(house.keys, "check_destroyed")
    watch(house.keys, "find_unclaimed")
    watch(ChainFacts, "shares")
    assert (await desk.scrub()).is_clean
    assert len(walked) == 7
    assert set().union(*walked.values()) == {False}


async def test_uploads_go_on_between_the_suspects_of_a_scrub(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A custodian that lost much has as many: they are judged some at a time."""
    monkeypatch.setattr(scrub, "RECORDS_AT_ONCE_COUNT", 2)
    lost, coming, judged = [record_clip() for _ in range(5)], record_clip(), list[bytes]()
    await desk.hold(record_clip())
    for clip in lost:
        desk.record(clip)
    custodian, compare, at_rest = desk.house.custodian, scrub.RecordComparer.compare, custodian_module.Custodian.at_rest
    rests = list[int]()

    async def noting(self: Any, record_id: bytes, *arguments: Any) -> bool:
        if custodian._writing.locked():
            judged.append(record_id)
        return await compare(self, record_id, *arguments)

    @asynccontextmanager
    async def resting(self: Custodian) -> AsyncIterator[frozenset[int]]:
        if len(judged) == 2:
            await self.stage(coming.upload)
        async with at_rest(self) as in_flight:
            yield in_flight
        rests.append(len(judged))

    monkeypatch.setattr(scrub.RecordComparer, "compare", noting)
    monkeypatch.setattr(custodian_module.Custodian, "at_rest", resting)
    report = await desk.scrub()
    assert report.missing == judged == sorted(clip.record_id for clip in lost)
    assert rests == [2, 4, 5, 5], "two at a time, and the end"
    assert (report.nothing_erased_is_left, report.unclaimed_keys) == (True, []), (
        "the upload meanwhile is nobody's fault"
    )
    assert len(await custodian.missing(10)) == 5


async def test_a_key_that_comes_during_a_walk_is_taken_for_unclaimed_neither_then_nor_at_rest(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its row may be where the walk has been: only what no walk finds is looked for at rest."""
    await desk.hold(record_clip())
    store, custodian, walks = desk.house.store, desk.house.custodian, list[bool]()
    walk = store.slots_in_use

    async def behind_the_walk() -> AsyncIterator[int]:
        walks.append(custodian._writing.locked())
        async for slot in walk():
            yield slot
        if len(walks) == 1:
            await custodian.stage(record_clip().upload)

    monkeypatch.setattr(store, "slots_in_use", behind_the_walk)
    assert (await desk.scrub()).unclaimed_keys == []
    assert walks == [False, False], "the second walk found the upload's rows"
    ((lone, _),) = desk.house.keys.allocate(1)
    walks[:] = [False]
    assert (await desk.scrub()).unclaimed_keys == [lone]
    assert walks[1:] == [False] * scrub.KEY_WALKS_MAX_COUNT + [True]


async def test_an_upload_on_its_way_is_no_orphan(desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its keys are there before its rows; the scrub must not take them for keys that nobody needs."""
    await desk.hold(record_clip())
    coming, reports = record_clip(), []
    custodian, store = desk.house.custodian, desk.house.store
    original = custodian._let_in

    async def scrubbed_meanwhile(uploads: Sequence[PendingUpload]) -> dict[PendingUpload, RecordFacts | None]:
        custodian._writing.release()
        reports.append(await desk.scrub())
        await custodian._writing.acquire()
        return await original(uploads)

    monkeypatch.setattr(custodian, "_let_in", scrubbed_meanwhile)
    await custodian.stage(coming.upload)
    assert [report.is_clean for report in reports] == [True]
    assert len(await store.frames(coming.record_id)) == 3


async def test_a_rebuild_that_a_failing_store_cut_off_is_done_again(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, gone = record_clip(), record_clip()
    await desk.hold(kept, gone)
    desk.record(gone, status="erased", height=2)
    original = desk.house.store.erase_clips

    async def fail(_: object) -> None:
        raise BlockRobotError("STORE_UNAVAILABLE")

    monkeypatch.setattr(desk.house.store, "erase_clips", fail)
    await refused("STORE_UNAVAILABLE", desk.rebuild())
    monkeypatch.setattr(desk.house.store, "erase_clips", original)
    assert (await desk.rebuild()).is_whole
    assert (await desk.scrub()).is_clean
    assert await desk.opens(kept)


async def test_the_checkpoint_of_a_rebuilt_store_is_the_states(desk: CustodyHarness) -> None:
    await desk.hold(record_clip())
    before = await desk.house.custodian.checkpoint()
    await desk.rebuild()
    after = await desk.house.custodian.checkpoint()
    assert before is not None
    assert after is not None
    assert after.height == before.height
    await desk.house.store.apply(BlockEffects())
    fresh = await desk.house.keep()
    assert await desk.opens(fresh)


async def test_a_clip_that_is_erased_while_the_scrub_looks_at_it_ends_no_scrub(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = [record_clip() for _ in range(3)]
    await desk.hold(*clips)
    custodian, erased = desk.house.custodian, False
    look_at = custodian.look_at

    async def erased_meanwhile(record_id: bytes) -> ClipDownload:
        nonlocal erased
        if not erased:
            erased = True
            [gone] = [clip for clip in clips if clip.record_id == record_id]
            await desk.house.follow(erasure(ERASURE_ID, gone))
            desk.record(gone, status="erasing", height=clips.index(gone) + 1)
            desk.state.erasure(gone)
        return await look_at(record_id)

    monkeypatch.setattr(custodian, "look_at", erased_meanwhile)
    assert (await desk.scrub()).is_clean
    assert erased


async def test_blocks_are_followed_while_a_rebuild_reads_what_is_held(
    desk: CustodyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading every clip takes long in a large store; what is erased meanwhile is erased, and is not called damaged."""
    clips = [record_clip() for _ in range(3)]
    await desk.hold(*clips)
    custodian, told = desk.house.custodian, []
    look_at = custodian.look_at

    async def erased_meanwhile(record_id: bytes) -> ClipDownload:
        if not told:
            whole, framed = [clip for clip in clips if clip.record_id == record_id] + [
                clip for clip in clips if clip.record_id != record_id
            ][:1]
            told.append(record_id)
            await desk.house.follow(erasure(ERASURE_ID, whole), erasure(b"\xe2" * 32, framed, frames=(0,)))
            desk.record(whole, status="erasing", height=clips.index(whole) + 1)
            desk.record(framed, erased_frames=[0], height=clips.index(framed) + 1)
            desk.state.erasure(whole)
        return await look_at(record_id)

    monkeypatch.setattr(custodian, "look_at", erased_meanwhile)
    report = await desk.rebuild(Peer(*clips))
    assert told
    assert (report.mended, report.still_damaged, report.is_whole) == ([], [], True)
    monkeypatch.undo()
    assert (await desk.scrub()).is_clean


async def test_an_empty_frame_that_a_store_kept_though_it_was_withdrawn_is_found_and_a_rebuild_deletes_it(
    desk: CustodyHarness,
) -> None:
    await desk.hold(record_clip())
    for digest in (b"\x01" * 32, b"\x02" * 32):
        await desk.house.store.put_background(digest, b"picture")
    desk.state.rows[b"records\x00empty-frame/" + b"\x01" * 32] = 1
    report = await desk.scrub()
    assert report.empty_frames_held_though_withdrawn == [b"\x02" * 32]
    assert not report.nothing_erased_is_left
    await desk.rebuild()
    assert await desk.house.store.background_digests() == [b"\x01" * 32]
    assert (await desk.scrub()).is_clean


async def test_an_upload_that_begins_at_rest_makes_no_keys_before_its_end(opened: CustodianHarness) -> None:
    """A rebuild would destroy them as nobody's, and their slots would be given to others too."""
    clip = record_clip()
    async with opened.custodian.at_rest() as in_flight:
        upload = asyncio.create_task(opened.custodian.stage(clip.upload))
        for _ in range(50):
            await asyncio.to_thread(bool)
        unclaimed = await find_unclaimed_keys(opened.store, opened.keys, in_flight)
    await upload
    assert unclaimed == []
    await opened.follow(recorded(clip))
    exported = await opened.custodian.export(clip.record_id)
    assert read_all(clip, exported) == list(clip.plaintexts)


async def test_a_start_tells_how_many_slots_it_has_read(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(3):
        await opened.keep()
    monkeypatch.setattr(custodian_module, "_TELL_SLOTS_COUNT", 4)
    told: list[int] = []
    await opened.custodian.start(told.append)
    assert told == [4, 8]
    assert opened.keys.held_count == 9

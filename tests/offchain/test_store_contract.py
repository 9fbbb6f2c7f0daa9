"""What every custody store promises, over SQLite and over MongoDB: one suite, so that neither can offer more."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

import pytest

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES
from consensus.primitives.hashing import sha256
from network.sim.world.custody_store import MemoryEraseKeys
from node.custody.custodian import Custodian
from node.custody.stores.custody_store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    CustodyStore,
    FramePlace,
    FrameRow,
    Grant,
    OutboxRow,
    RecordFacts,
)
from node.custody.stores.mongo_documents import STAGING
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME, SqliteStore

OWNER, STRANGER = b"\x02" * 33, b"\x03" * 33
TXID, NEWER_TXID = b"\x11" * 32, b"\x12" * 32


def record_id(number: int) -> bytes:
    return number.to_bytes(16, "big")


def clip(number: int, valid_until_ms: int = 1000, frames: int = 2) -> ClipRow:
    leaves = tuple(sha256(bytes((number % 256, index))) for index in range(frames))
    return ClipRow(record_id(number), TXID, valid_until_ms, "staged", leaves, leaves[::-1])


def frames_of(row: ClipRow, first_slot: int = 0) -> list[FrameRow]:
    return [
        FrameRow(row.record_id, index, b"ciphertext %d" % index, b"wrapped %d" % index, first_slot + index)
        for index in range(len(row.ciphertext_leaves))
    ]


def facts(number: int, owner: bytes = OWNER, expires_at_ms: int = 9000, height: int = 5) -> RecordFacts:
    return RecordFacts(record_id(number), NEWER_TXID, owner, b"\x21" * 32, b"\x22" * 32, expires_at_ms, height)


def row(part: int, height: int = 5, status: str = "ready", kind: str = "access.released") -> OutboxRow:
    plan = b"plan" if status == "erasing" else b""
    return OutboxRow(kind, b"\x31" * 32, part, "access", "released", b"\x90", height, status, plan)


async def stage(store: CustodyStore, number: int, **changes: int) -> ClipRow:
    staged = clip(number, **changes)
    await store.stage(staged, frames_of(staged, number * 100))
    return staged


async def test_a_new_store_is_empty(store: CustodyStore) -> None:
    assert await store.checkpoint() is None
    assert await store.clips([record_id(1)]) == {}
    assert await store.frames(record_id(1)) == []
    assert await store.grant(TXID) is None
    assert await store.background(TXID) is None
    assert await store.missing(10) == []
    assert [found async for found in store.all_clips()] == []


async def test_a_staged_clip_comes_back_as_it_was(store: CustodyStore) -> None:
    staged = await stage(store, 1)
    assert await store.clips([record_id(1), record_id(2)]) == {record_id(1): staged}
    assert await store.frames(record_id(1)) == frames_of(staged, 100)
    places = [FramePlace(record_id(1), 0, 100), FramePlace(record_id(1), 1, 101)]
    assert await store.frame_places([record_id(1), record_id(2)]) == places


async def test_staging_again_replaces_all_frames(store: CustodyStore) -> None:
    await stage(store, 1, frames=3)
    again = clip(1, frames=2)
    await store.stage(again, frames_of(again, 500))
    assert await store.frames(record_id(1)) == frames_of(again, 500)


async def test_the_largest_clip_fits(store: CustodyStore) -> None:
    large = clip(1, frames=16)
    rows = [replace(row, ciphertext=bytes((row.index,)) * CIPHERTEXT_MAX_BYTES) for row in frames_of(large)]
    await store.stage(large, rows)
    assert await store.frames(record_id(1)) == rows


async def test_a_confirmed_clip_knows_its_owner_from_the_chain(store: CustodyStore) -> None:
    staged = await stage(store, 1)
    await store.apply(BlockEffects(confirmed=(facts(1),)))
    expected = replace(staged, status="confirmed", txid=NEWER_TXID, owner=OWNER, expires_at_ms=9000, height=5)
    assert (await store.clips([record_id(1)]))[record_id(1)] == expected
    assert await store.clips_of_owner(OWNER) == [expected]
    assert await store.clips_of_owner(STRANGER) == []


async def test_what_the_chain_says_of_a_confirmed_clip_alone_is_corrected(store: CustodyStore) -> None:
    staged, confirmed, erased = [await stage(store, number) for number in (1, 2, 3)]
    await store.apply(BlockEffects(confirmed=(facts(2, owner=STRANGER), facts(3))))
    await store.erase_clips([erased.record_id])
    for number in (1, 2, 3):
        await store.correct(facts(number, expires_at_ms=7000, height=4))
    found = await store.clips([record_id(number) for number in (1, 2, 3)])
    assert (found[record_id(1)], found[record_id(3)].status) == (staged, "erased")
    right = replace(confirmed, status="confirmed", txid=NEWER_TXID, owner=OWNER, expires_at_ms=7000, height=4)
    assert found[record_id(2)] == right
    assert await store.frames(record_id(2)) == frames_of(confirmed, 200)


async def test_frames_are_replaced_and_the_clip_stays_as_it_is(store: CustodyStore) -> None:
    held, other = await stage(store, 1, frames=3), await stage(store, 2)
    await store.apply(BlockEffects(confirmed=(facts(1),)))
    before = await store.clips([record_id(1)])
    fresh = frames_of(held, 700)[::2]
    await store.replace_frames(record_id(1), fresh)
    assert await store.frames(record_id(1)) == fresh
    assert await store.clips([record_id(1)]) == before
    assert await store.frames(record_id(2)) == frames_of(other, 200)


async def test_numbers_come_back_as_plain_integers(store: CustodyStore) -> None:
    """What the store returns goes into transactions, which take integers and nothing like them."""
    large = 1_800_000_000_000
    await stage(store, 1, valid_until_ms=large)
    await store.apply(
        BlockEffects(confirmed=(facts(1, expires_at_ms=large),), checkpoint=Checkpoint(5, TXID, large - 1))
    )
    [found] = await store.clips_of_owner(OWNER)
    assert [type(number) for number in (found.valid_until_ms, found.expires_at_ms, found.height)] == [int] * 3
    assert type((await store.checkpoint()).timestamp_ms) is int


async def test_confirming_a_clip_that_is_not_there_makes_none(store: CustodyStore) -> None:
    await store.apply(BlockEffects(confirmed=(facts(1),)))
    assert await store.clips([record_id(1)]) == {}


async def test_confirming_ends_that_a_clip_is_missing(store: CustodyStore) -> None:
    await store.apply(BlockEffects(missing=(facts(1), facts(2, height=7))))
    assert await store.missing(10) == [facts(2, height=7), facts(1)]
    assert await store.missing(1) == [facts(2, height=7)]
    await stage(store, 1)
    await store.apply(BlockEffects(confirmed=(facts(1),)))
    assert await store.missing_clips([record_id(1)]) == {}
    assert await store.missing(10) == [facts(2, height=7)]
    await store.apply(BlockEffects(found=(record_id(2),)))
    assert await store.missing(10) == []
    assert await store.clips([record_id(2)]) == {}


async def test_frames_erased_before_they_arrived_are_remembered(store: CustodyStore) -> None:
    known = replace(facts(1), erased_frames=(0, 7, 63))
    await store.apply(BlockEffects(missing=(known,)))
    assert await store.missing_clips([record_id(1), record_id(2)]) == {record_id(1): known}


async def test_an_erased_frame_is_gone_and_the_others_stay(store: CustodyStore) -> None:
    staged = await stage(store, 1, frames=3)
    for _ in range(2):
        await store.erase_frames(record_id(1), [0, 2])
    assert await store.frames(record_id(1)) == [frames_of(staged, 100)[1]]


async def test_an_erased_clip_leaves_a_mark_that_says_nothing(store: CustodyStore) -> None:
    await stage(store, 1)
    await store.apply(BlockEffects(confirmed=(facts(1),), missing=(facts(1),)))
    for _ in range(2):
        await store.erase_clips([record_id(1)])
    assert await store.clips([record_id(1)]) == {record_id(1): ClipRow(record_id(1), b"", 0, "erased", (), ())}
    assert await store.frame_places([record_id(1)]) == []
    assert await store.missing(10) == []
    assert await store.clips_of_owner(OWNER) == []


async def test_many_clips_are_erased_at_once_and_others_stay(store: CustodyStore) -> None:
    for number in (1, 2, 3):
        await stage(store, number)
    for _ in range(2):
        await store.erase_clips([record_id(number) for number in (1, 2, 4)])
    await store.erase_clips([])
    found = await store.clips([record_id(number) for number in (1, 2, 3, 4)])
    assert {known: clip.status for known, clip in found.items()} == {
        record_id(number): "staged" if number == 3 else "erased" for number in (1, 2, 3, 4)
    }
    assert {place.record_id for place in await store.frame_places(list(found))} == {record_id(3)}


async def test_what_frames_have_in_place_of_ciphertexts_is_read_by_its_length(store: CustodyStore) -> None:
    index = getattr(store, "_index", store)
    texts = (b"r" * 16, b"s" * 16, b"s" * 16, b"t" * 17)
    for number in (1, 2):
        rows = [FrameRow(record_id(number), at, text, b"wrapped", 9 * number + at) for at, text in enumerate(texts)]
        await index.stage(clip(number, frames=4), rows[: 4 // number])
    found = await index.references([record_id(number) for number in (1, 2, 3)], 16)
    assert found == {record_id(1): {b"r" * 16, b"s" * 16}, record_id(2): {b"r" * 16, b"s" * 16}}
    assert await index.references([], 16) == {}


async def test_an_erased_clip_is_never_confirmed_again(store: CustodyStore) -> None:
    await store.erase_clips([record_id(1)])
    await store.apply(BlockEffects(confirmed=(facts(1),)))
    assert (await store.clips([record_id(1)]))[record_id(1)].status == "erased"


async def test_only_staged_clips_can_be_dropped(store: CustodyStore) -> None:
    await stage(store, 1)
    await stage(store, 2)
    await store.apply(BlockEffects(confirmed=(facts(2),)))
    await store.drop_staged([record_id(number) for number in (1, 2, 3)])
    assert list(await store.clips([record_id(1), record_id(2)])) == [record_id(2)]
    assert {place.record_id for place in await store.frame_places([record_id(1), record_id(2)])} == {record_id(2)}


async def test_a_staged_clip_lapses_exactly_at_its_expiry(store: CustodyStore) -> None:
    await stage(store, 1, valid_until_ms=1000)
    await stage(store, 2, valid_until_ms=999)
    await stage(store, 3, valid_until_ms=1001)
    assert await store.lapsed(1000, 10) == [record_id(2), record_id(1)]
    assert await store.lapsed(1000, 1) == [record_id(2)]
    assert await store.lapsed(998, 10) == []


async def test_only_a_staged_clip_is_extended(store: CustodyStore) -> None:
    await stage(store, 1)
    await stage(store, 2)
    await store.apply(BlockEffects(confirmed=(facts(2),)))
    for number in (1, 2, 3):
        await store.extend_staged(record_id(number), b"\x19" * 32, 5000)
    found = await store.clips([record_id(1), record_id(2), record_id(3)])
    assert found[record_id(1)] == replace(clip(1), txid=b"\x19" * 32, valid_until_ms=5000)
    assert (found[record_id(2)].txid, found[record_id(2)].valid_until_ms) == (NEWER_TXID, 1000)
    assert record_id(3) not in found


async def test_a_confirmed_clip_expires_exactly_at_its_time(store: CustodyStore) -> None:
    for number, expires_at_ms in ((1, 9000), (2, 8999), (3, 9001)):
        await stage(store, number)
        await store.apply(BlockEffects(confirmed=(facts(number, expires_at_ms=expires_at_ms),)))
    await stage(store, 4, valid_until_ms=1)
    assert await store.expired(9000, 10) == [record_id(2), record_id(1)]
    assert await store.expired(9000, 1) == [record_id(2)]
    assert await store.expired(8998, 10) == []


async def test_a_checkpoint_gives_up_missing_clips_that_have_expired(store: CustodyStore) -> None:
    await store.apply(BlockEffects(missing=(facts(1, expires_at_ms=9000), facts(2, expires_at_ms=9001))))
    await store.apply(BlockEffects(checkpoint=Checkpoint(6, TXID, 9000)))
    assert [found.record_id for found in await store.missing(10)] == [record_id(2)]


async def test_grants_come_back_by_id_and_by_owner(store: CustodyStore) -> None:
    named = Grant(TXID, OWNER, (record_id(1), record_id(2)), 4)
    whole = Grant(NEWER_TXID, OWNER, (), 5)
    await store.apply(BlockEffects(grants=(named, whole)))
    await store.apply(BlockEffects(grants=(named,)))
    assert await store.grant(TXID) == named
    assert await store.grant(NEWER_TXID) == whole
    assert await store.grants_of_owners([OWNER, STRANGER]) == [named, whole]
    assert await store.grants_of_owners([STRANGER]) == await store.grants_of_owners([]) == []


async def test_the_outbox_keeps_what_came_first(store: CustodyStore) -> None:
    first = row(0, status="erasing")
    await store.add_outbox(first)
    await store.add_outbox(replace(first, arguments=b"\x91\x01", status="ready", plan=b""))
    await store.apply(BlockEffects(outbox=(replace(first, height=9), row(1, height=3))))
    assert await store.outbox("erasing", "access", 10) == [first]
    assert await store.outbox("ready", "access", 10) == [row(1, height=3)]
    assert await store.outbox_of("access.released", b"\x31" * 32) == [first, row(1, height=3)]


async def test_an_outbox_row_gets_ready_without_its_plan_and_is_settled_once(store: CustodyStore) -> None:
    planned = row(0, status="erasing")
    await store.add_outbox(planned)
    for _ in range(2):
        await store.mark_outbox_ready(planned.key)
    assert await store.outbox("ready", "access", 10) == [replace(planned, status="ready", plan=b"")]
    for _ in range(2):
        await store.apply(BlockEffects(settled=(planned.key,)))
    await store.remove_outbox(planned.key)
    assert await store.outbox_of(planned.kind, planned.subject) == []


async def test_the_outbox_comes_in_the_order_of_heights(store: CustodyStore) -> None:
    for part, height in ((0, 12), (1, 3), (2, 7)):
        await store.add_outbox(row(part, height))
    assert [found.height for found in await store.outbox("ready", "access", 10)] == [3, 7, 12]
    assert [found.height for found in await store.outbox("ready", "access", 2)] == [3, 7]


async def test_receipts_of_erasures_wait_behind_no_words_on_requests(
    store: CustodyStore,
) -> None:
    custodian = Custodian(store, MemoryEraseKeys(random.Random(1)), member=bytes(33), clock_ms=lambda: 0)
    words = [row(part, part) for part in range(12)]
    receipts = [
        replace(row(part, 100 + part), kind="erasure.receipt", contract="erasure", entry="receipt")
        for part in range(12)
    ]
    for each in words:
        await store.add_outbox(each)
    assert await custodian.ready_outbox(8) == words[:8]
    for each in receipts[:3]:
        await store.add_outbox(each)
    assert await custodian.ready_outbox(8) == receipts[:3] + words[:5]
    for each in receipts[3:]:
        await store.add_outbox(each)
    assert await custodian.ready_outbox(8) == receipts[:6] + words[:2]
    for each in words[1:]:
        await store.remove_outbox(each.key)
    assert await custodian.ready_outbox(8) == receipts[:7] + words[:1]


async def test_backgrounds_are_kept_by_hash(store: CustodyStore) -> None:
    content = bytes(range(256)) * 400
    for _ in range(2):
        await store.put_background(sha256(content), content)
    assert await store.background(sha256(content)) == content
    await store.put_background(bytes(32), b"other")
    assert await store.background_digests() == sorted([bytes(32), sha256(content)])
    await store.delete_backgrounds([sha256(content), b"\x01" * 32])
    assert await store.background_digests() == [bytes(32)]
    assert await store.background(sha256(content)) is None


async def test_walks_over_all_clips_and_slots_see_each_once(store: CustodyStore) -> None:
    for number in (3, 1, 2):
        await stage(store, number)
    await store.erase_clips([record_id(2)])
    found = [(row.record_id, row.status) async for row in store.all_clips()]
    assert found == [(record_id(1), "staged"), (record_id(2), "erased"), (record_id(3), "staged")]
    assert sorted([slot async for slot in store.slots_in_use()]) == [100, 101, 300, 301]


async def test_what_was_written_is_there_after_reopening(make_store: Callable[[], CustodyStore]) -> None:
    async with make_store() as store:
        staged = await stage(store, 1)
        effects = BlockEffects(confirmed=(facts(1),), outbox=(row(0),), checkpoint=Checkpoint(5, TXID, 1234))
        await store.apply(effects)
        await store.sweep()
    async with make_store() as store:
        assert await store.checkpoint() == Checkpoint(5, TXID, 1234)
        assert await store.clips_of_owner(OWNER) != []
        assert await store.frames(record_id(1)) == frames_of(staged, 100)
        assert await store.outbox("ready", "access", 10) == [row(0)]


async def test_the_same_effects_twice_leave_what_once_left(store: CustodyStore) -> None:
    await stage(store, 1)
    effects = BlockEffects(
        outbox=(row(0),),
        confirmed=(facts(1),),
        missing=(facts(2),),
        grants=(Grant(TXID, OWNER, (), 5),),
        settled=(row(1).key,),
        checkpoint=Checkpoint(5, TXID, 1234),
    )
    await store.apply(effects)
    once = (await store.clips([record_id(1)]), await store.missing(10), await store.outbox("ready", "access", 10))
    await store.apply(effects)
    assert (
        await store.clips([record_id(1)]),
        await store.missing(10),
        await store.outbox("ready", "access", 10),
    ) == once


async def test_a_closed_store_says_that_it_is_unavailable(make_store: Callable[[], CustodyStore]) -> None:
    store = make_store()
    async with store:
        await stage(store, 1)
    with pytest.raises(BlockRobotError) as refusal:
        await store.checkpoint()
    assert refusal.value.code == "STORE_UNAVAILABLE"
    assert refusal.value.entry.retryable


async def test_a_server_that_does_not_answer_is_unavailable(
    monkeypatch: pytest.MonkeyPatch, driver_sockets: None
) -> None:
    monkeypatch.setattr("node.custody.stores.mongo_store.SERVER_SELECTION_MAX_MS", 200)
    with pytest.raises(BlockRobotError) as refusal:
        async with MongoStore("mongodb://reader:hidden-word@127.0.0.1:1/x"):
            pass
    assert refusal.value.code == "STORE_UNAVAILABLE"
    assert "hidden-word" not in str(refusal.value)


async def test_a_database_file_that_is_none_is_unavailable(tmp_path) -> None:
    (tmp_path / DATABASE_FILE_NAME).write_bytes(b"this is no database at all" * 100)
    with pytest.raises(BlockRobotError, match=r"^STORE_UNAVAILABLE:"):
        async with SqliteStore(tmp_path):
            pass


async def test_an_upload_cut_off_between_frames_and_clip_is_not_seen_but_purged(mongo_database: str) -> None:
    """MongoDB writes a clip in steps; a crash leaves it `staging`, which no reader sees and the purge finds."""
    async with MongoStore(mongo_database) as store:
        await stage(store, 1, valid_until_ms=1000)
        await store._collection("clips").update_one({"_id": record_id(1)}, {"$set": {"status": STAGING}})
        assert await store.clips([record_id(1)]) == {}
        assert [found async for found in store.all_clips()] == []
        assert await store.lapsed(1000, 10) == [record_id(1)]
        await store.drop_staged([record_id(1)])
        assert await store.frame_places([record_id(1)]) == []
        assert await store.lapsed(1000, 10) == []


async def test_a_store_says_how_much_it_holds_and_of_what_there_are_frames(store: CustodyStore) -> None:
    for number in (1, 2, 3):
        await stage(store, number)
    await store.apply(BlockEffects(confirmed=(facts(1), facts(2)), missing=(facts(7),), outbox=(row(0), row(1))))
    await store.add_outbox(row(2, status="erasing"))
    await store.erase_clips([record_id(2)])
    await store.erase_frames(record_id(1), [0])
    counts = await store.counts()
    assert (counts.staged, counts.confirmed, counts.erased) == (1, 1, 1)
    assert (counts.frames, counts.missing, counts.outbox_ready, counts.outbox_erasing) == (3, 1, 2, 1)
    assert counts.size_bytes is None or counts.size_bytes > 0
    assert [found async for found in store.records_with_frames()] == [record_id(1), record_id(3)]
    left = await store.leftovers()
    assert (left.log_bytes or 0, left.dirty_bytes or 0) == (0, 0)

"""A custodian's life, over both stores: uploads, blocks, releases and erasures."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

import msgspec
import pytest

from consensus.records.clips import check_clip_download
from node.custody.shares import CLOCK_SLACK_MS
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import (
    ALICE,
    BOB,
    CUSTODIAN,
    EXPIRES_MS,
    OTHER_CUSTODIAN,
    START_MS,
    access,
    erasure,
    record_clip,
    recorded,
)


async def test_an_owner_gets_her_clip_after_a_final_access_request(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(access(ACCESS_ID, clip))
    download = await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    assert read_all(clip, download) == list(clip.plaintexts)
    assert await opened.ready_outbox() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_nothing_leaves_before_the_access_request_is_final(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))


async def test_a_request_opens_only_what_it_names_and_only_to_its_owner(opened: CustodianHarness) -> None:
    clip, other, bobs = await opened.keep(), await opened.keep(), await opened.keep(owner=BOB)
    await opened.follow(access(ACCESS_ID, clip, bobs))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(other.record_id, ACCESS_ID, ALICE))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(clip.record_id, ACCESS_ID, BOB))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(bobs.record_id, ACCESS_ID, ALICE))
    assert await opened.ready_outbox() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_a_request_that_names_nothing_is_for_the_visit_up_to_then(opened: CustodianHarness) -> None:
    clip, bobs, later = record_clip(), record_clip(), record_clip()
    await opened.keep(clip)
    await opened.keep(bobs, BOB)
    await opened.follow(access(ACCESS_ID))
    await opened.keep(later)
    assert (await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)).record_id == clip.record_id
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(bobs.record_id, ACCESS_ID, ALICE))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(later.record_id, ACCESS_ID, ALICE))


async def test_releases_are_told_in_batches_that_fit_a_call(opened: CustodianHarness) -> None:
    clips = [record_clip(1) for _ in range(33)]
    for clip in clips:
        await opened.custodian.stage(clip.upload)
    await opened.follow(*(recorded(clip) for clip in clips))
    await opened.follow(access(ACCESS_ID))
    told = [arguments[1] for _, arguments in await opened.ready_outbox()]
    assert sorted(map(len, told)) == [1, 32]
    assert {record_id for batch in told for record_id in batch} == {clip.record_id for clip in clips}


async def test_the_same_upload_twice_is_harmless_and_another_under_its_id_is_refused(opened: CustodianHarness) -> None:
    clip, other = record_clip(), record_clip()
    await opened.custodian.stage(clip.upload)
    await opened.custodian.stage(clip.upload)
    assert opened.keys.held_count == 3
    false = msgspec.structs.replace(clip.upload, ciphertexts=other.upload.ciphertexts)
    await refused("UPLOAD_CONFLICT", opened.custodian.stage(false))
    assert opened.keys.held_count == 3


@pytest.mark.parametrize("change", ["fewer keys", "fewer leaves", "no frames", "short key", "short leaf", "huge frame"])
async def test_an_upload_that_is_not_whole_leaves_nothing(opened: CustodianHarness, change: str) -> None:
    upload = record_clip().upload
    changes = {
        "fewer keys": {"sealed_keys": upload.sealed_keys[:2]},
        "fewer leaves": {"commitment_leaves": upload.commitment_leaves[:2]},
        "no frames": {"ciphertexts": [], "sealed_keys": [], "commitment_leaves": []},
        "short key": {"sealed_keys": [key[:79] for key in upload.sealed_keys]},
        "short leaf": {"commitment_leaves": [leaf[:31] for leaf in upload.commitment_leaves]},
        "huge frame": {"ciphertexts": [bytes(1024 * 1024 + 1)] * 3},
    }
    await refused("UPLOAD_INVALID", opened.custodian.stage(msgspec.structs.replace(upload, **changes[change])))
    assert opened.keys.held_count == 0
    assert [clip async for clip in opened.store.all_clips()] == []


async def test_an_upload_cannot_be_parked_beyond_the_life_of_a_transaction(opened: CustodianHarness) -> None:
    late = record_clip(valid_until_ms=START_MS + 600_000 + CLOCK_SLACK_MS + 1)
    await refused("UPLOAD_INVALID", opened.custodian.stage(late.upload))
    await opened.follow(at_ms=START_MS + 60_000)
    await refused("TRANSACTION_EXPIRED", opened.custodian.stage(record_clip().upload))


async def test_a_staged_clip_is_purged_only_after_a_finalized_time_beyond_its_expiry(opened: CustodianHarness) -> None:
    clip = record_clip(valid_until_ms=START_MS + 60_000)
    await opened.custodian.stage(clip.upload)
    await opened.follow(at_ms=START_MS + 59_999)
    assert await opened.store.clips([clip.record_id]) != {}
    await opened.follow(at_ms=START_MS + 60_000)
    assert await opened.store.clips([clip.record_id]) == {}
    assert opened.keys.held_count == 0


async def test_a_robot_that_signs_again_keeps_its_staged_clip_alive(opened: CustodianHarness) -> None:
    clip = record_clip(valid_until_ms=START_MS + 60_000)
    await opened.custodian.stage(clip.upload)
    renewed = msgspec.structs.replace(clip.upload, txid=b"\x77" * 32, valid_until_ms=START_MS + 90_000)
    await opened.custodian.stage(renewed)
    await opened.follow(at_ms=START_MS + 70_000)
    await opened.follow(recorded(clip), at_ms=START_MS + 80_000)
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].status == "confirmed"


async def test_a_clip_whose_record_commits_to_other_bytes_is_dropped_and_missed(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    await opened.follow(recorded(clip, ciphertext_root=b"\x01" * 32))
    assert await opened.store.clips([clip.record_id]) == {}
    assert [facts.record_id for facts in await opened.custodian.missing(10)] == [clip.record_id]
    assert opened.keys.held_count == 0
    await refused("UPLOAD_HASH_MISMATCH", opened.custodian.stage(clip.upload))
    assert opened.keys.held_count == 0


async def test_an_upload_that_comes_after_its_record_is_confirmed_at_once(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip), access(ACCESS_ID, clip))
    await refused("CLIP_NOT_CONFIRMED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    assert await opened.ready_outbox() == []
    await opened.custodian.stage(clip.upload)
    assert read_all(clip, await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(clip.plaintexts)
    assert await opened.custodian.missing(10) == []
    assert await opened.ready_outbox() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_erasing_frames_leaves_the_others_and_says_what_remains(opened: CustodianHarness) -> None:
    clip = await opened.keep(record_clip(4))
    await opened.follow(access(ACCESS_ID, clip), erasure(ERASURE_ID, clip, frames=(1, 3)))
    download = await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    assert read_all(clip, download) == [clip.plaintexts[0], None, clip.plaintexts[2], None]
    assert opened.keys.held_count == 2
    receipt = next(arguments for call, arguments in await opened.ready_outbox() if call == "erasure.receipt")
    assert receipt[:4] == [ERASURE_ID, 2, "commitment-leaves", EXPIRES_MS]
    assert len(receipt[4]) == 32


async def test_erasing_a_record_destroys_all_and_it_never_comes_back(opened: CustodianHarness) -> None:
    clip, other = await opened.keep(), await opened.keep()
    await opened.follow(access(ACCESS_ID, clip, other), erasure(ERASURE_ID, clip))
    await refused("CLIP_ERASED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    await refused("CLIP_ERASED", opened.custodian.export(clip.record_id))
    await refused("CLIP_ERASED", opened.custodian.stage(clip.upload))
    assert read_all(other, await opened.custodian.download(other.record_id, ACCESS_ID, ALICE)) == list(other.plaintexts)
    assert opened.keys.held_count == 3
    receipt = next(arguments for call, arguments in await opened.ready_outbox() if call == "erasure.receipt")
    assert receipt[:4] == [ERASURE_ID, 3, "nothing", 0]


async def test_nobody_erases_anothers_record_even_if_a_contract_let_her(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(erasure(ERASURE_ID, clip, owner=BOB))
    assert (await opened.custodian.export(clip.record_id)).frames[0].erased is False
    receipt = next(arguments for call, arguments in await opened.ready_outbox() if call == "erasure.receipt")
    assert receipt[1] == 0


async def test_uploads_go_on_while_many_clips_of_one_block_are_erased_and_upkeep_waits_for_its_end(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of a robot expire together, hundreds at a time."""
    monkeypatch.setattr("node.custody.erasure.RECORDS_A_CALL_MAX_COUNT", 2)
    custodian, store, order, works = opened.custodian, opened.store, list[str](), list[asyncio.Task[None]]()
    clips = [record_clip() for _ in range(7)]
    for clip in clips:
        await custodian.stage(clip.upload)
    await opened.follow(*(recorded(clip, expires_at_ms=START_MS + 50_000) for clip in clips))
    coming, erase_clips = record_clip(), store.erase_clips

    async def upload() -> None:
        await custodian.stage(msgspec.structs.replace(coming.upload, valid_until_ms=START_MS + 90_000))
        order.append("uploaded")

    async def keep_up() -> None:
        async with custodian.at_rest():
            assert await store.expired(START_MS + 50_000, 1) == []
            order.append(f"at rest at {opened.chain.height}")

    async def noted(record_ids: list[bytes]) -> None:
        if not works:
            works.extend(asyncio.create_task(work()) for work in (upload, keep_up))
            while not custodian._writing._waiters:  # until the upload waits
                await asyncio.to_thread(bool)
        order.append(f"erased {len(record_ids)}")
        await erase_clips(record_ids)

    monkeypatch.setattr(store, "erase_clips", noted)
    await opened.follow(at_ms=START_MS + 50_000)
    order.append("followed")
    await asyncio.wait(works)
    assert order[:3] == ["erased 2", "uploaded", "erased 2"]
    assert order[3:] == ["erased 2", "erased 1", "followed", f"at rest at {opened.chain.height}"]
    await opened.follow(recorded(coming))
    assert read_all(coming, await custodian.export(coming.record_id)) == list(coming.plaintexts)
    assert opened.keys.held_count == len(coming.plaintexts)


async def test_an_expired_record_is_erased_unasked(opened: CustodianHarness) -> None:
    clip, later = record_clip(), record_clip()
    await opened.keep(clip)
    await opened.custodian.stage(later.upload)
    await opened.follow(recorded(later, expires_at_ms=EXPIRES_MS + 1))
    await opened.follow(at_ms=EXPIRES_MS - 1)
    assert await opened.ready_outbox() == []
    await opened.follow(at_ms=EXPIRES_MS)
    [(call, arguments)] = await opened.ready_outbox()
    assert (call, arguments[0]) == ("erasure.expired", [clip.record_id])
    await refused("CLIP_ERASED", opened.custodian.export(clip.record_id))
    assert len((await opened.custodian.export(later.record_id)).frames) == 3


async def test_what_is_owed_stays_until_the_chain_shows_it_of_this_custodian(opened: CustodianHarness) -> None:
    clip, expiring = await opened.keep(), await opened.keep()
    await opened.follow(access(ACCESS_ID, clip), erasure(ERASURE_ID, clip))
    await opened.follow(at_ms=EXPIRES_MS)
    assert len(await opened.ready_outbox()) == 3

    def shown(custodian: bytes) -> list[tuple]:
        return [
            ("access", "released", {"access_id": ACCESS_ID, "custodian": custodian, "records": [clip.record_id]}),
            ("erasure", "receipted", {"erasure_id": ERASURE_ID, "custodian": custodian, "status": "requested"}),
            ("erasure", "expired", {"record_ids": [expiring.record_id], "custodian": custodian}),
        ]

    await opened.follow(*shown(OTHER_CUSTODIAN))
    assert len(await opened.ready_outbox()) == 3
    await opened.follow(*shown(CUSTODIAN))
    assert await opened.ready_outbox() == []


async def test_what_the_chain_refuses_for_good_can_be_dismissed(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.follow(erasure(ERASURE_ID, clip))
    [row] = await opened.custodian.ready_outbox(10)
    await opened.custodian.dismiss(replace(row, height=row.height - 1))
    assert await opened.custodian.ready_outbox(10) == [row], "it is owed anew since"
    await opened.custodian.dismiss(row)
    assert await opened.ready_outbox() == []


async def test_a_block_that_comes_twice_is_in_effect_once(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    block = opened.chain.block(access(ACCESS_ID, clip), erasure(ERASURE_ID, clip, frames=(0,)))
    for _ in range(3):
        await opened.custodian.on_finalized_block(block)
    owed = await opened.ready_outbox()
    assert [call for call, _ in owed] == ["erasure.receipt", "access.released"]
    assert owed[0][1][1] == 1


async def test_a_block_out_of_order_or_of_another_chain_is_refused(opened: CustodianHarness) -> None:
    await opened.follow()
    second, third = opened.chain.block(), opened.chain.block()
    await refused("CUSTODY_OUT_OF_ORDER", opened.custodian.on_finalized_block(third))
    await opened.custodian.on_finalized_block(second)
    await refused("CUSTODY_OUT_OF_ORDER", opened.custodian.on_finalized_block(replace(second, block_id=b"\x99" * 32)))
    point = await opened.custodian.checkpoint()
    assert (point.height, point.block_id, point.timestamp_ms) == (2, second.block_id, second.timestamp_ms)


async def test_changed_bytes_in_the_store_reach_the_owner_as_a_named_frame(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    row = await opened.store.clips([clip.record_id])
    frames = await opened.store.frames(clip.record_id)
    changed = bytearray(frames[1].ciphertext)
    changed[100] ^= 1
    broken_key = bytes(120)
    tampered = [
        frames[0],
        replace(frames[1], ciphertext=bytes(changed)),
        replace(frames[2], wrapped_key=broken_key),
    ]
    await opened.store.stage(row[clip.record_id], tampered)
    await opened.follow(access(ACCESS_ID, clip))
    download = await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    data = recorded(clip)[2]
    assert check_clip_download(download, data["commitment_root"], data["ciphertext_root"]) == [1, 2]


async def test_the_whole_store_is_looked_through_once_a_block_however_much_it_erases(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = [record_clip() for _ in range(40)]
    lapsing = record_clip(valid_until_ms=START_MS + 45_000)
    await opened.custodian.stage(lapsing.upload)
    for clip in clips:
        await opened.keep(clip)
    sweep, swept = opened.store.sweep, []

    async def counted() -> None:
        swept.append(len(await opened.ready_outbox()))
        await sweep()

    monkeypatch.setattr(opened.store, "sweep", counted)
    requests = [erasure(b"\xe0" * 31 + bytes([number]), clip) for number, clip in enumerate(clips[:35])]
    await opened.follow(*requests, at_ms=START_MS + 50_000)
    assert swept == [0], "no receipt is owed before"
    assert len(await opened.ready_outbox()) == 35
    assert opened.keys.held_count == 5 * 3
    await opened.follow()
    assert len(swept) == 1, "a block that erases nothing looks through nothing"
    await opened.follow(at_ms=EXPIRES_MS)
    assert len(swept) == 2
    assert (opened.keys.held_count, opened.keys.check_destroyed()) == (0, 0)


@pytest.mark.parametrize("hours", [-5, -1, 1, 5])
async def test_a_custodian_whose_clock_is_hours_off_takes_uploads_and_purges_by_the_chains_time(
    opened: CustodianHarness, hours: int
) -> None:
    await opened.follow()
    opened.custodian._clock_ms = lambda: opened.chain.time_ms + hours * 3_600_000
    kept, lapsing = record_clip(valid_until_ms=START_MS + 120_000), record_clip(valid_until_ms=START_MS + 60_000)
    for clip in (kept, lapsing):
        await opened.custodian.stage(clip.upload)
    await opened.follow(at_ms=START_MS + 59_999)
    assert len(await opened.store.clips([kept.record_id, lapsing.record_id])) == 2
    await opened.follow(recorded(kept), at_ms=START_MS + 60_000)
    assert (await opened.custodian.export(kept.record_id)).record_id == kept.record_id
    assert await opened.store.clips([lapsing.record_id]) == {}


@pytest.mark.parametrize("frames", [(), (0, 2)])
async def test_an_erasure_of_what_is_erased_destroys_nothing_and_is_confirmed_all_the_same(
    opened: CustodianHarness, frames: tuple[int, ...]
) -> None:
    """No contract lets anybody ask so; whoever did would wait for a receipt that never comes."""
    clip, other = await opened.keep(), await opened.keep()
    await opened.follow(erasure(ERASURE_ID, clip, frames=frames))
    await opened.follow(erasure(b"\xe2" * 32, clip, frames=frames))
    receipts = [arguments for call, arguments in await opened.ready_outbox() if call == "erasure.receipt"]
    assert [(told[0], told[1]) for told in receipts] == [(ERASURE_ID, len(frames) or 3), (b"\xe2" * 32, 0)]
    assert read_all(other, await opened.custodian.export(other.record_id)) == list(other.plaintexts)
    assert opened.keys.held_count == 3 + (3 - len(frames) if frames else 0)


@pytest.mark.parametrize("asked", ["download", "export"])
@pytest.mark.parametrize("frames", [(), (0, 2)])
@pytest.mark.parametrize("held_up", ["frames", "visit_restrictions"])
async def test_of_what_is_erased_while_it_is_asked_for_nothing_leaves(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch, asked: str, frames: tuple[int, ...], held_up: str
) -> None:
    clip = await opened.keep()
    await opened.follow(access(ACCESS_ID, clip))
    original, asks = getattr(opened.store, held_up), []

    async def erased_meanwhile(of: object) -> object:
        asks.append(of)
        if len(asks) == 1:
            found = await original(of)
            await opened.follow(erasure(ERASURE_ID, clip, frames=frames))
            return found
        return await original(of)

    monkeypatch.setattr(opened.store, held_up, erased_meanwhile)
    custodian = opened.custodian
    download = partial(custodian.download, clip.record_id, ACCESS_ID, ALICE)
    asking = (download if asked == "download" else partial(custodian.export, clip.record_id))()
    found = await asking
    gone = frames or (0, 1, 2)
    assert [frame.index for frame in found.frames if frame.erased] == list(gone)
    assert not any(frame.ciphertext or frame.sealed_key for frame in found.frames if frame.index in gone)

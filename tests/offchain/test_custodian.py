"""A custodian's life, over both stores: uploads, blocks, releases, erasures, and the crashes in between."""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.records.clips import ClipDownload, check_clip_download
from consensus.records.envelopes import open_data_key, open_frame
from node.offchain.custodian import CLOCK_SLACK_MS, Custodian
from node.offchain.erase_keys import EraseKeys
from node.offchain.store import BlockEffects, CustodyStore
from tests.offchain.small_chain import (
    ALICE,
    BOB,
    CUSTODIAN,
    EXPIRES_MS,
    OTHER_CUSTODIAN,
    START_MS,
    RecordedClip,
    SmallChain,
    access,
    erasure,
    record_clip,
    recorded,
)

ACCESS_ID, ERASURE_ID = b"\xa1" * 32, b"\xe1" * 32


class House:
    """A custodian with its store and its erase keys, which can be closed and opened again."""

    def __init__(self, make_store: Callable[[], CustodyStore], directory: Path) -> None:
        self.make_store = make_store
        self.directory = directory
        self.chain = SmallChain()
        self.store: CustodyStore
        self.keys: EraseKeys
        self.custodian: Custodian

    @asynccontextmanager
    async def open(self) -> AsyncIterator[Custodian]:
        with EraseKeys(self.directory) as self.keys:
            async with self.make_store() as self.store:
                clock = lambda: self.chain.time_ms  # noqa: E731
                self.custodian = Custodian(self.store, self.keys, member=CUSTODIAN, clock_ms=clock)
                await self.custodian.start()
                yield self.custodian

    async def follow(self, *events: tuple, at_ms: int | None = None) -> None:
        await self.custodian.on_finalized_block(self.chain.block(*events, at_ms=at_ms))

    async def keep(self, clip: RecordedClip, owner: bytes = ALICE) -> None:
        """Upload a clip and let its record become final."""
        await self.custodian.stage(clip.upload)
        await self.follow(recorded(clip, owner))

    async def owed(self) -> list[tuple[str, list]]:
        return [(f"{row.contract}.{row.entry}", decode_value(row.arguments)) for row in await self.custodian.owed(100)]


@pytest.fixture
def house(make_store: Callable[[], CustodyStore], tmp_path: Path) -> House:
    return House(make_store, tmp_path / "erase-keys")


@pytest.fixture
async def opened(house: House) -> AsyncIterator[House]:
    async with house.open():
        yield house


async def refused(code: str, action) -> None:
    with pytest.raises(BlockRobotError) as refusal:
        await action
    assert refusal.value.code == code


def read_all(clip: RecordedClip, download: ClipDownload) -> list[bytes | None]:
    """Open every frame as the owner's wallet does; None for an erased one."""
    data = recorded(clip)[2]
    assert check_clip_download(download, data["commitment_root"], data["ciphertext_root"]) == []
    return [
        None
        if frame.erased
        else open_frame(open_data_key(bytes(clip.sealing), frame.sealed_key), clip.record_id, index, frame.ciphertext)
        for index, frame in enumerate(download.frames)
    ]


async def test_an_owner_gets_her_clip_after_a_final_access_request(opened: House) -> None:
    clip = record_clip()
    await opened.keep(clip)
    await opened.follow(access(ACCESS_ID, clip))
    download = await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    assert read_all(clip, download) == list(clip.plaintexts)
    assert await opened.owed() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_nothing_leaves_before_the_access_request_is_final(opened: House) -> None:
    clip = record_clip()
    await opened.keep(clip)
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))


async def test_a_request_opens_only_what_it_names_and_only_to_its_owner(opened: House) -> None:
    clip, other, bobs = record_clip(), record_clip(), record_clip()
    await opened.keep(clip)
    await opened.keep(other)
    await opened.keep(bobs, BOB)
    await opened.follow(access(ACCESS_ID, clip, bobs))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(other.record_id, ACCESS_ID, ALICE))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(clip.record_id, ACCESS_ID, BOB))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(bobs.record_id, ACCESS_ID, ALICE))
    assert await opened.owed() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_a_request_that_names_nothing_is_for_the_visit_up_to_then(opened: House) -> None:
    clip, bobs, later = record_clip(), record_clip(), record_clip()
    await opened.keep(clip)
    await opened.keep(bobs, BOB)
    await opened.follow(access(ACCESS_ID))
    await opened.keep(later)
    assert (await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)).record_id == clip.record_id
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(bobs.record_id, ACCESS_ID, ALICE))
    await refused("ACCESS_NOT_GRANTED", opened.custodian.download(later.record_id, ACCESS_ID, ALICE))


async def test_releases_are_told_in_batches_that_fit_a_call(opened: House) -> None:
    clips = [record_clip(1) for _ in range(33)]
    for clip in clips:
        await opened.custodian.stage(clip.upload)
    await opened.follow(*(recorded(clip) for clip in clips))
    await opened.follow(access(ACCESS_ID))
    told = [arguments[1] for _, arguments in await opened.owed()]
    assert sorted(map(len, told)) == [1, 32]
    assert {record_id for batch in told for record_id in batch} == {clip.record_id for clip in clips}


async def test_the_same_upload_twice_is_harmless_and_another_under_its_id_is_refused(opened: House) -> None:
    clip, other = record_clip(), record_clip()
    await opened.custodian.stage(clip.upload)
    await opened.custodian.stage(clip.upload)
    assert opened.keys.held_count == 3
    false = msgspec.structs.replace(other.upload, record_id=clip.record_id)
    await refused("UPLOAD_CONFLICT", opened.custodian.stage(false))
    assert opened.keys.held_count == 3


@pytest.mark.parametrize("change", ["fewer keys", "fewer leaves", "no frames", "short key", "short leaf", "huge frame"])
async def test_an_upload_that_is_not_whole_leaves_nothing(opened: House, change: str) -> None:
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


async def test_an_upload_cannot_be_parked_beyond_the_life_of_a_transaction(opened: House) -> None:
    late = record_clip(valid_until_ms=START_MS + 600_000 + CLOCK_SLACK_MS + 1)
    await refused("UPLOAD_INVALID", opened.custodian.stage(late.upload))
    await opened.follow(at_ms=START_MS + 60_000)
    await refused("TRANSACTION_EXPIRED", opened.custodian.stage(record_clip().upload))


async def test_a_staged_clip_is_purged_only_after_a_finalized_time_beyond_its_expiry(opened: House) -> None:
    clip = record_clip(valid_until_ms=START_MS + 60_000)
    await opened.custodian.stage(clip.upload)
    await opened.follow(at_ms=START_MS + 59_999)
    assert await opened.store.clips([clip.record_id]) != {}
    await opened.follow(at_ms=START_MS + 60_000)
    assert await opened.store.clips([clip.record_id]) == {}
    assert opened.keys.held_count == 0


async def test_a_robot_that_signs_again_keeps_its_staged_clip_alive(opened: House) -> None:
    clip = record_clip(valid_until_ms=START_MS + 60_000)
    await opened.custodian.stage(clip.upload)
    renewed = msgspec.structs.replace(clip.upload, txid=b"\x77" * 32, valid_until_ms=START_MS + 90_000)
    await opened.custodian.stage(renewed)
    await opened.follow(at_ms=START_MS + 70_000)
    await opened.follow(recorded(clip), at_ms=START_MS + 80_000)
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].status == "confirmed"


async def test_a_clip_whose_record_commits_to_other_bytes_is_dropped_and_missed(opened: House) -> None:
    clip = record_clip()
    await opened.custodian.stage(clip.upload)
    await opened.follow(recorded(clip, ciphertext_root=b"\x01" * 32))
    assert await opened.store.clips([clip.record_id]) == {}
    assert [facts.record_id for facts in await opened.custodian.missing(10)] == [clip.record_id]
    assert opened.keys.held_count == 0
    await refused("UPLOAD_HASH_MISMATCH", opened.custodian.stage(clip.upload))
    assert opened.keys.held_count == 0


async def test_an_upload_that_comes_after_its_record_is_confirmed_at_once(opened: House) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip), access(ACCESS_ID, clip))
    await refused("CLIP_NOT_CONFIRMED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    assert await opened.owed() == []
    await opened.custodian.stage(clip.upload)
    assert read_all(clip, await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(clip.plaintexts)
    assert await opened.custodian.missing(10) == []
    assert await opened.owed() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_erasing_frames_leaves_the_others_and_says_what_remains(opened: House) -> None:
    clip = record_clip(4)
    await opened.keep(clip)
    await opened.follow(access(ACCESS_ID, clip), erasure(ERASURE_ID, clip, frames=(1, 3)))
    download = await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)
    assert read_all(clip, download) == [clip.plaintexts[0], None, clip.plaintexts[2], None]
    assert opened.keys.held_count == 2
    receipt = next(arguments for call, arguments in await opened.owed() if call == "erasure.receipt")
    assert receipt[:4] == [ERASURE_ID, 2, "commitment-leaves", EXPIRES_MS]
    assert len(receipt[4]) == 32


async def test_erasing_a_record_destroys_all_and_it_never_comes_back(opened: House) -> None:
    clip, other = record_clip(), record_clip()
    await opened.keep(clip)
    await opened.keep(other)
    await opened.follow(access(ACCESS_ID, clip, other), erasure(ERASURE_ID, clip))
    await refused("CLIP_ERASED", opened.custodian.download(clip.record_id, ACCESS_ID, ALICE))
    await refused("CLIP_ERASED", opened.custodian.export(clip.record_id))
    await refused("CLIP_ERASED", opened.custodian.stage(clip.upload))
    assert read_all(other, await opened.custodian.download(other.record_id, ACCESS_ID, ALICE)) == list(other.plaintexts)
    assert opened.keys.held_count == 3
    receipt = next(arguments for call, arguments in await opened.owed() if call == "erasure.receipt")
    assert receipt[:4] == [ERASURE_ID, 3, "nothing", 0]


async def test_nobody_erases_anothers_record_even_if_a_contract_let_her(opened: House) -> None:
    clip = record_clip()
    await opened.keep(clip)
    await opened.follow(erasure(ERASURE_ID, clip, owner=BOB))
    assert (await opened.custodian.export(clip.record_id)).frames[0].erased is False
    receipt = next(arguments for call, arguments in await opened.owed() if call == "erasure.receipt")
    assert receipt[1] == 0


async def test_an_expired_record_is_erased_unasked(opened: House) -> None:
    clip, later = record_clip(), record_clip()
    await opened.keep(clip)
    await opened.custodian.stage(later.upload)
    await opened.follow(recorded(later, expires_at_ms=EXPIRES_MS + 1))
    await opened.follow(at_ms=EXPIRES_MS - 1)
    assert await opened.owed() == []
    await opened.follow(at_ms=EXPIRES_MS)
    [(call, arguments)] = await opened.owed()
    assert (call, arguments[0]) == ("erasure.expired", [clip.record_id])
    await refused("CLIP_ERASED", opened.custodian.export(clip.record_id))
    assert len((await opened.custodian.export(later.record_id)).frames) == 3


async def test_what_is_owed_stays_until_the_chain_shows_it_of_this_custodian(opened: House) -> None:
    clip, expiring = record_clip(), record_clip()
    await opened.keep(clip)
    await opened.keep(expiring)
    await opened.follow(access(ACCESS_ID, clip), erasure(ERASURE_ID, clip))
    await opened.follow(at_ms=EXPIRES_MS)
    assert len(await opened.owed()) == 3

    def shown(custodian: bytes) -> list[tuple]:
        return [
            ("access", "released", {"access_id": ACCESS_ID, "custodian": custodian, "records": [clip.record_id]}),
            ("erasure", "receipted", {"erasure_id": ERASURE_ID, "custodian": custodian, "status": "requested"}),
            ("erasure", "expired", {"record_ids": [expiring.record_id], "custodian": custodian}),
        ]

    await opened.follow(*shown(OTHER_CUSTODIAN))
    assert len(await opened.owed()) == 3
    await opened.follow(*shown(CUSTODIAN))
    assert await opened.owed() == []


async def test_what_the_chain_refuses_for_good_can_be_dismissed(opened: House) -> None:
    clip = record_clip()
    await opened.keep(clip)
    await opened.follow(erasure(ERASURE_ID, clip))
    [row] = await opened.custodian.owed(10)
    await opened.custodian.dismiss(row)
    assert await opened.owed() == []


async def test_a_block_that_comes_twice_is_in_effect_once(opened: House) -> None:
    clip = record_clip()
    await opened.keep(clip)
    block = opened.chain.block(access(ACCESS_ID, clip), erasure(ERASURE_ID, clip, frames=(0,)))
    for _ in range(3):
        await opened.custodian.on_finalized_block(block)
    owed = await opened.owed()
    assert [call for call, _ in owed] == ["access.released", "erasure.receipt"]
    assert owed[1][1][1] == 1


async def test_a_block_out_of_order_or_of_another_chain_is_refused(opened: House) -> None:
    await opened.follow()
    second, third = opened.chain.block(), opened.chain.block()
    await refused("CUSTODY_OUT_OF_ORDER", opened.custodian.on_finalized_block(third))
    await opened.custodian.on_finalized_block(second)
    await refused("CUSTODY_OUT_OF_ORDER", opened.custodian.on_finalized_block(replace(second, block_id=b"\x99" * 32)))
    point = await opened.custodian.checkpoint()
    assert (point.height, point.block_id, point.timestamp_ms) == (2, second.block_id, second.timestamp_ms)


async def test_changed_bytes_in_the_store_reach_the_owner_as_a_named_frame(opened: House) -> None:
    clip = record_clip()
    await opened.keep(clip)
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


async def test_an_empty_frame_is_kept_under_its_hash_and_no_other(opened: House) -> None:
    content = secrets.token_bytes(1000)
    await refused("UPLOAD_HASH_MISMATCH", opened.custodian.put_background(bytes(32), content))
    assert await opened.custodian.get_background(bytes(32)) is None


class Peer:
    """Another custodian, for a fetch: sends what it is given."""

    name = "other"

    def __init__(self, *clips: ClipDownload) -> None:
        self.clips = {clip.record_id: clip for clip in clips}

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        return self.clips.get(record_id)


class DeafPeer:
    name = "deaf"

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        raise BlockRobotError("NODE_UNREACHABLE")


def held_by_peer(clip: RecordedClip, *, erased: tuple[int, ...] = ()) -> ClipDownload:
    from consensus.records.clips import FrameDownload

    frames = [
        FrameDownload(index, True, b"", b"") if index in erased else FrameDownload(index, False, text, key)
        for index, (text, key) in enumerate(zip(clip.upload.ciphertexts, clip.upload.sealed_keys, strict=True))
    ]
    return ClipDownload(clip.record_id, clip.upload.txid, frames, clip.upload.commitment_leaves, clip.leaves)


async def test_a_missed_upload_is_fetched_from_another_custodian(opened: House) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip), access(ACCESS_ID, clip))
    assert await opened.custodian.fetch_missing([DeafPeer(), Peer(), Peer(held_by_peer(clip))]) == 1
    assert read_all(clip, await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(clip.plaintexts)
    assert await opened.custodian.fetch_missing([Peer(held_by_peer(clip))]) == 0
    assert await opened.owed() == [("access.released", [ACCESS_ID, [clip.record_id]])]
    assert read_all(clip, await opened.custodian.export(clip.record_id)) == list(clip.plaintexts)


async def test_a_false_clip_from_a_peer_is_not_installed(opened: House) -> None:
    clip, other = record_clip(), record_clip()
    await opened.follow(recorded(clip))
    good = held_by_peer(clip)
    damaged = msgspec.structs.replace(good.frames[1], ciphertext=good.frames[1].ciphertext[:-1] + b"\x00")
    false = [
        (msgspec.structs.replace(held_by_peer(other), record_id=clip.record_id), "PROOF_INVALID"),
        (msgspec.structs.replace(good, frames=[good.frames[0], damaged, good.frames[2]]), "UPLOAD_HASH_MISMATCH"),
        (msgspec.structs.replace(good, frames=good.frames[:2]), "UPLOAD_INVALID"),
    ]
    for download, code in false:
        await refused(code, opened.custodian.install(download))
        assert await opened.custodian.fetch_missing([Peer(download)]) == 0
    assert opened.keys.held_count == 0
    assert len(await opened.custodian.missing(10)) == 1


async def test_frames_erased_while_a_clip_was_missing_do_not_come_back_with_it(opened: House) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    await opened.follow(erasure(ERASURE_ID, clip, frames=(1,)))
    assert await opened.custodian.fetch_missing([Peer(held_by_peer(clip))]) == 1
    assert read_all(clip, await opened.custodian.export(clip.record_id))[1] is None
    assert opened.keys.held_count == 2


async def test_frames_that_the_peer_has_erased_already_are_installed_as_erased(opened: House) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    assert await opened.custodian.install(held_by_peer(clip, erased=(0,)))
    assert read_all(clip, await opened.custodian.export(clip.record_id)) == [None, *clip.plaintexts[1:]]


async def test_a_record_erased_while_its_clip_was_missing_stays_away(opened: House) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip))
    await opened.follow(erasure(ERASURE_ID, clip))
    assert await opened.custodian.missing(10) == []
    assert await opened.custodian.install(held_by_peer(clip)) is False
    await refused("CLIP_ERASED", opened.custodian.stage(clip.upload))
    assert [call for call, _ in await opened.owed()] == ["erasure.receipt"]


# Crashes


class PowerCutError(Exception):
    """The process ends here."""


WRITES = ["apply", "add_outbox", "erase_clip", "erase_frames", "sweep", "mark_outbox_ready", "drop_staged"]


def cut_power_at(house: House, monkeypatch: pytest.MonkeyPatch, step: int, *, after: bool) -> list[str]:
    """Let the process end before or after the `step`-th write to the store or to the erase keys from now on."""
    done: list[str] = []

    def passes(name: str) -> bool:
        done.append(name)
        return len(done) != step

    def guard(name: str, original: Callable) -> Callable:
        async def guarded(*arguments: object) -> object:
            here = not passes(name)
            if here and not after:
                raise PowerCutError
            result = await original(*arguments)
            if here:
                raise PowerCutError
            return result

        return guarded

    def guard_keys(name: str, original: Callable) -> Callable:
        def guarded(*arguments: object) -> object:
            here = not passes(name)
            if here and not after:
                raise PowerCutError
            result = original(*arguments)
            if here:
                raise PowerCutError
            return result

        return guarded

    for name in WRITES:
        monkeypatch.setattr(house.store, name, guard(name, getattr(house.store, name)))
    for name in ("destroy", "release"):
        monkeypatch.setattr(house.keys, name, guard_keys(name, getattr(house.keys, name)))
    return done


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("step", range(1, 23))
async def test_a_crash_at_any_write_of_a_block_loses_and_doubles_nothing(
    house: House, monkeypatch: pytest.MonkeyPatch, step: int, after: bool
) -> None:
    """One block confirms, grants, erases frames, erases a record, purges and expires; the power fails somewhere in it."""
    kept, cut, gone, lapsed, expiring = (record_clip() for _ in range(5))
    kept_events = [recorded(kept, expires_at_ms=EXPIRES_MS + 9_999_999)]
    async with house.open() as custodian:
        for clip in (kept, cut, gone, expiring):
            await custodian.stage(clip.upload)
        await house.follow(
            recorded(cut, expires_at_ms=EXPIRES_MS + 9_999_999),
            recorded(gone, expires_at_ms=EXPIRES_MS + 9_999_999),
            recorded(expiring, expires_at_ms=START_MS + 50_000),
        )
        await custodian.stage(msgspec.structs.replace(lapsed.upload, valid_until_ms=START_MS + 50_000))
        block = house.chain.block(
            *kept_events,
            access(ACCESS_ID, kept),
            erasure(ERASURE_ID, cut, frames=(0, 2)),
            erasure(b"\xe2" * 32, gone),
            at_ms=START_MS + 50_000,
        )
        with monkeypatch.context() as patches:
            done = cut_power_at(house, patches, step, after=after)
            try:
                await custodian.on_finalized_block(block)
                assert len(done) < step
            except PowerCutError:
                assert len(done) == step
    async with house.open() as custodian:
        fresh = record_clip()
        await custodian.stage(msgspec.structs.replace(fresh.upload, valid_until_ms=START_MS + 90_000))
        await custodian.on_finalized_block(block)
        await house.follow(recorded(fresh, expires_at_ms=EXPIRES_MS))
        assert read_all(kept, await custodian.download(kept.record_id, ACCESS_ID, ALICE)) == list(kept.plaintexts)
        assert read_all(cut, await custodian.export(cut.record_id)) == [None, cut.plaintexts[1], None]
        assert read_all(fresh, await custodian.export(fresh.record_id)) == list(fresh.plaintexts)
        for clip in (gone, expiring):
            await refused("CLIP_ERASED", custodian.export(clip.record_id))
        await refused("NOT_FOUND", custodian.export(lapsed.record_id))
        assert house.keys.held_count == 3 + 1 + 3
        told = {call: arguments for call, arguments in await house.owed() if call != "erasure.receipt"}
        assert told["access.released"] == [ACCESS_ID, [kept.record_id]]
        assert told["erasure.expired"][0] == [expiring.record_id]
        receipts = {arguments[0]: arguments[1:3] for call, arguments in await house.owed() if call == "erasure.receipt"}
        assert receipts == {ERASURE_ID: [2, "commitment-leaves"], b"\xe2" * 32: [3, "nothing"]}
        assert len(await house.owed()) == 4


async def test_keys_of_an_upload_that_a_crash_cut_off_are_destroyed_at_the_next_start(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = record_clip()
    async with house.open() as custodian:

        async def fail(*_: object) -> None:
            raise PowerCutError

        with monkeypatch.context() as patches:
            patches.setattr(house.store, "stage", fail)
            with pytest.raises(PowerCutError):
                await custodian.stage(clip.upload)
        assert house.keys.held_count == 3
    async with house.open() as custodian:
        assert house.keys.held_count == 0
        await custodian.stage(clip.upload)
        assert house.keys.held_count == 3


async def test_a_database_from_a_backup_opens_nothing_that_was_erased_since(house: House) -> None:
    """The erase keys are not in the database's backups: a restored row has no key any more."""
    clip = record_clip()
    async with house.open() as custodian:
        await house.keep(clip)
        row, frames = (
            (await house.store.clips([clip.record_id]))[clip.record_id],
            await house.store.frames(clip.record_id),
        )
        await house.follow(erasure(ERASURE_ID, clip))
        await house.store.stage(row, frames)
        restored = await custodian.export(clip.record_id)
        assert [frame.erased for frame in restored.frames] == [True, True, True]
        other = record_clip()
        await house.keep(other)
        reused = await custodian.export(clip.record_id)
        assert all(frame.sealed_key == b"" for frame in reused.frames)


async def test_missing_rows_survive_what_confirms_other_clips(opened: House) -> None:
    missed, held = record_clip(), record_clip()
    await opened.custodian.stage(held.upload)
    await opened.follow(recorded(missed), recorded(held))
    await opened.store.apply(BlockEffects())
    assert [facts.record_id for facts in await opened.custodian.missing(10)] == [missed.record_id]

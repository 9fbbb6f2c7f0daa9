"""Stories of shares at one custodian, over every store: parts of keys come, are handed out, and go with all they open."""

from __future__ import annotations

import secrets
from collections.abc import Awaitable
from dataclasses import replace
from typing import Any

import pytest
from msgspec.structs import replace as replace_fields

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.sharing import (
    GrantUpload,
    SharedRequest,
    check_shared_download,
    count_masks,
    join_parts,
    open_package,
    seal_package,
    split_share_key,
)
from node.custody.shares import PARTS_STAGED_MAX_COUNT
from node.custody.stores.custody_store import CustodyStore
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all
from tests.offchain.house import refused as refused_with
from tests.offchain.small_chain import (
    ALICE,
    BOB,
    CUSTODIAN,
    EXPIRES_MS,
    OTHER_CUSTODIAN,
    START_MS,
    RecordedClip,
    access,
    erasure,
    record_clip,
    recorded,
)

GRANT_ID, OTHER_GRANT_ID, HER_ACCESS_ID = b"\x91" * 32, b"\x92" * 32, b"\xa7" * 32
UNTIL_MS = START_MS + 1_800_000
GRANTEE = PrivateKey(sha256(b"grantee")).public_key
SHARE_KEY = sha256(b"T")
Event = tuple[str, str, dict[str, Any]]


def parts_for(clip: RecordedClip, grant_id: bytes = GRANT_ID, **changes: Any) -> dict[bytes, GrantUpload]:
    """Return what a wallet brings each of two custodians for one record; here the owner is the grantee, for her key."""
    masks = [secrets.token_bytes(32) for _ in range(count_masks(2))]
    package = seal_package(
        SHARE_KEY,
        secrets.token_bytes(24),
        bytes(clip.sealing.public_key),
        grantee=GRANTEE,
        record_id=clip.record_id,
        keys=dict(enumerate(clip.data_keys)),
    )
    split = split_share_key(SHARE_KEY, [CUSTODIAN, OTHER_CUSTODIAN], masks)
    words: dict[str, Any] = {
        "valid_until_ms": START_MS + 60_000,
        "record_id": clip.record_id,
        "package": package,
    } | changes
    return {who: GrantUpload(grant_txid=grant_id, parts=parts, **words) for who, parts in split.items()}


def granted(*clips: RecordedClip, grant_id: bytes = GRANT_ID, owner: bytes = ALICE, until_ms: int = UNTIL_MS) -> Event:
    ids = [clip.record_id for clip in clips]
    return "access", "granted", {"grant_id": grant_id, "owner": owner, "records": ids, "until_ms": until_ms}


def revoked(grant_id: bytes = GRANT_ID) -> Event:
    return "access", "revoked", {"grant_id": grant_id, "owner": ALICE}


def asked(*clips: RecordedClip, grant_id: bytes = GRANT_ID, access_id: bytes = HER_ACCESS_ID) -> Event:
    contract, name, data = access(access_id, *clips)
    return contract, name, data | {"grant": grant_id}


def request(clip: RecordedClip, access_id: bytes = HER_ACCESS_ID, with_frames: bool = True) -> SharedRequest:
    return SharedRequest(clip.record_id, access_id, bytes(32), bytes(32), with_frames)


async def share(house: CustodianHarness, clip: RecordedClip) -> GrantUpload:
    """Keep a clip, share it and let the grantee ask; return what this custodian was brought."""
    await house.keep(clip)
    upload = parts_for(clip)[CUSTODIAN]
    assert await house.custodian.stage_part(upload, ALICE) == "staged"
    await house.follow(granted(clip))
    await house.follow(asked(clip))
    return upload


async def assert_nothing_is_left(house: CustodianHarness, upload: GrantUpload) -> None:
    """Neither a row nor a key of the part is here; what is left of keys belongs to frames."""
    assert [place async for place in house.store.all_parts()] == []
    assert sorted([slot async for slot in house.store.slots_in_use()]) == house.keys.held
    assert house.keys.check_destroyed() == 0
    with pytest.raises(BlockRobotError) as refusal:
        await house.custodian.download_shared(request_of(upload), upload.grant_txid)
    assert refusal.value.code in {"GRANT_ENDED", "ACCESS_NOT_GRANTED"}


def request_of(upload: GrantUpload) -> SharedRequest:
    return SharedRequest(upload.record_id, HER_ACCESS_ID, bytes(32), bytes(32), with_frames=False)


async def test_a_grantee_reads_with_two_custodians_parts_and_not_with_ones(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    brought = parts_for(clip)
    await opened.custodian.stage_part(brought[CUSTODIAN], ALICE)
    await opened.follow(granted(clip))
    await opened.follow(asked(clip))
    found = await opened.custodian.download_shared(request(clip), GRANT_ID)
    told = recorded(clip)[2]
    assert check_shared_download(found, told["commitment_root"], told["ciphertext_root"]) == []
    assert found.custodian == CUSTODIAN
    assert not any(key in encode(found) for key in clip.upload.sealed_keys), "the owner's sealed keys stay behind"
    assert join_parts({CUSTODIAN: found.parts}) == []
    joined = join_parts({CUSTODIAN: found.parts, OTHER_CUSTODIAN: brought[OTHER_CUSTODIAN].parts})
    where = {"grantee": GRANTEE, "record_id": clip.record_id}
    keys = open_package(joined, bytes(clip.sealing), found.package, **where)
    assert keys == dict(enumerate(clip.data_keys))
    assert await opened.ready_outbox() == [("access.released", [HER_ACCESS_ID, [clip.record_id]])]


async def test_without_frames_only_package_and_parts_come(opened: CustodianHarness) -> None:
    clip = record_clip()
    upload = await share(opened, clip)
    found = await opened.custodian.download_shared(request(clip, with_frames=False), GRANT_ID)
    assert (found.frames, found.commitment_leaves, found.ciphertext_leaves) == ([], [], [])
    assert (found.package, found.parts) == (upload.package, upload.parts)


async def test_nothing_of_a_part_stands_open_in_the_store(opened: CustodianHarness) -> None:
    upload = await share(opened, record_clip())
    row = await opened.store.part(GRANT_ID, upload.record_id)
    assert row is not None
    assert upload.package not in row.wrapped
    assert not any(part.value in row.wrapped for part in upload.parts)


async def test_each_request_opens_for_its_own_side(opened: CustodianHarness) -> None:
    """An owner's request opens nothing to a grantee, nor hers to the owner, nor one grant's to another's."""
    clip = record_clip()
    await share(opened, clip)
    await opened.follow(access(ACCESS_ID, clip))
    custodian = opened.custodian
    await refused_with("ACCESS_NOT_GRANTED", custodian.download(clip.record_id, HER_ACCESS_ID, ALICE))
    await refused_with("ACCESS_NOT_GRANTED", custodian.download_shared(request(clip, ACCESS_ID), GRANT_ID))
    await refused_with("ACCESS_NOT_GRANTED", custodian.download_shared(request(clip, ACCESS_ID), b""))
    await refused_with("ACCESS_NOT_GRANTED", custodian.download_shared(request(clip), OTHER_GRANT_ID))
    await refused_with("ACCESS_NOT_GRANTED", custodian.download_shared(request(record_clip()), GRANT_ID))
    assert read_all(clip, await custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(clip.plaintexts)


# Uploads


async def test_the_same_part_is_taken_again_and_another_is_not(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    upload = parts_for(clip)[CUSTODIAN]
    for _ in range(2):
        assert await opened.custodian.stage_part(upload, ALICE) == "staged"
    assert (await opened.store.counts()).parts == 1
    forged = replace_of(upload, package=upload.package[:-1] + bytes((upload.package[-1] ^ 1,)))
    await refused_with("UPLOAD_CONFLICT", opened.custodian.stage_part(forged, ALICE))
    assert sorted([slot async for slot in opened.store.slots_in_use()]) == opened.keys.held


def replace_of(upload: GrantUpload, **changes: Any) -> GrantUpload:
    fields = {name: getattr(upload, name) for name in GrantUpload.__struct_fields__}
    return GrantUpload(**(fields | changes))


async def test_only_the_owner_of_a_record_that_is_here_brings_parts(opened: CustodianHarness) -> None:
    clip, away = record_clip(), record_clip()
    await opened.keep(clip)
    await refused_with("NOT_PERMITTED", opened.custodian.stage_part(parts_for(clip)[CUSTODIAN], BOB))
    await refused_with("CLIP_NOT_CONFIRMED", opened.custodian.stage_part(parts_for(away)[CUSTODIAN], ALICE))
    await opened.follow(erasure(ERASURE_ID, clip))
    await refused_with("CLIP_ERASED", opened.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE))
    assert opened.keys.held == []


async def test_a_part_comes_in_time_or_not_at_all(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    for valid_until_ms, code in ((START_MS, "TRANSACTION_EXPIRED"), (START_MS + 3_600_000, "UPLOAD_INVALID")):
        late = parts_for(clip, valid_until_ms=valid_until_ms)[CUSTODIAN]
        await refused_with(code, opened.custodian.stage_part(late, ALICE))


async def test_parts_for_grants_that_never_come_are_bounded_and_lapse(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    upload = parts_for(clip)[CUSTODIAN]
    await opened.custodian.stage_part(upload, ALICE)
    row = await opened.store.part(GRANT_ID, clip.record_id)
    assert row is not None
    for number in range(PARTS_STAGED_MAX_COUNT - 1):
        await opened.store.put_part(replace(row, grant_id=number.to_bytes(32, "big")))
    more = parts_for(clip, OTHER_GRANT_ID)[CUSTODIAN]
    await refused_with("RATE_LIMITED", opened.custodian.stage_part(more, ALICE))
    await opened.follow(at_ms=upload.valid_until_ms)
    await assert_nothing_is_left(opened, upload)


async def test_a_part_that_came_late_counts_while_the_grant_stands(opened: CustodianHarness) -> None:
    """The custodian refused her first, and owes the chain the release once it has its part."""
    clip, other = await opened.keep(), await opened.keep()
    await opened.follow(granted(clip))
    await opened.follow(asked(clip))
    assert await opened.ready_outbox() == [("access.refused", [HER_ACCESS_ID, "GRANT_PARTS_MISSING"])]
    await refused_with("GRANT_PARTS_MISSING", opened.custodian.download_shared(request(clip), GRANT_ID))
    upload = parts_for(clip)[CUSTODIAN]
    assert await opened.custodian.stage_part(upload, ALICE) == "confirmed"
    assert ("access.released", [HER_ACCESS_ID, [clip.record_id]]) in await opened.ready_outbox()
    await opened.custodian.download_shared(request(clip), GRANT_ID)
    await refused_with("NOT_PERMITTED", opened.custodian.stage_part(parts_for(other)[CUSTODIAN], ALICE))
    opened.chain.time_ms = UNTIL_MS
    await refused_with("GRANT_ENDED", opened.custodian.stage_part(upload, ALICE))


async def test_what_was_uploaded_under_anothers_grant_goes_when_it_is_final(opened: CustodianHarness) -> None:
    clip, others = await opened.keep(), await opened.keep(owner=BOB)
    await opened.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE)
    await opened.custodian.stage_part(parts_for(others)[CUSTODIAN], BOB)
    await opened.follow(granted(clip))
    assert [place.record_id async for place in opened.store.all_parts()] == [clip.record_id]


# The end of a share


async def test_a_revoked_grant_is_destroyed_at_once(opened: CustodianHarness) -> None:
    upload = await share(opened, record_clip())
    await opened.follow(revoked())
    await assert_nothing_is_left(opened, upload)
    late = replace_of(upload, valid_until_ms=START_MS + 1)
    await refused_with("TRANSACTION_EXPIRED", opened.custodian.stage_part(late, ALICE))


async def test_a_grant_that_is_over_is_destroyed_by_time(opened: CustodianHarness) -> None:
    clip = record_clip()
    upload = await share(opened, clip)
    opened.chain.time_ms = UNTIL_MS
    await refused_with("GRANT_ENDED", opened.custodian.download_shared(request(clip), GRANT_ID))
    await opened.follow(at_ms=UNTIL_MS)
    await assert_nothing_is_left(opened, upload)


async def test_an_erased_record_takes_its_parts_with_it(opened: CustodianHarness) -> None:
    clip = record_clip()
    await share(opened, clip)
    await opened.follow(erasure(ERASURE_ID, clip))
    assert [place async for place in opened.store.all_parts()] == []
    assert opened.keys.held == []
    await refused_with("CLIP_ERASED", opened.custodian.download_shared(request(clip), GRANT_ID))


async def test_erased_frames_take_the_package_with_their_keys_with_them(opened: CustodianHarness) -> None:
    clip = record_clip()
    await share(opened, clip)
    await opened.follow(erasure(ERASURE_ID, clip, frames=(1,)))
    assert [place async for place in opened.store.all_parts()] == []
    assert len(opened.keys.held) == 2
    await refused_with("GRANT_PARTS_MISSING", opened.custodian.download_shared(request(clip), GRANT_ID))


async def test_an_expired_record_takes_its_parts_with_it(opened: CustodianHarness) -> None:
    clip = await opened.keep()
    await opened.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE)
    await opened.follow(granted(clip, until_ms=EXPIRES_MS + 3_600_000))
    await opened.follow(at_ms=EXPIRES_MS)
    assert [place async for place in opened.store.all_parts()] == []
    assert opened.keys.held == []


async def test_a_denied_visit_takes_all_parts_with_it(opened: CustodianHarness) -> None:
    clip, waiting = record_clip(), record_clip()
    await share(opened, clip)
    await opened.keep(waiting)
    staged = parts_for(waiting, OTHER_GRANT_ID)[CUSTODIAN]
    await opened.custodian.stage_part(staged, ALICE)
    await opened.follow(("rights", "quarantined", {"owner": ALICE}))
    assert [place async for place in opened.store.all_parts()] == []
    await refused_with("CLIP_QUARANTINED", opened.custodian.download_shared(request(clip), GRANT_ID))
    await refused_with("CLIP_QUARANTINED", opened.custodian.stage_part(staged, ALICE))


async def test_a_restriction_that_came_later_voids_her_request(opened: CustodianHarness) -> None:
    clip = record_clip()
    await share(opened, clip)
    row = {"owner": ALICE, "whole": True, "whole_since_ms": START_MS, "until_ms": 0, "records": []}
    await opened.follow(("rights", "restricted", row))
    await refused_with("ACCESS_ENDED", opened.custodian.download_shared(request(clip), GRANT_ID))


# Crashes and backups


class CutOffError(Exception):
    """The power went."""


@pytest.mark.parametrize("step", ["erase_parts", "forget_share", "apply", "sweep"])
async def test_a_revocation_cut_off_between_two_writes_is_finished(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    clip = record_clip()
    async with house.open():
        upload = await share(house, clip)
        block = house.chain.block(revoked())

        async def cut(*_: object, **__: object) -> None:
            raise CutOffError

        with monkeypatch.context() as power:
            power.setattr(house.store, step, cut)
            with pytest.raises(CutOffError):
                await house.custodian.on_finalized_block(block)
        await never_released(house.custodian.download_shared(request(clip), GRANT_ID))
    async with house.open():
        await house.custodian.on_finalized_block(block)
        await assert_nothing_is_left(house, upload)


async def never_released(release: Awaitable[object]) -> None:
    with pytest.raises(BlockRobotError) as refusal:
        await release
    assert refusal.value.code in {"GRANT_ENDED", "GRANT_PARTS_MISSING"}


async def test_an_upload_cut_off_before_its_row_leaves_no_key(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = record_clip()
    async with house.open():
        await house.keep(clip)

        async def cut(_: object) -> None:
            raise CutOffError

        with monkeypatch.context() as power:
            power.setattr(house.store, "put_part", cut)
            with pytest.raises(CutOffError):
                await house.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE)
    async with house.open():
        assert sorted([slot async for slot in house.store.slots_in_use()]) == house.keys.held
        assert await house.custodian.stage_part(parts_for(clip)[CUSTODIAN], ALICE) == "staged"


async def test_a_store_put_back_from_before_the_revocation_releases_nothing(opened: CustodianHarness) -> None:
    """Rows of a backup stand beside the erase keys of today: what they wrap opens no more, even before any block."""
    clip = record_clip()
    upload = await share(opened, clip)
    backup = await copy_of(opened.store, upload)
    await opened.follow(revoked())
    await put_back(opened.store, backup)
    await never_released(opened.custodian.download_shared(request(clip), GRANT_ID))
    for other in (record_clip(), record_clip()):
        await opened.keep(other)  # the slot may be another frame's by now
    await never_released(opened.custodian.download_shared(request(clip), GRANT_ID))


async def copy_of(store: CustodyStore, upload: GrantUpload) -> tuple[Any, Any]:
    return await store.share(upload.grant_txid), await store.part(upload.grant_txid, upload.record_id)


async def put_back(store: CustodyStore, backup: tuple[Any, Any]) -> None:
    share_row, part_row = backup
    await store.put_share(share_row)
    await store.put_part(part_row)


async def test_what_is_refused_makes_no_key_first(opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is made and destroyed again costs three flushes of the disk, whoever is refused."""
    clip, late = record_clip(), record_clip()
    await opened.keep(clip)
    await opened.follow(recorded(late))
    upload = parts_for(clip)[CUSTODIAN]

    def allocate(count: int) -> list[tuple[int, bytes]]:
        raise AssertionError("a key was made for what is refused")

    def end() -> None:
        raise BlockRobotError("GRANT_ENDED")

    monkeypatch.setattr(opened.keys, "allocate", allocate)
    await refused_with("NOT_PERMITTED", opened.custodian.stage_part(upload, BOB))
    await refused_with("GRANT_ENDED", opened.custodian.stage_part(upload, ALICE, end))
    other = replace_fields(late.upload, ciphertexts=record_clip().upload.ciphertexts)
    await refused_with("UPLOAD_HASH_MISMATCH", opened.custodian.stage(other))


async def test_a_part_that_is_here_already_makes_no_key(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip, asked_for = record_clip(), 0
    upload, allocate = parts_for(clip)[CUSTODIAN], opened.keys.allocate

    def count(number: int) -> list[tuple[int, bytes]]:
        nonlocal asked_for
        asked_for += 1
        return allocate(number)

    await opened.keep(clip)
    monkeypatch.setattr(opened.keys, "allocate", count)
    for _ in range(3):
        assert await opened.custodian.stage_part(upload, ALICE) == "staged"
    assert asked_for == 1

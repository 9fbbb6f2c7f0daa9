"""Two custodians in league: what they hold together, what opens with it, and whom else they need. Nothing here is guessed:
they use all of their stores and erase keys.
"""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from nacl.public import PrivateKey as SealingKey

from consensus.errors import BlockRobotError
from consensus.records.clips import ClipDownload
from consensus.records.envelopes import open_data_key, open_frame
from consensus.records.sharing import (
    GrantUpload,
    count_masks,
    join_parts,
    open_package,
    seal_package,
    split_share_key,
)
from node.custody.shares import HeldPart
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import CustodianHarness, read_all
from tests.offchain.small_chain import ALICE, CUSTODIAN, OTHER_CUSTODIAN, START_MS, RecordedClip, erasure, record_clip
from tests.offchain.test_sharing import GRANT_ID, GRANTEE, asked, granted, revoked

NAMES = (CUSTODIAN, OTHER_CUSTODIAN)


@dataclass
class League:
    """Two custodians' houses, a shared clip, and copies that they took of all of it."""

    houses: list[CustodianHarness]
    clip: RecordedClip
    doctor: SealingKey
    clips: list[ClipDownload]
    parts: list[HeldPart]

    def joined(self, count: int) -> list[bytes]:
        held = {name: part.parts for name, part in zip(NAMES[:count], self.parts, strict=False)}
        return join_parts(held)

    def open_shared(self, keys: list[bytes], sealing: bytes) -> dict[int, bytes]:
        where = {"grantee": GRANTEE, "record_id": self.clip.record_id}
        return open_package(keys, sealing, self.parts[0].package, **where)


def _split(clip: RecordedClip, doctor: SealingKey) -> dict[bytes, GrantUpload]:
    share_key = secrets.token_bytes(32)
    package = seal_package(
        share_key,
        secrets.token_bytes(24),
        bytes(doctor.public_key),
        grantee=GRANTEE,
        record_id=clip.record_id,
        keys=dict(enumerate(clip.data_keys)),
    )
    split = split_share_key(share_key, list(NAMES), [secrets.token_bytes(32) for _ in range(count_masks(2))])
    return {
        who: GrantUpload(
            grant_txid=GRANT_ID,
            parts=parts,
            valid_until_ms=START_MS + 60_000,
            record_id=clip.record_id,
            package=package,
        )
        for who, parts in split.items()
    }


@pytest.fixture
async def league(tmp_path: Path) -> AsyncIterator[League]:
    """Both follow a share, and copy what they hold before it ends."""
    clip, doctor = record_clip(), SealingKey.generate()
    brought = _split(clip, doctor)
    houses = [
        CustodianHarness(lambda place=place: SqliteStore(tmp_path / f"store-{place}"), tmp_path / f"keys-{place}")
        for place in (0, 1)
    ]  # type: ignore[misc]
    async with AsyncExitStack() as stack:
        copies, parts = [], []
        for name, house in zip(NAMES, houses, strict=True):
            custodian = await stack.enter_async_context(house.open())
            custodian._member = name
            await house.keep(clip)
            await custodian.stage_part(brought[name], ALICE)
            await house.follow(granted(clip), asked(clip))
            copies.append(await custodian.look_at(clip.record_id))
            parts.append(custodian._shares.open(await house.store.part(GRANT_ID, clip.record_id)))
        yield League(houses, clip, doctor, copies, parts)


def _opens(league: League, keys: list[bytes], sealing: bytes) -> bool:
    try:
        return league.open_shared(keys, sealing) == dict(enumerate(league.clip.data_keys))
    except BlockRobotError:
        return False


async def test_one_custodian_has_no_key_of_the_package_not_even_with_the_grantee(league: League) -> None:
    assert league.joined(1) == []
    for part in league.parts[0].parts:
        assert not _opens(league, [part.value], bytes(league.doctor))


async def test_two_have_the_key_of_the_package_and_still_open_nothing(league: League) -> None:
    keys = league.joined(2)
    assert len(keys) == 1
    for key in (keys[0], *(part.value for held in league.parts for part in held.parts)):
        assert not _opens(league, keys, key)
    for copy in league.clips:
        for index, frame in enumerate(copy.frames):
            assert frame.ciphertext
            with pytest.raises(BlockRobotError):
                open_frame(keys[0], league.clip.record_id, index, frame.ciphertext)
            with pytest.raises(BlockRobotError):
                open_data_key(keys[0], frame.sealed_key)


@pytest.mark.parametrize("end", ["revoked", "erased"])
async def test_two_and_the_grantee_open_their_copies_after_the_end_and_one_and_the_grantee_do_not(
    league: League, end: str
) -> None:
    """What an honest custodian destroys with the block: of copies kept before it, the chain knows nothing."""
    for house in league.houses:
        await house.follow(revoked() if end == "revoked" else erasure(b"\xe1" * 32, league.clip))
        assert await house.store.part(GRANT_ID, league.clip.record_id) is None
    assert not _opens(league, league.joined(1), bytes(league.doctor))
    keys = league.open_shared(league.joined(2), bytes(league.doctor))
    opened = [
        open_frame(keys[index], league.clip.record_id, index, frame.ciphertext)
        for index, frame in enumerate(league.clips[0].frames)
    ]
    assert opened == list(league.clip.plaintexts)


async def test_one_that_kept_a_copy_can_give_it_back_to_its_owner_and_to_nobody_else(league: League) -> None:
    for house in league.houses:
        await house.follow(erasure(b"\xe1" * 32, league.clip))
    assert read_all(league.clip, league.clips[0]) == list(league.clip.plaintexts)
    with pytest.raises(BlockRobotError):
        open_data_key(bytes(SealingKey.generate()), league.clips[0].frames[0].sealed_key)

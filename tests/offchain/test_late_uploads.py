"""A clip that comes after its record is final, when the custodian fails between keeping it and noting what it owes."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness
from tests.offchain.small_chain import ALICE, RecordedClip, access, erasure, record_clip, recorded


async def keep_half(house: CustodianHarness, monkeypatch: pytest.MonkeyPatch) -> RecordedClip:
    """Upload a clip that is recorded and asked for already; the store fails once the clip itself is kept."""
    clip = record_clip()
    await house.follow(recorded(clip, ALICE))
    await house.follow(access(ACCESS_ID, clip))
    with monkeypatch.context() as patch:

        async def fail(*_arguments: object) -> None:
            raise BlockRobotError("STORE_UNAVAILABLE")

        patch.setattr(house.store, "apply", fail)
        with pytest.raises(BlockRobotError, match="STORE_UNAVAILABLE"):
            await house.custodian.stage(clip.upload)
    return clip


async def require_settled(house: CustodianHarness, clip: RecordedClip) -> None:
    assert (await house.custodian.download(clip.record_id, ACCESS_ID, ALICE)).record_id == clip.record_id
    assert await house.custodian.missing(10) == []
    assert await house.ready_outbox() == [("access.released", [ACCESS_ID, [clip.record_id]])]


async def test_the_robot_that_uploads_again_makes_the_release_owed_after_all(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = await keep_half(opened, monkeypatch)
    for _ in range(2):
        await opened.custodian.stage(clip.upload)
    await require_settled(opened, clip)


async def test_the_next_start_makes_the_release_owed_after_all(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with house.open():
        clip = await keep_half(house, monkeypatch)
    async with house.open():
        await require_settled(house, clip)


async def test_what_is_truly_missing_stays_missing_over_a_start(house: CustodianHarness) -> None:
    clip = record_clip()
    async with house.open():
        await house.follow(recorded(clip, ALICE))
    async with house.open():
        assert [facts.record_id for facts in await house.custodian.missing(10)] == [clip.record_id]
        assert await house.ready_outbox() == []


async def test_frames_that_were_erased_before_the_clip_came_are_not_kept(opened: CustodianHarness) -> None:
    clip = record_clip()
    await opened.follow(recorded(clip, ALICE))
    await opened.follow(erasure(ERASURE_ID, clip, frames=(1,)))
    await opened.custodian.stage(clip.upload)
    places = await opened.store.frame_places([clip.record_id])
    assert sorted(place.index for place in places) == [0, 2]
    assert opened.keys.held == sorted(place.slot for place in places)

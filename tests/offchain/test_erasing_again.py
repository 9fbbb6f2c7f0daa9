"""A store that loses a deletion, as a server that failed over may: it shows, and the next try heals it, no restart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from tests.offchain.house import ERASURE_ID, CustodianHarness, refused
from tests.offchain.small_chain import erasure, record_clip
from tests.offchain.test_sharing import revoked, share


@pytest.mark.parametrize(("loses", "frames"), [("erase_clips", ()), ("erase_frames", (1,))])
async def test_a_deletion_that_the_store_lost_is_done_again_at_the_next_try(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch, loses: str, frames: tuple[int, ...]
) -> None:
    clip, second = await opened.keep(), await opened.keep()
    delete, lost = getattr(opened.store, loses), []

    async def lose_the_first_of_each(named: Any, *more: Any) -> None:
        record_id = named if frames else named[0]
        if record_id not in lost:
            lost.append(record_id)
            return
        await delete(named, *more)

    monkeypatch.setattr(opened.store, loses, lose_the_first_of_each)
    block = opened.chain.block(erasure(ERASURE_ID, clip, frames=frames), erasure(b"\xe2" * 32, second, frames=frames))
    for done in (0, 1):
        await refused("STORE_UNAVAILABLE", opened.custodian.on_finalized_block(block))
        assert len(await opened.ready_outbox()) == done, "nothing is promised before it is done"
    await opened.custodian.on_finalized_block(block)
    receipts = [arguments[:2] for call, arguments in await opened.ready_outbox() if call == "erasure.receipt"]
    gone = len(frames) or len(clip.plaintexts)
    assert receipts == [[ERASURE_ID, gone], [b"\xe2" * 32, gone]]
    assert lost == [clip.record_id, second.record_id]


async def test_a_part_of_a_key_that_the_store_still_returns_stops_the_block(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = record_clip()
    await share(opened, clip)
    block = opened.chain.block(revoked())
    with monkeypatch.context() as patch:

        async def lose(_slots: Any) -> None:
            return

        patch.setattr(opened.store, "erase_parts", lose)
        await refused("STORE_UNAVAILABLE", opened.custodian.on_finalized_block(block))
    await opened.custodian.on_finalized_block(block)
    assert [place async for place in opened.store.all_parts()] == []


async def test_an_erase_key_that_is_still_there_stops_the_block(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = await opened.keep()
    block = opened.chain.block(erasure(ERASURE_ID, clip))
    with monkeypatch.context() as patch:
        patch.setattr(opened.keys, "destroy", lambda _slots: None)
        await refused("ERASE_KEYS_DAMAGED", opened.custodian.on_finalized_block(block))
        assert await opened.ready_outbox() == [], "nothing is promised before it is done"
    await opened.custodian.on_finalized_block(block)
    assert [call for call, _ in await opened.ready_outbox()] == ["erasure.receipt"]


async def test_what_the_state_says_is_erased_is_read_back_too(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = await opened.keep()
    with monkeypatch.context() as patch:

        async def lose(_record_ids: Any) -> None:
            return

        patch.setattr(opened.store, "erase_clips", lose)
        await refused("STORE_UNAVAILABLE", opened.custodian.eraser.erase_again([clip.record_id]))
    await opened.custodian.eraser.erase_again([clip.record_id])
    assert await opened.store.frame_places([clip.record_id]) == []


@pytest.mark.parametrize(("deletes", "frames"), [("erase_clips", ()), ("erase_frames", (1,))])
async def test_no_row_is_deleted_before_its_keys_are_destroyed(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch, deletes: str, frames: tuple[int, ...]
) -> None:
    """A power cut in between leaves bytes that nobody opens, never a key without a row that names it."""
    clip = await opened.keep()
    places = await opened.store.frame_places([clip.record_id])
    slots = [place.slot for place in places if not frames or place.index in frames]
    delete, found = getattr(opened.store, deletes), []

    async def look_first(named: Any, *more: Any) -> None:
        found.extend(opened.keys.read(slot) for slot in slots)
        await delete(named, *more)

    monkeypatch.setattr(opened.store, deletes, look_first)
    await opened.custodian.on_finalized_block(opened.chain.block(erasure(ERASURE_ID, clip, frames=frames)))
    assert found == [None] * len(slots)


@pytest.mark.parametrize("dropped", ["forget", "drop_staged"])
async def test_what_was_never_erased_keeps_its_keys_until_its_rows_are_gone(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch, dropped: str
) -> None:
    """Whoever asks meanwhile gets a whole clip or none."""
    clip = await opened.keep()
    slots = [place.slot for place in await opened.store.frame_places([clip.record_id])]
    delete, found = opened.store.drop_staged, []

    async def look_first(record_ids: Sequence[bytes]) -> None:
        found.extend(opened.keys.read(slot) is not None for slot in slots)
        await delete(record_ids)

    monkeypatch.setattr(opened.store, "drop_staged", look_first)
    eraser = opened.custodian.eraser
    await (eraser.forget(clip.record_id) if dropped == "forget" else eraser.drop_staged([clip.record_id]))
    assert found == [True] * len(slots)
    assert [opened.keys.read(slot) for slot in slots] == [None] * len(slots)

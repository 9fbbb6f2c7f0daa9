"""Crashes of a custodian, at every write: nothing is lost, doubled or left half erased."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from node.custody.stores.custody_store import BlockEffects
from tests.offchain.house import ACCESS_ID, ERASURE_ID, CustodianHarness, read_all, refused
from tests.offchain.small_chain import (
    ALICE,
    EXPIRES_MS,
    START_MS,
    access,
    erasure,
    record_clip,
    recorded,
)


class PowerCutError(Exception):
    """The process ends here."""


WRITES = ["apply", "add_outbox", "erase_clips", "erase_frames", "sweep", "mark_outbox_ready", "drop_staged"]


def cut_power_at(house: CustodianHarness, monkeypatch: pytest.MonkeyPatch, step: int, *, after: bool) -> list[str]:
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
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch, step: int, after: bool
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
                assert len(done) >= step  # MongoDB adds a row by way of `apply`, which is counted as well
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
        told = {call: arguments for call, arguments in await house.ready_outbox() if call != "erasure.receipt"}
        assert told["access.released"] == [ACCESS_ID, [kept.record_id]]
        assert told["erasure.expired"][0] == [expiring.record_id]
        receipts = {
            arguments[0]: arguments[1:3] for call, arguments in await house.ready_outbox() if call == "erasure.receipt"
        }
        assert receipts == {ERASURE_ID: [2, "commitment-leaves"], b"\xe2" * 32: [3, "nothing"]}
        assert len(await house.ready_outbox()) == 4


async def test_keys_of_an_upload_that_a_crash_cut_off_are_destroyed_at_the_next_start(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = record_clip()
    async with house.open() as custodian:

        async def fail(*_: object) -> None:
            raise PowerCutError

        with monkeypatch.context() as patches:
            patches.setattr(house.store, "stage_all", fail)
            with pytest.raises(PowerCutError):
                await custodian.stage(clip.upload)
        assert house.keys.held_count == 3
    async with house.open() as custodian:
        assert house.keys.held_count == 0
        await custodian.stage(clip.upload)
        assert house.keys.held_count == 3


async def test_a_database_from_a_backup_opens_nothing_that_was_erased_since(house: CustodianHarness) -> None:
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
        await house.keep()
        reused = await custodian.export(clip.record_id)
        assert all(frame.sealed_key == b"" for frame in reused.frames)


async def test_missing_rows_survive_what_confirms_other_clips(opened: CustodianHarness) -> None:
    missed, held = record_clip(), record_clip()
    await opened.custodian.stage(held.upload)
    await opened.follow(recorded(missed), recorded(held))
    await opened.store.apply(BlockEffects())
    assert [facts.record_id for facts in await opened.custodian.missing(10)] == [missed.record_id]

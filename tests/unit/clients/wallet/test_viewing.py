"""Seeing a record: what opens, what is called corrupted, what is erased, and whose copy was used."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import msgspec
import pytest

from clients.wallet.commands.view_commands import list_missing_rooms, print_missing_rooms
from clients.wallet.ledger.visit_audit import Finding
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.records.viewing import VERDICT_WHEN_CANCELLED_MAX_S, RecordView, RecordViewer, finding_of
from clients.wallet.store.keystore import KnownVisit
from consensus.errors import BlockRobotError
from tests.miscounting_robot import (
    committing_otherwise,
    committing_to_nothing_readable,
    miscounting,
    sealing_to_somebody_else,
)
from tests.virtual_time import run_virtual
from tests.world.dicts import World


async def one_record(world: World, frames: int = 3) -> RecordEntry:
    world.record(world.open_visit(), frames)
    ((entry,),) = [report.records for report in await world.wallet.records()]
    return entry


async def look(world: World, entry: RecordEntry) -> RecordView:
    viewing = RecordViewer(world.wallet, follow_max_ms=0)
    return await viewing.view(entry, await viewing.request_access([entry], "own-access"))


def statuses(view: RecordView) -> list[str]:
    return [frame.status for frame in view.frames]


async def test_a_whole_record_opens_and_is_verified(world: World) -> None:
    view = await look(world, await one_record(world))
    assert statuses(view) == ["ok", "ok", "ok"]
    assert [frame.rendition.sequence for frame in view.frames if frame.rendition] == [0, 1, 2]
    assert (view.verdict, view.custodians) == ("verified", ("node-1",))


def test_a_custodian_that_follows_late_is_given_time(world: World) -> None:
    async def story() -> RecordView:
        entry = await one_record(world)
        world.network.custody.late_answers = 3
        viewing = RecordViewer(world.wallet)
        return await viewing.view(entry, await viewing.request_access([entry], "own-access"))

    view = run_virtual(story())
    assert (statuses(view), view.custodians) == (["ok", "ok", "ok"], ("node-1",))


async def test_access_is_asked_for_on_the_chain_by_the_owner_key_with_a_purpose(world: World) -> None:
    entry = await one_record(world)
    await look(world, entry)
    (call,) = world.network.calls
    assert call == (entry.visit.owner, "access", "request", [[entry.record_id], "own-access"])


async def test_custodians_are_asked_in_the_owners_session_never_in_the_members(world: World) -> None:
    entry = await one_record(world)
    await look(world, entry)
    assert {key for _, key in world.network.custody.asked} == {entry.visit.owner}


async def test_a_damaged_frame_is_taken_from_the_next_custodian(world: World) -> None:
    entry = await one_record(world)
    world.change_frame("node-1", entry.record_id, 1, ciphertext=b"x" * 200)
    view = await look(world, entry)
    assert statuses(view) == ["ok", "ok", "ok"]
    assert view.custodians == ("node-1", "node-2")


async def test_a_frame_that_nobody_has_whole_is_named_and_the_others_open(world: World) -> None:
    entry = await one_record(world)
    for name in world.network.custody.clips:
        world.change_frame(name, entry.record_id, 1, ciphertext=b"x" * 200)
    view = await look(world, entry)
    assert statuses(view) == ["ok", "corrupted", "ok"]
    assert view.frames[1].rendition is None
    assert (view.verdict, view.corrupted) == ("corrupted", [1])


async def test_two_custodians_with_different_damage_make_one_whole_record(world: World) -> None:
    entry = await one_record(world)
    world.change_frame("node-1", entry.record_id, 0, ciphertext=b"x" * 200)
    world.change_frame("node-2", entry.record_id, 2, sealed_key=b"y" * 80)
    assert statuses(await look(world, entry)) == ["ok", "ok", "ok"]


async def test_another_records_frame_in_the_place_is_corruption(world: World) -> None:
    entry = await one_record(world)
    other = world.record(world.open_visit()).upload
    for name in world.network.custody.clips:
        world.change_frame(name, entry.record_id, 0, ciphertext=other.ciphertexts[0], sealed_key=other.sealed_keys[0])
    assert statuses(await look(world, entry)) == ["corrupted", "ok", "ok"]


async def test_erased_frames_keep_their_place(world: World) -> None:
    entry = await one_record(world)
    for name in world.network.custody.clips:
        world.change_frame(name, entry.record_id, 0, erased=True, ciphertext=b"", sealed_key=b"")
    entry = replace(entry, state=msgspec.structs.replace(entry.state, erased_frames=[0]))
    view = await look(world, entry)
    assert statuses(view) == ["erased", "ok", "ok"]
    assert view.verdict == "verified"


async def test_a_custodian_cannot_pass_off_as_erased_what_the_chain_does_not_call_erased(world: World) -> None:
    """It would be an easy way to withhold a picture: the next custodian is asked, and then it is called corrupted."""
    entry = await one_record(world)
    world.change_frame("node-1", entry.record_id, 0, erased=True, ciphertext=b"", sealed_key=b"")
    assert statuses(await look(world, entry)) == ["ok", "ok", "ok"]
    world.change_frame("node-2", entry.record_id, 0, erased=True, ciphertext=b"", sealed_key=b"")
    assert statuses(await look(world, entry)) == ["corrupted", "ok", "ok"]


async def test_leaves_that_do_not_lead_to_the_chains_roots_are_no_clip(world: World) -> None:
    entry = await one_record(world)
    entry = replace(entry, state=msgspec.structs.replace(entry.state, ciphertext_root=bytes(32)))
    with pytest.raises(BlockRobotError, match=r"^PROOF_INVALID:"):
        await look(world, entry)


async def test_one_custodian_that_refuses_is_not_the_end(world: World) -> None:
    entry = await one_record(world)
    world.network.custody.refusals["node-1"] = "STORE_UNAVAILABLE"
    view = await look(world, entry)
    assert (statuses(view), view.custodians) == (["ok", "ok", "ok"], ("node-2",))


async def test_if_all_refuse_their_reason_is_told(world: World) -> None:
    entry = await one_record(world)
    world.network.custody.refusals.update({"node-1": "NODE_UNREACHABLE", "node-2": "ACCESS_NOT_GRANTED"})
    with pytest.raises(BlockRobotError, match=r"^ACCESS_NOT_GRANTED:"):
        await look(world, entry)


@pytest.mark.parametrize(("counted", "committed"), [(5, 1), (1, 3)])
async def test_a_record_of_which_the_robot_counted_others_than_it_committed_to_is_not_verified(
    world: World, monkeypatch: pytest.MonkeyPatch, counted: int, committed: int
) -> None:
    """No custodian can cause it: the root holds the number of leaves. What there is opens, and the verdict says it.

    It names no picture: of those that there are none is wrong, and those that are not there have no number.
    """
    miscounting(monkeypatch, counted)
    entry = await one_record(world, committed)
    view = await look(world, entry)
    assert statuses(view) == ["ok"] * committed
    assert (view.frames_counted, view.corrupted, view.miscounted) == (counted, [], True)
    assert view.verdict == "corrupted"
    await RecordViewer(world.wallet).put_verdicts(entry.visit, [finding_of(view)])
    assert world.network.calls[-1] == (entry.visit.owner, "access", "verdict", [[[entry.record_id, "corrupted", []]]])


async def test_of_a_picture_that_custodians_changed_only_the_bytes_are_known_to_be_wrong(world: World) -> None:
    entry = await one_record(world)
    for name in world.network.custody.clips:
        world.change_frame(name, entry.record_id, 1, ciphertext=b"x" * 200)
    view = await look(world, entry)
    assert ([frame.failed for frame in view.frames], view.damaged) == (["", "ciphertext", ""], [1])


async def test_a_picture_that_is_kept_back_as_erased_was_not_handed_out(world: World) -> None:
    entry = await one_record(world)
    for name in world.network.custody.clips:
        world.change_frame(name, entry.record_id, 0, erased=True, ciphertext=b"", sealed_key=b"")
    view = await look(world, entry)
    assert ([frame.failed for frame in view.frames], view.damaged) == (["released", "", ""], [0])


async def test_of_a_robot_that_committed_to_another_picture_no_custodian_is_blamed(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    committing_otherwise(monkeypatch, 1)
    entry = await one_record(world)
    view = await look(world, entry)
    assert (statuses(view), view.damaged) == (["ok", "corrupted", "ok"], [])
    assert [frame.failed for frame in view.frames] == ["", "commitment", ""]


async def test_a_custodian_that_changes_bytes_too_does_not_hide_that_the_robot_committed_to_another_picture(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    committing_otherwise(monkeypatch, 1)
    entry = await one_record(world)
    world.change_frame("node-2", entry.record_id, 1, ciphertext=b"x" * 200)
    assert [frame.failed for frame in (await look(world, entry)).frames] == ["", "commitment", ""]


async def test_keys_that_the_robot_sealed_to_somebody_else_do_not_open(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    sealing_to_somebody_else(monkeypatch)
    view = await look(world, await one_record(world, 1))
    assert ([frame.failed for frame in view.frames], view.damaged) == (["decrypted"], [])


async def test_what_the_robot_committed_to_may_be_nothing_that_can_be_read(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    committing_to_nothing_readable(monkeypatch)
    view = await look(world, await one_record(world, 1))
    assert ([frame.failed for frame in view.frames], view.damaged) == (["rendition"], [])


async def test_a_custodian_that_sends_fewer_leaves_makes_no_miscounted_record_but_none(world: World) -> None:
    entry = await one_record(world)
    for clips in world.network.custody.clips.values():
        clip = clips[entry.record_id]
        clips[entry.record_id] = msgspec.structs.replace(
            clip,
            frames=clip.frames[:2],
            commitment_leaves=clip.commitment_leaves[:2],
            ciphertext_leaves=clip.ciphertext_leaves[:2],
        )
    with pytest.raises(BlockRobotError, match=r"^PROOF_INVALID:"):
        await look(world, entry)


async def test_the_verdict_goes_on_the_chain_with_the_frames_it_is_about(world: World) -> None:
    entry = await one_record(world)
    for name in world.network.custody.clips:
        world.change_frame(name, entry.record_id, 2, ciphertext=b"x" * 200)
    await RecordViewer(world.wallet).put_verdicts(entry.visit, [finding_of(await look(world, entry))])
    assert world.network.calls[-1] == (entry.visit.owner, "access", "verdict", [[[entry.record_id, "corrupted", [2]]]])


def looking(world: World, monkeypatch: pytest.MonkeyPatch, verdicts: list[str], refusal: str = "") -> RecordViewer:
    """A look whose verdicts the test takes; with a `refusal` they are refused."""
    viewing = RecordViewer(world.wallet, follow_max_ms=0)

    async def put(visit: KnownVisit, findings: list[Finding]) -> None:
        verdicts.append("tried")
        if refusal == "NEVER":
            await asyncio.sleep(3600)
        if refusal:
            raise BlockRobotError(refusal)
        verdicts.append("put")

    monkeypatch.setattr(viewing, "put_verdicts", put)
    return viewing


async def test_a_verdict_that_is_refused_does_not_hide_why_the_look_failed(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry, tried = await one_record(world), list[str]()
    viewing = looking(world, monkeypatch, tried, "CALL_REFUSED")

    async def erased(*_: object) -> RecordView:
        raise BlockRobotError("CLIP_ERASED")

    with pytest.raises(BlockRobotError, match="CALL_REFUSED"):
        _ = [view async for view in viewing.view_each([entry], "own-access", verdict=True)]
    monkeypatch.setattr(viewing, "view", erased)
    with pytest.raises(BlockRobotError) as refusal:
        _ = [view async for view in viewing.view_each([entry], "own-access", verdict=True)]
    assert (refusal.value.code, tried) == ("CLIP_ERASED", ["tried", "tried"])


@pytest.mark.parametrize("refusal", ["", "NODE_UNREACHABLE", "NEVER"])
def test_who_is_cancelled_waits_for_a_verdict_shortly_and_is_cancelled(
    world: World, monkeypatch: pytest.MonkeyPatch, refusal: str
) -> None:
    tried: list[str] = []

    async def story() -> None:
        entry = await one_record(world)
        viewing = looking(world, monkeypatch, tried, refusal)

        async def wait(*_: object) -> RecordView:
            await asyncio.sleep(3600)
            raise AssertionError

        monkeypatch.setattr(viewing, "view", wait)

        async def run() -> None:
            _ = [view async for view in viewing.view_each([entry], "own-access", verdict=True)]

        task, loop = asyncio.create_task(run()), asyncio.get_running_loop()
        await asyncio.sleep(1)
        task.cancel()
        begun = loop.time()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert loop.time() - begun <= VERDICT_WHEN_CANCELLED_MAX_S + 0.1

    run_virtual(story())
    assert tried == ["tried"] + ["put"] * (not refusal)


def test_why_pictures_are_shown_without_the_room_is_told_once_for_each_reason(
    capsys: pytest.CaptureFixture[str],
) -> None:
    missing = {
        bytes([number]) * 32: BlockRobotError(code)
        for number, code in enumerate(["EMPTY_FRAME_WITHDRAWN", "EMPTY_FRAME_WITHDRAWN", "NODE_UNREACHABLE"])
    }
    print_missing_rooms(missing)
    told = " ".join(capsys.readouterr().out.split())
    assert (told.count("show the person alone, without the room"), told.count("was withdrawn")) == (2, 1)
    assert [room.code for room in list_missing_rooms(missing)][2] == "NODE_UNREACHABLE"

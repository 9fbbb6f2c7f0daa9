"""How much robots may bring: counted in every store, over restarts and crashes, and refused before a byte is kept."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, ExitStack
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.limits import DAY_MS, MIB_BYTES
from consensus.records.clips import ClipUpload
from consensus.state.settings import UploadQuotas
from network.custody.custody_text import find_upload_problems
from node.custody.coordination.custody_answers import UploadReport
from node.custody.coordination.upload_admission import (
    UPLOADS_OF_CONTENT_MAX_COUNT,
    UPLOADS_OF_ROBOT_MAX_COUNT,
    UploadAdmission,
)
from node.custody.coordination.upload_report import LATELY_S, RefusedUploads, describe_uploads
from node.custody.stores.custody_store import CustodyStore
from node.custody.uploads.upload_usage import DayUse, UploadTerms, Use, find_day, require_quota
from node.ledger.ledger_writer import FinalityFeed
from node.limits.disk_reserve import DiskReserve
from node.storage.memory_store import MemoryStore
from tests.offchain.house import ERASURE_ID, CustodianHarness, refused
from tests.offchain.small_chain import ALICE, START_MS, erasure, record_clip, recorded

ROBOT, SECOND, STRANGER = b"\x02" + b"r" * 32, b"\x02" + b"s" * 32, b"\x02" + b"x" * 32
ORGANISATIONS = {ROBOT: "hospital", SECOND: "hospital", STRANGER: "university"}


def terms(robot: bytes = ROBOT, **quotas: int) -> UploadTerms:
    return UploadTerms(robot, UploadQuotas(**quotas), lambda each: ORGANISATIONS.get(each, ""), lambda each: each)


def size_of(upload: ClipUpload) -> int:
    return sum(map(len, upload.ciphertexts)) + sum(map(len, upload.sealed_keys))


async def test_a_robot_has_so_many_clips_staged_and_more_once_they_are_recorded(opened: CustodianHarness) -> None:
    allowed = terms(robot_staged_max_count=2)
    first, second, third = (record_clip() for _ in range(3))
    await opened.custodian.stage(first.upload, allowed)
    await opened.custodian.stage(second.upload, allowed)
    held = opened.keys.held_count
    await refused("UPLOAD_QUOTA_EXCEEDED", opened.custodian.stage(third.upload, allowed))
    assert opened.keys.held_count == held, "a refused upload leaves no key behind"
    assert await opened.store.clips([third.record_id]) == {}
    await opened.custodian.stage(first.upload, allowed)  # again: it is there already
    assert await opened.store.use_by_robot("staged") == {ROBOT: Use(2, size_of(first.upload) + size_of(second.upload))}
    await opened.follow(recorded(first))
    await opened.custodian.stage(third.upload, allowed)
    assert {robot: use.count for robot, use in (await opened.store.use_by_robot("confirmed")).items()} == {ROBOT: 1}


async def test_staged_clips_that_lapse_make_room_again_and_erased_ones_are_nobodys(opened: CustodianHarness) -> None:
    allowed = terms(robot_staged_max_count=1)
    lapsing = msgspec.structs.replace(record_clip().upload, valid_until_ms=START_MS + 50_000)
    await opened.custodian.stage(lapsing, allowed)
    await refused("UPLOAD_QUOTA_EXCEEDED", opened.custodian.stage(record_clip().upload, allowed))
    await opened.follow(at_ms=START_MS + 50_000)
    clip = record_clip()
    await opened.custodian.stage(clip.upload, allowed)
    await opened.follow(recorded(clip), erasure(ERASURE_ID, clip))
    assert await opened.store.use_by_robot("staged") == await opened.store.use_by_robot("confirmed") == {}
    assert set(await opened.store.use_by_robot("erased")) == {b""}


async def test_what_a_robot_brings_a_day_is_counted_by_block_time_and_survives_a_restart(
    house: CustodianHarness,
) -> None:
    clips = [record_clip(valid_until_ms=START_MS + 2 * DAY_MS) for _ in range(3)]
    size = size_of(clips[0].upload)
    async with house.open() as custodian:
        await house.follow(at_ms=START_MS)
        day = find_day(START_MS)
        await house.store.add_use(DayUse(day, ROBOT, MIB_BYTES - size))
        await custodian.stage(
            msgspec.structs.replace(clips[0].upload, valid_until_ms=START_MS + 60_000), terms(robot_day_max_mib=1)
        )
    async with house.open() as custodian:
        assert await house.store.day_uses() == [DayUse(day, ROBOT, MIB_BYTES)]
        late = msgspec.structs.replace(clips[1].upload, valid_until_ms=START_MS + 60_000)
        with pytest.raises(BlockRobotError) as refusal:
            await custodian.stage(late, terms(robot_day_max_mib=1))
        assert refusal.value.code == "UPLOAD_QUOTA_EXCEEDED"
        assert refusal.value.context["retry_after_s"] == (DAY_MS - START_MS % DAY_MS) // 1000 + 1
        await custodian.stage(late, terms(SECOND, robot_day_max_mib=1))
        await house.follow(at_ms=START_MS + DAY_MS)
        tomorrow = msgspec.structs.replace(clips[2].upload, valid_until_ms=START_MS + DAY_MS + 60_000)
        await custodian.stage(tomorrow, terms(robot_day_max_mib=1))
        assert DayUse(day + 1, ROBOT, size_of(tomorrow)) in await house.store.day_uses()


async def test_an_organisations_robots_are_counted_together_and_others_apart(opened: CustodianHarness) -> None:
    await opened.custodian.stage(record_clip().upload, terms(ROBOT))
    both = terms(SECOND, organisation_staged_max_count=1)
    await refused("UPLOAD_QUOTA_EXCEEDED", opened.custodian.stage(record_clip().upload, both))
    await opened.custodian.stage(record_clip().upload, terms(STRANGER, organisation_staged_max_count=1))
    await opened.custodian.stage(record_clip().upload, terms(SECOND, robot_staged_max_count=1))


@pytest.mark.parametrize(
    ("quotas", "staged", "days", "size", "is_refused"),
    [
        ({"robot_staged_max_mib": 1}, {ROBOT: Use(1, MIB_BYTES - 5)}, [], 5, False),
        ({"robot_staged_max_mib": 1}, {ROBOT: Use(1, MIB_BYTES - 5)}, [], 6, True),
        ({"robot_staged_max_mib": 1}, {SECOND: Use(1, MIB_BYTES)}, [], 6, False),
        ({"organisation_staged_max_mib": 1}, {SECOND: Use(1, MIB_BYTES)}, [], 6, True),
        ({"organisation_staged_max_mib": 1}, {b"": Use(9, 9 * MIB_BYTES)}, [], 6, False),
        ({"robot_day_max_mib": 1}, {}, [DayUse(0, ROBOT, MIB_BYTES)], 1, True),
        ({"robot_day_max_mib": 1}, {}, [DayUse(-1, ROBOT, MIB_BYTES)], 1, False),
        ({"organisation_day_max_mib": 1}, {}, [DayUse(0, SECOND, MIB_BYTES)], 1, True),
        ({"organisation_day_max_mib": 1}, {}, [DayUse(0, STRANGER, MIB_BYTES)], 1, False),
        ({"robot_staged_max_count": 1}, {ROBOT: Use(1, 1)}, [], 1, True),
    ],
)
def test_each_quota_refuses_from_the_first_byte_too_many(
    quotas: dict[str, int], staged: dict[bytes, Use], days: list[DayUse], size: int, is_refused: bool
) -> None:
    if not is_refused:
        require_quota(size, terms(**quotas), staged, days, 5)
        return
    with pytest.raises(BlockRobotError) as refusal:
        require_quota(size, terms(**quotas), staged, days, 5)
    assert refusal.value.code == "UPLOAD_QUOTA_EXCEEDED"
    assert next(iter(quotas)) in refusal.value.detail
    assert int(refusal.value.context["retry_after_s"]) > 0


async def test_days_are_kept_for_the_trend_and_no_longer(store: CustodyStore) -> None:
    for day in range(20):
        await store.add_use(DayUse(day, ROBOT, 10))
        await store.add_use(DayUse(day, SECOND, 1))
        await store.add_use(DayUse(day, ROBOT, 5))
    assert await store.day_uses() == [
        use for day in range(11, 20) for use in (DayUse(day, ROBOT, 15), DayUse(day, SECOND, 1))
    ]


def test_a_custodian_that_does_not_know_the_chain_yet_blames_no_robot() -> None:
    has_followed = False
    refusals = RefusedUploads(lambda: 5.0, has_followed=lambda: has_followed)

    def refuse(code: str) -> dict[str, int]:
        with pytest.raises(BlockRobotError), refusals.noted(ROBOT):
            raise BlockRobotError(code)
        return refusals.lately(ROBOT)

    assert refuse("VISIT_NOT_OPEN") == {}
    assert refuse("EMPTY_FRAME_NOT_APPROVED") == {}
    assert refuse("UPLOAD_QUOTA_EXCEEDED") == {"UPLOAD_QUOTA_EXCEEDED": 1}
    has_followed = True
    assert refuse("VISIT_NOT_OPEN") == {"UPLOAD_QUOTA_EXCEEDED": 1, "VISIT_NOT_OPEN": 1}


async def test_an_operator_is_told_of_each_robot_the_trend_and_what_is_left(
    store: CustodyStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    today = 100
    for day, size in ((97, 30 * MIB_BYTES), (99, 60 * MIB_BYTES), (today, MIB_BYTES)):
        await store.add_use(DayUse(day, ROBOT, size))
    room, now = {"free": 1_324}, {"s": 5.0}
    refusals = RefusedUploads(lambda: now["s"])
    for _ in range(3):
        with pytest.raises(BlockRobotError), refusals.noted(SECOND):
            raise BlockRobotError("VISIT_NOT_OPEN")
    fake = lambda _folder: SimpleNamespace(f_bavail=room["free"], f_frsize=MIB_BYTES)  # noqa: E731
    monkeypatch.setattr(os, "statvfs", fake)
    organisation_of: Callable[[bytes], str] = lambda robot: ORGANISATIONS[robot]  # noqa: E731

    async def ask(*, counts_held: bool = True, **quotas: int) -> UploadReport:
        reserve = DiskReserve(tmp_path, 1_024)
        parts = (today * DAY_MS, UploadQuotas(**quotas), organisation_of, refusals, reserve)
        return await describe_uploads(store, *parts, counts_held=counts_held)

    told = await ask()
    rows = [msgspec.to_builtins(each.uploads) for each in (told, await ask(counts_held=False))]
    assert [{"held_clips", "held_bytes"} & row.keys() for of in rows for row in of[:1]] == [
        {"held_clips", "held_bytes"},
        set(),
    ], "what was not counted is not said to be 0"
    assert told.bytes_a_day == 30 * MIB_BYTES
    assert told.days_until_reserve == 10.0
    assert [(row.organisation, row.bytes_a_day, row.today_bytes, row.refused) for row in told.uploads] == [
        ("hospital", 30 * MIB_BYTES, MIB_BYTES, 0),
        ("hospital", 0, 0, 3),
    ]
    assert [code for code, _ in find_upload_problems(told)] == ["UPLOADS_REFUSED"]
    assert [code for code, _ in find_upload_problems(await ask(robot_day_max_mib=1))] == [
        "UPLOAD_QUOTA_NEAR",
        "UPLOADS_REFUSED",
    ]
    now["s"] += 2 * LATELY_S
    assert [code for code, _ in find_upload_problems(await ask())] == [], "it is over, and nobody is warned for ever"
    assert (await ask()).uploads[1].refused == 3
    room["free"] = 1_100
    assert "DISK_FILLS_UP" in [code for code, _ in find_upload_problems(await ask())]
    room["free"] = 1_000
    assert "UPLOADS_PAUSED" in [code for code, _ in find_upload_problems(await ask())]


def test_the_reserve_is_not_used_and_none_is_kept_back_if_it_is_zero(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = tmp_path / "clips"
    room = {tmp_path: 10, clips: 5}
    monkeypatch.setattr(os, "statvfs", lambda folder: SimpleNamespace(f_bavail=room[folder], f_frsize=MIB_BYTES))
    DiskReserve(tmp_path, 10).require(0)
    DiskReserve(tmp_path, 0).require(100 * MIB_BYTES)
    with pytest.raises(BlockRobotError, match=r"^DISK_RESERVE_REACHED:"):
        DiskReserve(tmp_path, 10).require(1)
    assert not DiskReserve(tmp_path, 10).is_reached
    assert DiskReserve(tmp_path, 11).is_reached
    assert DiskReserve(tmp_path, 10, clips).is_reached, "the clips' own disk is the fuller one"
    assert not DiskReserve(tmp_path, 5, clips).is_reached
    monkeypatch.undo()
    with pytest.raises(BlockRobotError, match=r"^DISK_RESERVE_REACHED: 0 MiB are free"):
        DiskReserve(tmp_path, 1, tmp_path / "unmounted").require(1)


async def test_a_fetched_clip_counts_for_no_robot(opened: CustodianHarness) -> None:
    await opened.keep()
    assert set(await opened.store.use_by_robot("confirmed")) == {b""}
    assert await opened.store.day_uses() == []


@pytest.mark.parametrize(
    ("quotas", "in_flight", "is_refused"),
    [
        ({"robot_staged_max_count": 2}, {ROBOT: Use(1, 5)}, False),
        ({"robot_staged_max_count": 2}, {ROBOT: Use(2, 5)}, True),
        ({"robot_staged_max_mib": 1}, {ROBOT: Use(1, MIB_BYTES)}, True),
        ({"robot_day_max_mib": 1}, {ROBOT: Use(1, MIB_BYTES)}, True),
        ({"robot_day_max_mib": 1}, {SECOND: Use(1, MIB_BYTES)}, False),
        ({"organisation_staged_max_mib": 1}, {SECOND: Use(1, MIB_BYTES)}, True),
        ({"organisation_day_max_mib": 1}, {SECOND: Use(1, MIB_BYTES)}, True),
        ({"organisation_day_max_mib": 1}, {STRANGER: Use(1, MIB_BYTES)}, False),
    ],
)
def test_what_is_on_its_way_counts_as_if_it_were_there(
    quotas: dict[str, int], in_flight: dict[bytes, Use], is_refused: bool
) -> None:
    if not is_refused:
        require_quota(1, terms(**quotas), {}, [], 5, in_flight)
        return
    with pytest.raises(BlockRobotError, match="UPLOAD_QUOTA_EXCEEDED"):
        require_quota(1, terms(**quotas), {}, [], 5, in_flight)


def admitting(
    house: CustodianHarness, monkeypatch: pytest.MonkeyPatch, reserve: DiskReserve | None = None
) -> UploadAdmission:
    """What lets uploads in of visits that are all open, two clips of each robot at a time."""
    hold = None if reserve is None else reserve.hold
    admission = UploadAdmission(MemoryStore(), FinalityFeed(-1), house.custodian, hold)
    monkeypatch.setattr("node.custody.coordination.upload_admission.may_upload", lambda *_: True)
    monkeypatch.setattr(admission, "read_terms", lambda robot: terms(robot, robot_staged_max_count=2))
    return admission


async def test_uploads_on_their_way_fit_the_disk_and_the_quota_together(
    opened: CustodianHarness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Many that began at once were each judged against what lay there, and together used the reserve."""
    reserve = DiskReserve(tmp_path, 1)
    monkeypatch.setattr(DiskReserve, "free_bytes", property(lambda _: 5 * MIB_BYTES))
    admission, number = admitting(opened, monkeypatch, reserve), iter(range(9))

    def come(robot: bytes) -> AbstractAsyncContextManager[None]:
        return admission.clip(bytes([next(number)]) * 16, ALICE, MIB_BYTES, robot)

    async def be_refused(robot: bytes, code: str) -> None:
        with pytest.raises(BlockRobotError, match=code):
            async with come(robot):
                pass

    async with come(ROBOT):
        async with come(ROBOT):
            await be_refused(ROBOT, "UPLOAD_QUOTA_EXCEEDED")
            async with come(STRANGER), come(STRANGER):
                await be_refused(SECOND, "DISK_RESERVE_REACHED")
                assert not reserve.has_room(1)
        assert (admission.in_flight, reserve.has_room(3 * MIB_BYTES)) == ({ROBOT: Use(1, MIB_BYTES)}, True)
        async with come(ROBOT):
            pass
    assert (admission.in_flight, reserve.has_room(4 * MIB_BYTES)) == ({}, True)
    assert dict(admission.refused.counts) == {ROBOT: 1, SECOND: 1}


async def _let_in_as_often_as_possible(
    held: AsyncExitStack, come: Callable[[int], AbstractAsyncContextManager[None]]
) -> tuple[int, str]:
    """Return how many were let in at once, and the code by which the next one was refused."""
    for count in range(1_000):
        try:
            await held.enter_async_context(come(count))
        except BlockRobotError as error:
            return count, error.code
    raise AssertionError("there is no bound")


async def test_a_known_clip_that_comes_again_and_again_takes_no_room_and_few_places(
    opened: CustodianHarness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It needs none, since it is here: one robot held the whole disk with many repeats of one old clip."""
    reserve = DiskReserve(tmp_path, 1)
    monkeypatch.setattr(DiskReserve, "free_bytes", property(lambda _: 40 * MIB_BYTES))
    admission, clips = admitting(opened, monkeypatch, reserve), [record_clip() for _ in range(30)]
    for clip in clips:
        await opened.custodian.stage(clip.upload, None)
    async with AsyncExitStack() as held:
        known = clips[0].record_id
        repeated = await _let_in_as_often_as_possible(
            held, lambda _: admission.clip(known, ALICE, 16 * MIB_BYTES, ROBOT)
        )
        assert repeated == (UPLOADS_OF_CONTENT_MAX_COUNT, "RATE_LIMITED")
        several = await _let_in_as_often_as_possible(
            held, lambda n: admission.clip(clips[1 + n].record_id, ALICE, 16 * MIB_BYTES, ROBOT)
        )
        assert several == (UPLOADS_OF_ROBOT_MAX_COUNT - UPLOADS_OF_CONTENT_MAX_COUNT, "RATE_LIMITED")
        assert reserve.has_room(39 * MIB_BYTES)
        async with admission.clip(bytes(16), ALICE, 16 * MIB_BYTES, STRANGER):
            pass
    async with admission.clip(known, ALICE, 16 * MIB_BYTES, ROBOT) as is_new:
        assert not is_new


async def test_a_clip_that_is_dropped_while_it_comes_again_takes_no_room_that_was_not_kept_for_it(
    opened: CustodianHarness,
) -> None:
    clip = record_clip()
    await refused("STORE_UNAVAILABLE", opened.custodian.stage(clip.upload, is_new=False))
    assert (await opened.store.clips([clip.record_id]), opened.keys.held_count) == ({}, 0)
    await opened.custodian.stage(clip.upload)
    await opened.custodian.stage(clip.upload, is_new=False)


async def test_no_robot_alone_holds_the_whole_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reserve = DiskReserve(tmp_path, 1)
    monkeypatch.setattr(DiskReserve, "free_bytes", property(lambda _: 11 * MIB_BYTES))
    with ExitStack() as held:
        for _ in range(5):
            held.enter_context(reserve.hold(ROBOT, MIB_BYTES))
        with pytest.raises(BlockRobotError, match=r"DISK_RESERVE_REACHED.*half"):
            held.enter_context(reserve.hold(ROBOT, MIB_BYTES))
        held.enter_context(reserve.hold(STRANGER, 5 * MIB_BYTES))
        assert not reserve.has_room(1)
    with reserve.hold(ROBOT, 10 * MIB_BYTES):
        assert not reserve.has_room(1), "one upload may be as large as what is left"


async def test_a_clip_that_is_here_already_is_let_in_at_a_full_quota(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its robot did not hear the answer, and brings it again."""
    clips, admission = [record_clip() for _ in range(3)], admitting(opened, monkeypatch)
    for clip in clips[:2]:
        await opened.custodian.stage(clip.upload, terms())
    async with admission.clip(clips[0].record_id, ALICE, 10, ROBOT):
        assert admission.in_flight == {}
    with pytest.raises(BlockRobotError, match="UPLOAD_QUOTA_EXCEEDED"):
        async with admission.clip(clips[2].record_id, ALICE, 10, ROBOT):
            pass

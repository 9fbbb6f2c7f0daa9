"""Uploads that wait for the custodian together are written together, and each is judged as if it came alone."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Sequence
from dataclasses import replace

import pytest

from consensus.errors import BlockRobotError
from node.custody.stores.custody_store import BlockEffects, ClipRow, FrameRow
from node.custody.uploads.upload_queue import (
    WRITTEN_TOGETHER_MAX_BYTES,
    WRITTEN_TOGETHER_MAX_COUNT,
    PendingUpload,
    UploadQueue,
)
from node.custody.uploads.upload_usage import UploadTerms, Use
from tests.offchain.house import ACCESS_ID, CustodianHarness, read_all
from tests.offchain.interleaving import CountedLock
from tests.offchain.small_chain import ALICE, RecordedClip, access, record_clip, recorded
from tests.offchain.test_uploads import ROBOT, SECOND, size_of, terms

Told = list[str]


@pytest.fixture
def writes(opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch) -> list[list[bytes]]:
    """The records of each write of clips."""
    noted, original = list[list[bytes]](), opened.store.stage_all

    async def stage_all(clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> None:
        noted.append([clip.record_id for clip, _ in clips])
        await original(clips)

    monkeypatch.setattr(opened.store, "stage_all", stage_all)
    return noted


async def told(work: Awaitable[None]) -> str:
    try:
        await work
    except BlockRobotError as error:
        return error.code
    return "kept"


async def upload_together(
    house: CustodianHarness, *uploads: tuple[RecordedClip, UploadTerms], meanwhile: BlockEffects | None = None
) -> Told:
    """Keep the custodian busy until all wait for it; `meanwhile` happens then."""
    news = asyncio.Event()
    house.custodian._writing = lock = CountedLock(news)
    async with lock:
        tasks = [asyncio.create_task(told(house.custodian.stage(clip.upload, allowed))) for clip, allowed in uploads]
        while lock.waiting < len(uploads):
            news.clear()
            await news.wait()
        if meanwhile is not None:
            await house.store.apply(meanwhile)
    return await asyncio.gather(*tasks)


async def test_uploads_that_wait_are_one_write(opened: CustodianHarness, writes: list[list[bytes]]) -> None:
    clips = [record_clip() for _ in range(WRITTEN_TOGETHER_MAX_COUNT)]
    assert set(await upload_together(opened, *((clip, terms()) for clip in clips))) == {"kept"}
    assert [sorted(write) for write in writes] == [sorted(clip.record_id for clip in clips)]
    assert [use.size_bytes for use in await opened.store.day_uses()] == [sum(size_of(clip.upload) for clip in clips)]
    await opened.follow(*(recorded(clip) for clip in clips))
    await opened.follow(access(ACCESS_ID, *clips))
    for clip in clips:
        assert read_all(clip, await opened.custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(
            clip.plaintexts
        )


async def test_the_same_clip_twice_is_kept_once_and_both_are_told_so(
    opened: CustodianHarness, writes: list[list[bytes]]
) -> None:
    clip, other = record_clip(), record_clip()
    assert await upload_together(opened, (clip, terms()), (clip, terms()), (other, terms())) == ["kept"] * 3
    assert sorted(record_id for write in writes for record_id in write) == sorted((clip.record_id, other.record_id))
    assert opened.keys.held_count == len(clip.plaintexts) + len(other.plaintexts)
    assert (await opened.store.use_by_robot("staged"))[ROBOT].count == 2


async def test_a_quota_counts_those_that_are_let_in_beside(opened: CustodianHarness) -> None:
    clips = [record_clip() for _ in range(5)]
    few, own = terms(robot_staged_max_count=2), terms(SECOND)
    uploads = [(clips[0], few), (clips[1], few), (clips[2], few), (clips[3], own), (clips[4], few)]
    codes = await upload_together(opened, *uploads)
    refused = "UPLOAD_QUOTA_EXCEEDED"
    kept = {code: codes.count(code) for code in codes}
    assert kept == {"kept": 3, refused: 2}
    assert codes[3] == "kept"
    assert opened.keys.held_count == 9, "the refused left keys behind"
    assert {robot: use.count for robot, use in (await opened.store.use_by_robot("staged")).items()} == {
        ROBOT: 2,
        SECOND: 1,
    }


async def test_clips_that_are_awaited_by_then_are_judged_and_released(opened: CustodianHarness) -> None:
    right, wrong, early = (record_clip() for _ in range(3))
    awaited = [record_clip(), record_clip()]
    await opened.follow(*(recorded(clip) for clip in awaited))
    facts = {row.record_id: row for row in await opened.custodian.missing(10)}
    first = facts[awaited[0].record_id]
    roots = {clip.record_id: recorded(clip)[2] for clip in (right, wrong)}
    recorded_since = [
        replace(
            first,
            record_id=clip.record_id,
            commitment_root=roots[clip.record_id]["commitment_root"],
            ciphertext_root=b"\x01" * 32 if clip is wrong else roots[clip.record_id]["ciphertext_root"],
        )
        for clip in (right, wrong)
    ]
    uploads = [(clip, terms()) for clip in (wrong, early, right)]
    codes = await upload_together(opened, *uploads, meanwhile=BlockEffects(missing=tuple(recorded_since)))
    assert codes == ["UPLOAD_HASH_MISMATCH", "kept", "kept"]
    rows = await opened.store.clips([clip.record_id for clip, _ in uploads])
    assert {key: row.status for key, row in rows.items()} == {
        right.record_id: "confirmed",
        early.record_id: "staged",
    }
    assert opened.keys.held_count == len(right.plaintexts) + len(early.plaintexts)


async def test_a_store_that_fails_refuses_all_that_it_was_to_write_and_takes_them_afterwards(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = [record_clip() for _ in range(3)]

    async def fail(*_arguments: object) -> None:
        raise BlockRobotError("STORE_UNAVAILABLE")

    with monkeypatch.context() as patch:
        patch.setattr(opened.store, "stage_all", fail)
        uploads = [(clip, terms()) for clip in clips]
        assert await upload_together(opened, *uploads) == ["STORE_UNAVAILABLE"] * 3
    assert await upload_together(opened, *uploads) == ["kept"] * 3
    assert (await opened.store.use_by_robot("staged")) == {ROBOT: Use(3, sum(size_of(clip.upload) for clip in clips))}


def pending(size_bytes: int = 1, record_id: bytes = b"") -> PendingUpload:
    clip = record_clip(1)
    row = ClipRow(record_id or clip.record_id, b"t" * 32, 1, "staged", (), (), size_bytes=size_bytes)
    return PendingUpload(row, (), None)


class Written:
    """A queue whose writes end when the test says so."""

    def __init__(self) -> None:
        self.writes: list[list[PendingUpload]] = []
        self.go_on = asyncio.Event()
        self.lock = asyncio.Lock()
        self.queue = UploadQueue(self._write)

    async def _write(self, uploads: Sequence[PendingUpload]) -> None:
        self.writes.append(list(uploads))
        await self.go_on.wait()

    async def keep(self, uploads: Sequence[PendingUpload]) -> list[asyncio.Task[str]]:
        async with self.lock:
            tasks = [asyncio.create_task(told(self.queue.keep(upload, self.lock))) for upload in uploads]
            await asyncio.sleep(0)
        await asyncio.sleep(0)
        return tasks


@pytest.mark.parametrize(
    ("sizes", "writes"),
    [
        ([1] * (WRITTEN_TOGETHER_MAX_COUNT + 1), [WRITTEN_TOGETHER_MAX_COUNT, 1]),
        ([WRITTEN_TOGETHER_MAX_BYTES - 1, 1, 1], [2, 1]),
        ([WRITTEN_TOGETHER_MAX_BYTES + 1, 1], [1, 1]),
        ([1, WRITTEN_TOGETHER_MAX_BYTES, 1], [1, 1, 1]),
    ],
)
async def test_a_write_is_of_so_many_clips_and_bytes(sizes: list[int], writes: list[int]) -> None:
    written = Written()
    written.go_on.set()
    tasks = await written.keep([pending(size) for size in sizes])
    assert await asyncio.gather(*tasks) == ["kept"] * len(sizes)
    assert [len(write) for write in written.writes] == writes


@pytest.mark.parametrize(
    ("cancelled", "codes"),
    [
        (0, ["cancelled", "STORE_UNAVAILABLE", "STORE_UNAVAILABLE"]),  # who writes: the rows may be there or not
        (1, ["kept", "cancelled", "kept"]),  # who waits for it
    ],
)
async def test_whoever_is_cut_off_leaves_nobody_waiting(cancelled: int, codes: list[str]) -> None:
    written = Written()
    tasks = await written.keep([pending() for _ in codes])
    tasks[cancelled].cancel()
    await asyncio.sleep(0)
    written.go_on.set()
    found = await asyncio.gather(*tasks, return_exceptions=True)
    assert ["cancelled" if isinstance(one, asyncio.CancelledError) else one for one in found] == codes
    assert await told(written.queue.keep(pending(), written.lock)) == "kept"


async def test_who_is_cut_off_before_it_is_taken_is_not_written() -> None:
    written = Written()
    first, second = pending(), pending(record_id=b"another")
    async with written.lock:
        tasks = [asyncio.create_task(told(written.queue.keep(each, written.lock))) for each in (first, second)]
        await asyncio.sleep(0)
        tasks[1].cancel()
        await asyncio.sleep(0)
    written.go_on.set()
    await asyncio.gather(*tasks, return_exceptions=True)
    assert written.writes == [[first]]

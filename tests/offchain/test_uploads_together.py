"""Uploads that wait for the custodian together are written together, and each is judged as if it came alone."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

import msgspec
import pytest

from consensus.errors import BlockRobotError
from node.custody import custodian as custodian_module
from node.custody.stores.custody_store import BlockEffects, ClipRow, FrameRow, Unwritten
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
from tests.offchain.test_fetching import Peer, held_by_peer
from tests.offchain.test_uploads import ROBOT, SECOND, size_of, terms

Told = list[str]
Keep = Callable[[PendingUpload, asyncio.Lock], Awaitable[None]]


@pytest.fixture
def writes(opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch) -> list[list[bytes]]:
    """The records of each write of clips."""
    noted, original = list[list[bytes]](), opened.store.stage_all

    async def stage_all(clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        noted.append([clip.record_id for clip, _ in clips])
        return await original(clips)

    monkeypatch.setattr(opened.store, "stage_all", stage_all)
    return noted


async def told(work: Awaitable[None]) -> str:
    try:
        await work
    except BlockRobotError as error:
        return error.code
    return "kept"


def calling_after(count: int, then: Callable[[], None], keep: Keep) -> Keep:
    """As `keep`; once it was called so often, all of them wait."""
    calls = itertools.count(1)

    async def counted(upload: PendingUpload, lock: asyncio.Lock) -> None:
        if next(calls) == count:
            asyncio.get_running_loop().call_soon(then)
        await keep(upload, lock)

    return counted


async def upload_together(
    house: CustodianHarness,
    *uploads: tuple[RecordedClip, UploadTerms],
    meanwhile: Callable[[], Awaitable[None]] | None = None,
) -> Told:
    """Keep the custodian busy until all wait for it; `meanwhile` happens then."""
    queue, all_wait = house.custodian._uploads, asyncio.Event()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(queue, "keep", calling_after(len(uploads), all_wait.set, queue.keep))
        async with house.custodian._writing:
            tasks = [
                asyncio.create_task(told(house.custodian.stage(clip.upload, allowed))) for clip, allowed in uploads
            ]
            await all_wait.wait()
            if meanwhile is not None:
                await meanwhile()
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
    effects = BlockEffects(missing=tuple(recorded_since))
    codes = await upload_together(opened, *uploads, meanwhile=lambda: opened.store.apply(effects))
    assert codes == ["UPLOAD_HASH_MISMATCH", "kept", "kept"]
    rows = await opened.store.clips([clip.record_id for clip, _ in uploads])
    assert {key: row.status for key, row in rows.items()} == {
        right.record_id: "confirmed",
        early.record_id: "staged",
    }
    assert opened.keys.held_count == len(right.plaintexts) + len(early.plaintexts)


async def test_a_clip_that_is_dropped_while_its_next_upload_waits_is_kept_anew(opened: CustodianHarness) -> None:
    """Its transaction has expired; the block that says so makes the robot send it again."""
    clip = record_clip()
    again = msgspec.structs.replace(clip.upload, valid_until_ms=clip.upload.valid_until_ms + 1000)
    await opened.custodian.stage(clip.upload, terms())
    opened.custodian._writing = lock = CountedLock(asyncio.Event())
    async with lock:
        task = asyncio.create_task(opened.custodian.stage(again, terms()))
        await lock.is_waited_for()
        await opened.custodian.eraser.drop_staged([clip.record_id])
    await task
    assert (await opened.store.clips([clip.record_id]))[clip.record_id].valid_until_ms == again.valid_until_ms
    assert opened.keys.held_count == len(clip.plaintexts)


async def test_of_many_clips_that_lapse_some_go_with_each_block(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks, erasures and downloads would wait for the end of what one robot brought and never recorded."""
    monkeypatch.setattr(custodian_module, "LAPSED_AT_ONCE_COUNT", 2)
    lapsing = [record_clip() for _ in range(5)]
    for clip in lapsing:
        await opened.custodian.stage(clip.upload)
    left = list[int]()
    for _ in range(4):
        await opened.follow(at_ms=max(opened.chain.time_ms + 1, lapsing[0].upload.valid_until_ms))
        left.append((await opened.store.counts()).staged)
    assert left == [3, 1, 0, 0]
    assert opened.keys.held_count == 0


async def test_what_is_read_for_many_uploads_is_read_once(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks wait meanwhile, and a server may be far."""
    asked, reads = list[str](), ["clips", "missing_clips", "use_by_robot", "day_uses"]

    def counted(name: str) -> Callable[..., Awaitable[object]]:
        original = getattr(opened.store, name)

        async def call(*arguments: object) -> object:
            asked.append(name)
            return await original(*arguments)

        return call

    async def count_from_now_on() -> None:
        for name in reads:
            monkeypatch.setattr(opened.store, name, counted(name))

    uploads = [(record_clip(1), terms()) for _ in range(8)]
    assert set(await upload_together(opened, *uploads, meanwhile=count_from_now_on)) == {"kept"}
    assert sorted(asked) == sorted(reads)


async def test_a_clip_that_the_store_refuses_is_refused_alone_and_leaves_nothing(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips, stage_all = [record_clip() for _ in range(3)], opened.store.stage_all
    awaited = record_clip()
    await opened.follow(recorded(awaited))
    refused = {clips[1].record_id, awaited.record_id}

    async def refuse(found: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        told = {clip.record_id: BlockRobotError("STORE_UNAVAILABLE") for clip, _ in found if clip.record_id in refused}
        return {**told, **await stage_all([one for one in found if one[0].record_id not in refused])}

    uploads = [(clip, terms()) for clip in (*clips, awaited)]
    with monkeypatch.context() as patch:
        patch.setattr(opened.store, "stage_all", refuse)
        assert await upload_together(opened, *uploads) == ["kept", "STORE_UNAVAILABLE", "kept", "STORE_UNAVAILABLE"]
        with pytest.raises(BlockRobotError, match="STORE_UNAVAILABLE"):
            await opened.custodian.fetch_missing([Peer(held_by_peer(awaited))])
    assert opened.keys.held_count == 2 * len(clips[0].plaintexts)
    sizes = [size_of(clips[0].upload), size_of(clips[2].upload)]
    assert [use.size_bytes for use in await opened.store.day_uses()] == [sum(sizes)]
    for clip, allowed in uploads:
        await opened.custodian.stage(clip.upload, allowed)
    assert opened.keys.held_count == 4 * len(clips[0].plaintexts)


async def test_a_read_that_fails_before_anything_is_written_leaves_no_key(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(*_arguments: object) -> None:
        raise BlockRobotError("STORE_UNAVAILABLE")

    clips = [record_clip() for _ in range(2)]
    with monkeypatch.context() as patch:
        patch.setattr(opened.store, "add_use", fail)
        assert await upload_together(opened, *((clip, terms()) for clip in clips)) == ["STORE_UNAVAILABLE"] * 2
    assert opened.keys.held_count == 0


async def test_a_store_that_fails_refuses_all_that_it_was_to_write_and_takes_them_afterwards(
    opened: CustodianHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody knows what it has written, so the keys stay."""
    clips = [record_clip() for _ in range(3)]

    async def fail(*_arguments: object) -> None:
        raise BlockRobotError("STORE_UNAVAILABLE")

    with monkeypatch.context() as patch:
        patch.setattr(opened.store, "stage_all", fail)
        uploads = [(clip, terms()) for clip in clips]
        assert await upload_together(opened, *uploads) == ["STORE_UNAVAILABLE"] * 3
    assert opened.keys.held_count == sum(len(clip.plaintexts) for clip in clips)
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


async def test_what_is_written_is_said_at_once_whoever_has_the_lock_next() -> None:
    written = Written()
    written.go_on.set()
    async with written.lock:
        first = asyncio.create_task(told(written.queue.keep(pending(), written.lock)))
        await asyncio.sleep(0)
        block = asyncio.create_task(written.lock.acquire())
        await asyncio.sleep(0)
        second = asyncio.create_task(told(written.queue.keep(pending(), written.lock)))
        await asyncio.sleep(0)
    assert await asyncio.gather(first, second) == ["kept", "kept"]
    assert await block
    assert [len(write) for write in written.writes] == [2]


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

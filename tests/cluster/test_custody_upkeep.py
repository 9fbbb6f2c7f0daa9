"""Custodians over real stores and real processes: hunted after an erasure, put back from old backups, damaged, mended."""

from __future__ import annotations

import asyncio
import re
import shutil
import sqlite3
import time
from collections.abc import AsyncIterator
from contextlib import closing
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from network.bench.custody.custody_clips import ClipRobot, SealedClip
from network.bench.fresh_network import FreshNetwork
from network.cluster import Cluster
from network.custody.custody_requests import R, ask_status, run_work
from network.custody.hunt import HuntReport, gather, hunt
from network.custody.traces import Trace, read_traces, write_traces
from network.demo.tampering import flip_stored_byte
from node.config import CONFIG_FILE
from node.custody.coordination.custody_answers import FrameName, RebuildAnswer, ScrubAnswer
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME

FRAMES_COUNT, FRAME_BYTES = 5, 6_000
SETTLE_MAX_S = 60.0
MORE_THAN_ANY_DISK_MIB = 10**9
_TOLD = ("name", "checkpoint_height", "finalized_height", "serving", "clips_held", "clips_missing")


@pytest.fixture
async def embedded() -> AsyncIterator[tuple[FreshNetwork, ClipRobot]]:
    """The same with embedded stores."""
    async with FreshNetwork(4) as network:
        (robot,) = await network.enrol_robots(1)
        yield network, ClipRobot(robot.key, network.open_client())


def _names(cluster: Cluster) -> list[str]:
    return [node.name for node in cluster.genesis.custodians]


async def _work(cluster: Cluster, name: str, kind: type[R]) -> R:
    return await run_work(cluster.config(name), kind, lambda *_: None)


async def _settled(cluster: Cluster) -> None:
    """Wait until every custodian serves, is up to date and lacks nothing."""
    deadline = time.monotonic() + SETTLE_MAX_S
    while True:
        try:
            statuses = [await ask_status(cluster.config(name)) for name in _names(cluster)]
        except BlockRobotError:
            statuses = []
        if statuses and all(row.serving and not row.behind_blocks and not row.clips_missing for row in statuses):
            return
        told = [{key: getattr(row, key) for key in _TOLD} for row in statuses]
        assert time.monotonic() < deadline, told
        await asyncio.sleep(0.2)


async def _waits_for(cluster: Cluster, name: str, receipts: dict[str, int]) -> None:
    """Wait until a custodian, which follows the chain a moment later, waits for so many receipts of others."""
    deadline = time.monotonic() + SETTLE_MAX_S
    while True:
        waiting = (await ask_status(cluster.config(name))).waiting_for
        if {key: row.receipts for key, row in waiting.items()} == receipts:
            return
        assert time.monotonic() < deadline, waiting
        await asyncio.sleep(0.2)


async def _trace(cluster: Cluster, *clips: SealedClip) -> list[Trace]:
    traces = await asyncio.to_thread(gather, cluster, [clip.record_id for clip in clips])
    for trace, clip in zip(traces, clips, strict=True):
        for plaintext in clip.plaintexts:
            trace.add("plaintext", plaintext, 8)
        for sealed_key in clip.upload.sealed_keys:
            trace.add("sealed-key", sealed_key[-12:])
    return traces


async def _hunt(cluster: Cluster, traces: list[Trace]) -> HuntReport:
    """Hunt again for what was traced before, with the records' status of now."""
    now = await asyncio.to_thread(gather, cluster, [trace.record_id for trace in traces], traces)
    return await asyncio.to_thread(hunt, cluster, now)


async def test_the_hunt_finds_a_record_before_its_erasure_and_nothing_forbidden_after_it(
    stage: tuple[FreshNetwork, ClipRobot], tmp_path: Path
) -> None:
    network, robot = stage
    cluster = network.cluster
    owner = await robot.open_visit()
    gone, kept = [await robot.record(owner, FRAMES_COUNT, FRAME_BYTES) for _ in range(2)]
    await _settled(cluster)
    traces = await _trace(cluster, gone, kept)
    before = await asyncio.to_thread(hunt, cluster, traces)
    assert before.is_clean, before.forbidden
    held = {(finding.place.split("/")[-1], finding.what) for finding in before.findings if finding.what != "leaf"}
    assert {what for _, what in held} == {"id", "root", "metadata", "ciphertext", "wrapped-key", "erase-key"}
    for custodian in _names(cluster):
        places = {finding.what for finding in before.findings if custodian in finding.place}
        assert {"ciphertext", "wrapped-key", "erase-key"} <= places

    write_traces(tmp_path / "before.json", traces)
    await robot.wait_erased(owner, await robot.request_erasure(owner, [gone.record_id]))
    after = await _hunt(cluster, read_traces(tmp_path / "before.json"))
    assert after.is_clean, after.forbidden
    left = {finding.what for finding in after.findings if finding.record_id == gone.record_id}
    assert left <= {"id", "root", "metadata"}
    assert all(finding.why for finding in after.findings)
    still = {finding.what for finding in after.findings if finding.record_id == kept.record_id}
    assert {"ciphertext", "wrapped-key", "erase-key"} <= still

    forged = [Trace(gone.record_id, "erased", dict(traces[1].pieces))]
    assert not (await asyncio.to_thread(hunt, cluster, forged)).is_clean, (
        "had the bytes stayed, it would have seen them"
    )
    for name in _names(cluster):
        report = await _work(cluster, name, ScrubAnswer)
        assert report.ok, report
        assert report.nothing_erased_is_left


async def test_a_custodian_put_back_from_an_old_backup_erases_again_before_it_serves(
    embedded: tuple[FreshNetwork, ClipRobot], tmp_path: Path
) -> None:
    """All of its folder is of yesterday, the erase keys too, against all advice."""
    network, robot = embedded
    cluster = network.cluster
    owner = await robot.open_visit()
    gone, kept = [await robot.record(owner, FRAMES_COUNT, FRAME_BYTES) for _ in range(2)]
    await _settled(cluster)
    victim = _names(cluster)[0]
    await asyncio.to_thread(cluster.stop, victim)
    folder = cluster.config(victim).data_dir
    await asyncio.to_thread(shutil.copytree, folder, tmp_path / "backup")
    cluster.start(victim)
    await cluster.wait_ready([victim])
    await _settled(cluster)
    traces = await _trace(cluster, gone)
    await robot.wait_erased(owner, await robot.request_erasure(owner, [gone.record_id]))
    late = await robot.record(owner, FRAMES_COUNT, FRAME_BYTES)

    await asyncio.to_thread(cluster.stop, victim)
    await asyncio.to_thread(shutil.rmtree, folder)
    await asyncio.to_thread(shutil.copytree, tmp_path / "backup", folder)
    assert not (await _hunt(cluster, traces)).is_clean, "the backup holds what was erased since"
    cluster.start(victim, restored=True)
    await cluster.wait_answering(victim)
    await _settled(cluster)
    assert (await _hunt(cluster, traces)).is_clean
    report = await _work(cluster, victim, ScrubAnswer)
    assert report.ok, report
    assert report.clips_compared_count == 2
    for clip in (kept, late):
        assert (await _hunt(cluster, await _trace(cluster, clip))).is_clean


@pytest.mark.smoke
async def test_a_custodian_that_was_down_during_an_erasure_carries_it_out_when_it_is_back(
    embedded: tuple[FreshNetwork, ClipRobot],
) -> None:
    network, robot = embedded
    cluster = network.cluster
    owner = await robot.open_visit()
    gone = await robot.record(owner, FRAMES_COUNT, FRAME_BYTES)
    await _settled(cluster)
    traces = await _trace(cluster, gone)
    awake, asleep = _names(cluster)
    await asyncio.to_thread(cluster.kill, asleep)
    erasure_id = await robot.request_erasure(owner, [gone.record_id])
    key = cluster.genesis.custodians[1].custodian_key.hex()
    await _waits_for(cluster, awake, {key: 1})
    cluster.start(asleep)
    await cluster.wait_ready([asleep])
    await robot.wait_erased(owner, erasure_id)
    assert (await _hunt(cluster, traces)).is_clean
    await _waits_for(cluster, awake, {})


async def test_a_disk_below_its_reserve_takes_no_upload_and_still_erases(
    embedded: tuple[FreshNetwork, ClipRobot],
) -> None:
    network, robot = embedded
    cluster = network.cluster
    owner = await robot.open_visit()
    gone = await robot.record(owner, FRAMES_COUNT, FRAME_BYTES)
    await _settled(cluster)
    for name in _names(cluster):
        await asyncio.to_thread(cluster.stop, name)
        settings = cluster.config(name).data_dir / CONFIG_FILE
        told = settings.read_text(encoding="utf-8")
        settings.write_text(
            re.sub(r"reserve_mib = \d+", f"reserve_mib = {MORE_THAN_ANY_DISK_MIB}", told), encoding="utf-8"
        )
        cluster.start(name)
    await cluster.wait_ready(_names(cluster))
    with pytest.raises(BlockRobotError, match=r"^DISK_RESERVE_REACHED:"):
        await robot.record(owner, FRAMES_COUNT, FRAME_BYTES)
    await robot.wait_erased(owner, await robot.request_erasure(owner, [gone.record_id]))
    assert (await _hunt(cluster, await _trace(cluster, gone))).is_clean


async def test_two_custodians_that_disagree_are_found_out_and_mended_from_each_other(
    embedded: tuple[FreshNetwork, ClipRobot],
) -> None:
    """One has a damaged frame, the other has lost a clip; each has what the other needs."""
    network, robot = embedded
    cluster = network.cluster
    owner = await robot.open_visit()
    damaged, lost = [await robot.record(owner, FRAMES_COUNT, FRAME_BYTES) for _ in range(2)]
    await _settled(cluster)
    first, second = _names(cluster)
    await asyncio.to_thread(flip_stored_byte, cluster.config(first), damaged.record_id, 2)
    await asyncio.to_thread(_lose, cluster.config(second).custody_dir / DATABASE_FILE_NAME, lost.record_id)
    found = await _work(cluster, first, ScrubAnswer)
    assert found.corrupted == [FrameName(damaged.record_id.hex(), 2)]
    found = await _work(cluster, second, ScrubAnswer)
    assert found.missing == [lost.record_id.hex()]
    assert len(found.unclaimed_keys) == FRAMES_COUNT
    assert (await _work(cluster, first, RebuildAnswer)).mended == [damaged.record_id.hex()]
    rebuilt = await _work(cluster, second, RebuildAnswer)
    assert rebuilt.ok, rebuilt
    for name in (first, second):
        report = await _work(cluster, name, ScrubAnswer)
        assert report.ok, report
        assert report.clips_compared_count == 2


def _lose(path: Path, record_id: bytes) -> None:
    with closing(sqlite3.connect(path, timeout=10)) as database, database:
        database.execute("PRAGMA secure_delete = ON")
        database.execute("DELETE FROM clips WHERE record_id = ?", (record_id,))

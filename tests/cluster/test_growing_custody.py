"""A custodian moves its clips to a folder and on to an S3 bucket while a robot records: none is lost, and erasing holds."""

from __future__ import annotations

import asyncio
import json
import secrets
import shutil
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from consensus.records.clips import ClipUpload
from network.bench.custody.custody_clips import ClipRobot, SealedClip
from network.bench.fresh_network import FreshNetwork
from network.cli.node.custody_move_commands import move
from network.cluster import Cluster
from network.custody.hunt import hunt
from node.config import load_config
from node.custody.coordination.custody_answers import ScrubAnswer
from node.custody.moving import MOVED_NAME
from tests.cluster.test_custody_upkeep import FRAME_BYTES, FRAMES_COUNT, _hunt, _names, _settled, _trace, _work
from tests.offchain import weed
from tests.offchain.weed import S3Server

RECORD_MAX_S = 60.0


@pytest.fixture(scope="module")
def s3_server() -> Iterator[S3Server]:
    with weed.given_or_running() as server:
        yield server


@pytest.fixture
async def recording() -> AsyncIterator[tuple[FreshNetwork, ClipRobot]]:
    async with FreshNetwork(4) as network:
        (robot,) = await network.enrol_robots(1)
        yield network, ClipRobot(robot.key, network.open_client())


async def record_on(robot: ClipRobot, clips: list[SealedClip]) -> None:
    """One clip after another, to whichever custodians answer."""
    owner = await robot.open_visit()

    async def send(upload: ClipUpload) -> None:
        await robot.client.find_nodes(robot._key)
        sent = 0
        for custodian in robot.client.custody.custodians:
            with suppress(BlockRobotError):
                await robot.client.custody.upload_clip(custodian, upload, robot._key)
                sent += 1
        assert sent

    while True:
        clips.append(await robot.record(owner, FRAMES_COUNT, FRAME_BYTES, send))


async def recorded(count: int, clips: list[SealedClip], working: asyncio.Task[None]) -> None:
    deadline = time.monotonic() + RECORD_MAX_S
    while len(clips) < count:
        assert not working.done(), working
        assert time.monotonic() < deadline
        await asyncio.sleep(0.1)


async def moved(cluster: Cluster, name: str, *options: str) -> None:
    await asyncio.to_thread(cluster.stop, name)
    folder = cluster.config(name).data_dir
    result = await asyncio.to_thread(CliRunner().invoke, move, [str(folder), *options, "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["old"] == str(folder / MOVED_NAME)
    await asyncio.to_thread(shutil.rmtree, folder / MOVED_NAME)
    cluster.configs[name] = load_config(folder)
    cluster.start(name)
    await cluster.wait_ready([name])


async def test_clips_move_to_a_folder_and_to_a_bucket_under_a_robot_that_records(
    recording: tuple[FreshNetwork, ClipRobot], s3_server: S3Server, tmp_path: Path
) -> None:
    network, robot = recording
    cluster, clips = network.cluster, list[SealedClip]()
    name, other = _names(cluster)
    bucket, client = f"blockrobot-test-{secrets.token_hex(6)}", s3_server.client()
    client.create_bucket(Bucket=bucket)
    credentials = s3_server.write_credentials(tmp_path / "credentials")
    places = (f"s3://{bucket}/{name}", "--clips-endpoint", s3_server.endpoint, "--clips-credentials", str(credentials))
    working = asyncio.create_task(record_on(robot, clips))
    await recorded(5, clips, working)
    await moved(cluster, name, "--clips", f"folder:{tmp_path / 'clips'}")
    await moved(cluster, name, "--clips", *places)
    await moved(cluster, other, "--clips", "folder")
    held = len(clips)
    await recorded(held + 5, clips, working)
    working.cancel()
    with suppress(asyncio.CancelledError):
        await working
    await _settled(cluster)
    for each in (name, other):
        report = await _work(cluster, each, ScrubAnswer)
        assert report.ok, report
        assert report.clips_compared_count >= len(clips)

    owner = await robot.open_visit()
    gone = await robot.record(owner, FRAMES_COUNT, FRAME_BYTES)
    await _settled(cluster)
    traces = await _trace(cluster, gone, clips[0])
    before = await asyncio.to_thread(hunt, cluster, traces)
    assert before.is_clean, before.forbidden
    found = {finding.place for finding in before.findings if finding.what == "ciphertext"}
    assert f"bucket {bucket}" in found
    assert any(place.startswith(f"nodes/{other}/clips/") for place in found)
    assert not any("sqlite" in place for place in found)
    await robot.wait_erased(owner, await robot.request_erasure(owner, [gone.record_id]))
    after = await _hunt(cluster, traces)
    assert after.is_clean, after.forbidden
    assert not any(f.what == "ciphertext" and f.record_id == gone.record_id for f in after.findings)
    client.close()

"""Three custodians of which one or two are down, and robots that wait for one, two or three of them."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace
from typing import Any

import pytest

from clients.robot.delivery.robot_network import RobotNetwork
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from network.bench.custody.custody_clips import ClipRobot
from network.bench.fresh_network import FreshNetwork
from network.cluster import Cluster
from network.custody.custody_requests import ask_all, run_work
from node.custody.coordination.custody_answers import ScrubAnswer

FRAMES_COUNT, FRAME_BYTES = 3, 4_000
SETTLE_MAX_S = 60.0


def _uploader(robot: ClipRobot, key: PrivateKey, copies: int) -> RobotNetwork:
    identity: Any = SimpleNamespace(identity=key)
    return RobotNetwork(robot.client, identity, copies)


async def _settle(cluster: Cluster, clips: int) -> None:
    """Wait until every custodian holds so many clips, has confirmed every erasure, and owes nothing."""
    configs = [cluster.config(node.name) for node in cluster.genesis.custodians]
    deadline = time.monotonic() + SETTLE_MAX_S
    while True:
        statuses = await ask_all(configs)
        heard = [row for row in statuses if not isinstance(row, BlockRobotError)]
        if len(heard) == len(configs) and all(
            row.serving and row.clips_held == clips and not row.clips_missing and not row.waiting_for for row in heard
        ):
            return
        assert time.monotonic() < deadline, statuses
        await asyncio.sleep(0.2)


async def test_with_one_of_three_down_two_are_enough_three_are_not_and_the_third_catches_up() -> None:
    async with FreshNetwork(4, custodians=3) as network:
        cluster = network.cluster
        (enrolled,) = await network.enrol_robots(1)
        robot = ClipRobot(enrolled.key, network.open_client())
        first, second, third = (node.name for node in cluster.genesis.custodians)
        owner = await robot.open_visit()
        gone = await robot.record(owner, FRAMES_COUNT, FRAME_BYTES)
        await asyncio.to_thread(cluster.kill, third)

        two, three = (_uploader(robot, enrolled.key, copies) for copies in (2, 3))
        await robot.record(owner, FRAMES_COUNT, FRAME_BYTES, two.upload)
        with pytest.raises(BlockRobotError) as refusal:
            await robot.record(owner, FRAMES_COUNT, FRAME_BYTES, three.upload)
        assert refusal.value.entry.retryable, "delivery tries it again"
        erasure_id = await robot.request_erasure(owner, [gone.record_id])

        cluster.start(third)
        await cluster.wait_ready([third])
        await robot.wait_erased(owner, erasure_id)
        await robot.record(owner, FRAMES_COUNT, FRAME_BYTES, three.upload)
        await _settle(cluster, clips=2)
        for name in (first, second, third):
            report = await run_work(cluster.config(name), ScrubAnswer, lambda *_: None)
            assert (report.ok, report.clips_compared_count) == (True, 2), report


async def test_where_one_is_enough_two_of_three_may_be_down_while_a_clip_is_brought() -> None:
    """Blocks need more nodes than that: the record is made when they are back, and they fetch the clip."""
    async with FreshNetwork(4, custodians=3) as network:
        cluster = network.cluster
        (enrolled,) = await network.enrol_robots(1)
        robot = ClipRobot(enrolled.key, network.open_client())
        _, second, third = (node.name for node in cluster.genesis.custodians)
        owner = await robot.open_visit()
        one, two = (_uploader(robot, enrolled.key, copies) for copies in (1, 2))
        await robot.client.find_nodes(enrolled.key)

        async def send(upload: ClipUpload) -> None:
            for name in (second, third):
                await asyncio.to_thread(cluster.kill, name)
            with pytest.raises(BlockRobotError) as refusal:
                await two.upload(upload)
            assert refusal.value.entry.retryable
            await one.upload(upload)
            for name in (second, third):
                cluster.start(name)
            await cluster.wait_ready([second, third])

        await robot.record(owner, FRAMES_COUNT, FRAME_BYTES, send)
        await _settle(cluster, clips=1)

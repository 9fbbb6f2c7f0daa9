"""Frames over a real Zenoh router and tags from a real emulated reader, through the robot's own command, into a wallet."""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from pathlib import Path

import pytest

from clients.robot.sources.messages.topics import LlrpReader
from tests.cluster.killed_robot import killed_robot
from tests.cluster.network_under_test import NetworkUnderTest
from tests.robot_live.live_robot import LiveRobot
from tests.robot_live.tag_readers import TagReaders
from tests.robot_live.ward import make_scene
from tests.robot_live.zenoh_graph import ZenohGraph, zenoh_graph
from tests.walking_alone import UID, walking_alone

RATE_HZ = 30
SECONDS = 6.0
LAP_S = 2.0
SCENE = walking_alone(
    "zenoh",
    LAP_S,
    [(0.0, -0.6, 4.9), (LAP_S, 0.4, 4.4)],
    [0.1, LAP_S - 0.1],
    frame_rate=RATE_HZ,
    size=(640, 480),
    also_every_s=0.2,
)
WITH_DISTANCES = """
[[tags]]
topic = "/rfid/sightings"
epc = "epc"
distance = "distance"
distance_sigma = "distance_sigma"
distance_unit = "m"
facing = "antenna_facing"
first_seen = "first_seen"
last_seen = "last_seen"
"""
DEPTH, TAGS = "/camera/depth/image_raw", "/rfid/sightings"
ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith("ROS")}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Ann alone in a corridor, and the corridor without her."""
    folder = tmp_path_factory.mktemp("scene")
    return make_scene(SCENE, UID, folder), make_scene(SCENE, UID, folder, empty=True)


async def test_a_reader_alone_keeps_nothing_and_with_distances_over_zenoh_her_pictures_are_in_her_wallet(
    network: NetworkUnderTest, tmp_path: Path, scenes: tuple[Path, Path], tag_readers: TagReaders
) -> None:
    scene, empty = scenes
    reader = await tag_readers.start(tags={UID: [1], "01": [1]}, clock_off_s=-86_400.0)
    async with killed_robot(network, tmp_path) as robot, zenoh_graph() as graph:
        live = LiveRobot(robot, tmp_path, topics(reader), source(graph), ENVIRONMENT)
        drivers = await graph.start_drivers(empty, seconds=60, wait=False, only=["depth"])
        await live.approve_viewpoint()
        drivers.kill()

        async with live.running() as process:
            sent_alone = await graph.publish(scene, rate=10, seconds=2, only=["depth", "info"])
            await live.until_it_says(process, f'"frames_read": {sent_alone["frames"]}')
            alone = await live.end(process)

        live.use_topics(topics(reader) + WITH_DISTANCES)
        async with live.running() as process:
            publishing = asyncio.create_task(graph.publish(scene, rate=RATE_HZ, seconds=SECONDS))
            await live.until_it_says(process, '"frames_read": [1-9]')
            await tag_readers.kill()
            await live.until_it_says(process, f"{reader.address} is gone")
            await tag_readers.start(reader.port, tags={UID: [1]}, clock_off_s=3_600.0)
            await live.until_it_says(process, f"{reader.address} is there")
            sent = await publishing
            await live.until_it_says(process, f'"frames_read": {sent["frames"]}')
            both = await live.end(process)
        reports = await robot.read()

    assert alone["frames"]["covered"] == sent_alone["frames"] == 20
    assert alone["frames"]["withheld_reasons"] == {"no-distance": 20}, "nobody can be told apart without a distance"
    assert set(alone["intake"]["messages_refused"]["sighting"]) == {"tag"}

    frames, intake = both["frames"], both["intake"]
    assert frames["published"] == sent["frames"] == RATE_HZ * SECONDS, "every frame that was published was read"
    assert intake["heard"] == {DEPTH: sent["frames"], TAGS: sent["readings"]}
    assert (intake["missed"], intake["never_came"]) == ({}, {})
    assert intake["gone"][reader.address] == 1
    assert abs(intake["clocks"][f"reader {reader.address}"]["offset_ms"]) < 1_000, "the reader's wrong clock is on ours"
    assert frames["covered"] == frames["kept"] + frames["withheld"]
    assert frames["kept"] > sent["frames"] / 2

    held = [entry.metadata for report in reports for entry in report.records]
    assert sum(one.frame_count for one in held if one.sensor == "depth") == frames["kept"]
    told: Counter[str] = Counter()
    for one in held:
        told.update(dict(one.withheld))
    assert told.total() == 20 + frames["withheld"]
    assert [(report.closed, report.missing_count) for report in reports] == [(True, 0)] * len(reports)


def source(graph: ZenohGraph) -> tuple[str, ...]:
    """What a command is told of the camera."""
    return "--source", "zenoh", "--zenoh-connect", graph.endpoint


def topics(reader: LlrpReader) -> str:
    """What the topics file says of a reader."""
    return f'[[llrp]]\nhost = "{reader.host}"\nport = {reader.port}\nfront = [1]\nback = [2]\n'

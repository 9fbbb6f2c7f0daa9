"""A real ROS 2 graph feeds the robot's own command on real nodes, until what its camera saw is in a wallet.

All of it, nodes, robot, drivers and wallet, is in a network of its own.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from clients.robot.identity.robot_keys import load_identity
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from tests.cluster.killed_robot import killed_robot
from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.robot_live.live_robot import LiveRobot
from tests.robot_live.own_network import run_in_own_network
from tests.robot_live.ros2_graph import DEPTH, RFID, Ros2Graph, ros2_graph
from tests.robot_live.ward import TOPICS_FILE, make_scene, published_counts
from tests.walking_alone import UID, walking_alone

pytestmark = pytest.mark.ros2

RATE_HZ = 30
SECONDS = 4
LAP_S = 1.2
SCENE = walking_alone(
    "ros2",
    LAP_S,
    [(0.0, -0.6, 4.9), (LAP_S, 0.0, 4.6)],
    [0.1, LAP_S - 0.1],
    frame_rate=RATE_HZ,
    size=(640, 480),
    also_every_s=0.2,
)


@asynccontextmanager
async def running_network(folder: Path) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes of two organisations."""
    async with running(NetworkUnderTest(folder, nodes=4)) as network:
        yield network


def test_what_ros_2_publishes_at_30_hz_is_recorded_whole_and_is_in_the_wallet(tmp_path: Path) -> None:
    async def story() -> None:
        rendering = [
            asyncio.to_thread(make_scene, SCENE, UID, tmp_path / "scene", empty=empty) for empty in (False, True)
        ]
        scene, empty = await asyncio.gather(*rendering)
        async with (
            running_network(tmp_path / "network") as network,
            killed_robot(network, tmp_path) as robot,
            ros2_graph(tmp_path / "ros") as graph,
        ):
            live = LiveRobot(robot, tmp_path, TOPICS_FILE, ("--source", "ros2"), graph.environment)
            await record_viewpoint(live, graph, empty)
            await record_and_check(live, graph, scene)

    run_in_own_network(story, tmp_path)


async def record_viewpoint(live: LiveRobot, graph: Ros2Graph, empty: Path) -> None:
    """List what is advertised, record what the camera sees of the empty corridor, and approve it."""
    drivers = await graph.talk(scene=str(empty), rate=10, seconds=60, tags="ward", reads_per_s=2, wait=False)
    draft = live.folder / "draft.toml"
    listed, _ = await asyncio.gather(
        live.do("topics", "--source", "ros2", "--seconds", "10", "--draft", str(draft)), live.approve_viewpoint()
    )
    drivers.terminate()
    await drivers.wait()

    could_be = {row["topic"]: row["could_be"] for row in listed["topics"]}
    assert {DEPTH, RFID} <= could_be.keys(), listed
    assert (could_be[DEPTH], could_be[RFID]) == (["depth"], ["tags"])
    assert 'epc = "tags[].epc"' in await asyncio.to_thread(draft.read_text, encoding="utf-8")


async def record_and_check(live: LiveRobot, graph: Ros2Graph, scene: Path) -> None:
    async with live.running() as process:
        drivers = await graph.talk(scene=str(scene), rate=RATE_HZ, seconds=SECONDS, tags="ward", reads_per_s=5)
        published = await published_counts(drivers)
        await live.until_it_says(process, f'"frames_read": {published["frames"]}')
        summary = await live.end(process)
    reports = await live.robot.read()

    assert published == {"frames": RATE_HZ * SECONDS, "tag_messages": 5 * SECONDS}
    frames, intake = summary["frames"], summary["intake"]
    sys.stdout.write(f"published {published}, heard {intake['heard']}, frames {frames}\n")
    assert intake["heard"] == {DEPTH: published["frames"], RFID: published["tag_messages"]}
    assert (intake["missed"], intake["unread"], intake["messages_refused"]) == ({}, {}, {})
    assert frames["published"] == published["frames"], "every frame that was published was read"
    assert (frames["covered"], frames["lost"]) == (frames["kept"] + frames["withheld"], 0)
    assert frames["kept"] > published["frames"] / 2
    held = [entry.metadata for report in reports for entry in report.records]
    assert sum(entry.frame_count for entry in held if entry.sensor == "depth") == frames["kept"]
    assert [(report.closed, report.missing_count) for report in reports] == [(True, 0)] * len(reports)
    assert UnclosedVisitStore(live.robot.robot / "open-visits", load_identity(live.robot.robot).spool).counts == {}
    left = [path for path in (live.folder / "home").rglob("*") if path.is_file()]
    assert left == [], "neither rclpy's log nor anything else is left where the robot lives"

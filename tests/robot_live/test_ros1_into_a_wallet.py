"""A real ROS 1 graph feeds the robot's own command on real nodes, until what its camera saw is in a wallet."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from clients.robot.identity.robot_keys import load_identity
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from tests.cluster.killed_robot import killed_robot
from tests.cluster.network_under_test import NetworkUnderTest
from tests.robot_live.live_robot import LiveRobot
from tests.robot_live.ros1_graph import Ros1Graph, ros1_graph
from tests.robot_live.ward import TOPICS_FILE, make_scene
from tests.walking_alone import UID, walking_alone

pytestmark = pytest.mark.system_packages

RATE_HZ = 30
SECONDS = 6.0
LAP_S = 2.0
SCENE = walking_alone(
    "ros1",
    LAP_S,
    [(0.0, -0.6, 4.9), (LAP_S, 0.4, 4.4)],
    [0.1, LAP_S - 0.1],
    frame_rate=RATE_HZ,
    size=(640, 480),
    also_every_s=0.2,
)


def source_of(graph: Ros1Graph) -> tuple[tuple[str, ...], dict[str, str]]:
    """The command's arguments and environment for a graph: only the master's address, as a user's shell has it."""
    kept = {name: value for name, value in graph.environment.items() if name not in ("ROS_IP", "ROS_HOME")}
    return ("--source", "ros1"), kept


async def test_what_ros_publishes_at_30_hz_is_recorded_whole_and_is_in_the_wallet(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    scene = await asyncio.to_thread(make_scene, SCENE, UID, tmp_path / "scene")
    empty = await asyncio.to_thread(make_scene, SCENE, UID, tmp_path / "scene", empty=True)
    async with killed_robot(network, tmp_path) as robot, ros1_graph(tmp_path / "ros") as graph:
        live = LiveRobot(robot, tmp_path, TOPICS_FILE, *source_of(graph))
        nobody = await graph.start_drivers(empty, rate=10, seconds=60, wait=False, reads_per_s=0)
        await live.approve_viewpoint()
        nobody.terminate()
        await nobody.wait()
        async with live.running() as process:
            published = await graph.publish(scene, rate=RATE_HZ, seconds=SECONDS)
            await live.until_it_says(process, f'"frames_read": {published["frames"]}')
            summary = await live.end(process)
        reports = await robot.read()

        assert published["frames"] == RATE_HZ * SECONDS
        frames, intake = summary["frames"], summary["intake"]
        assert frames["published"] == published["frames"], "every frame that was published was read"
        assert intake["heard"] == {"/kinect/depth/image": published["frames"], "/rfid": published["tag_messages"]}
        assert (intake["missed"], intake["unread"], intake["messages_refused"]) == ({}, {}, {})
        assert frames["covered"] == frames["kept"] + frames["withheld"]
        assert frames["lost"] == 0
        assert frames["kept"] > published["frames"] / 2
        held = [entry.metadata for report in reports for entry in report.records]
        assert sum(entry.frame_count for entry in held if entry.sensor == "depth") == frames["kept"]
        assert [(report.closed, report.missing_count) for report in reports] == [(True, 0)] * len(reports)
        assert UnclosedVisitStore(robot.robot / "open-visits", load_identity(robot.robot).spool).counts == {}
        assert list((tmp_path / "home").rglob("*.log")) == [], "rospy keeps no log here"

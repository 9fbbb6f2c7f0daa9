"""A real ROS 1 graph feeds the robot's own command on real nodes, until what its camera saw is in a wallet."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import sys
from asyncio.subprocess import Process
from pathlib import Path
from typing import Any

import pytest

from clients.robot.identity import load_identity
from clients.robot.open_visits import OpenVisits
from tests.cluster.killed_robot import PURPOSE, ROOT, KilledRobot, killed_robot
from tests.cluster.network_under_test import NetworkUnderTest
from tests.robot_live.ros1_graph import TOPICS_FILE, Ros1Graph, make_scene, ros1_graph
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
VIEWPOINT = "ward-3"
COMMAND_TIMEOUT_S = 60
END_TIMEOUT_S = 120


class LiveRobot:
    """The robot's own command beside a graph."""

    def __init__(self, robot: KilledRobot, graph: Ros1Graph, folder: Path) -> None:
        self.robot = robot
        self.graph = graph
        self.folder = folder
        self.notices: list[str] = []
        self.topics = folder / "topics.toml"
        self.topics.write_text(TOPICS_FILE, encoding="utf-8")

    async def start(self, *arguments: str) -> Process:
        home = self.folder / "home"
        environment = {
            **{name: value for name, value in self.graph.environment.items() if name not in ("ROS_IP", "ROS_HOME")},
            "HOME": str(home),
            "TMPDIR": str(home),
            "BLOCKROBOT_HOME": str(self.folder),
        }
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "network.cli.main", "robot", "--robot-dir", str(self.robot.robot.parent)),
            *("--genesis", str(self.folder / "genesis.json"), *arguments),
            cwd=ROOT,
            env=environment,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )

    async def do(self, *arguments: str) -> dict[str, Any]:
        """Run a command to its end and return its JSON."""
        process = await self.start(*arguments, "--json")
        output, said = await asyncio.wait_for(process.communicate(), COMMAND_TIMEOUT_S)
        assert process.returncode == 0, (output, said.decode()[-2_000:])
        answer: dict[str, Any] = json.loads(output)
        return answer

    async def approve_viewpoint(self, empty: Path) -> None:
        """Record what the camera sees of the empty corridor, live, and approve it."""
        drivers = await self.graph.start_drivers(empty, rate=10, seconds=60, wait=False, reads_per_s=0)
        recorded = await self.do(
            *("background", "record", "--source", "ros1", "--viewpoint", VIEWPOINT),
            *("--topics", str(self.topics), "--seconds", "2"),
        )
        assert recorded["frames"] >= 10
        await self.do("background", "approve", VIEWPOINT, "--by", "A. Nurse", "--yes")
        drivers.terminate()
        await drivers.wait()

    async def run(self) -> Process:
        """Start a live run."""
        return await self.start(
            *("run", "--source", "ros1", "--topics", str(self.topics), "--viewpoint", VIEWPOINT),
            *("--purpose", PURPOSE, "--json"),
        )

    async def say(self, process: Process, until: str) -> None:
        """Read what the run says until a line matches."""
        assert process.stderr is not None
        async with asyncio.timeout(COMMAND_TIMEOUT_S):
            async for line in process.stderr:
                text = line.decode()
                if '"notice"' in text:
                    self.notices.append(json.loads(text)["notice"])
                if re.search(until, text):
                    return
        raise AssertionError(f"it never said {until}")

    async def end(self, process: Process) -> dict[str, Any]:
        """End a run by Ctrl-C; return its summary."""
        process.send_signal(signal.SIGINT)
        output, said = await asyncio.wait_for(process.communicate(), END_TIMEOUT_S)
        assert process.returncode == 0, (output, said.decode()[-2_000:])
        for line in said.decode().splitlines():
            if '"notice"' in line:
                self.notices.append(json.loads(line)["notice"])
        summary: dict[str, Any] = json.loads(output)
        return summary


async def test_what_ros_publishes_at_30_hz_is_recorded_whole_and_is_in_the_wallet(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    scene = await asyncio.to_thread(make_scene, SCENE, UID, tmp_path / "scene")
    empty = await asyncio.to_thread(make_scene, SCENE, UID, tmp_path / "scene", empty=True)
    async with killed_robot(network, tmp_path) as robot, ros1_graph(tmp_path / "ros") as graph:
        live = LiveRobot(robot, graph, tmp_path)
        await live.approve_viewpoint(empty)
        process = await live.run()
        try:
            await live.say(process, '"progress"')
            published = await graph.publish(scene, rate=RATE_HZ, seconds=SECONDS)
            await live.say(process, f'"frames_read": {published["frames"]}')
            summary = await live.end(process)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
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
        assert OpenVisits(robot.robot / "open-visits", load_identity(robot.robot).spool).counts == {}
        assert list((tmp_path / "home").rglob("*.log")) == [], "rospy keeps no log here"

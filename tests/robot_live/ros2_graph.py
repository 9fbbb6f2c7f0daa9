"""A real ROS 2 graph for tests: drivers and the robot's feed in processes of their own, in a network of the test's own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.robot_live.ros2_wheels import ROOT, install, sourced
from tests.robot_live.ward import TOPICS_FILE, kill_all

ANSWER_TIMEOUT_S = 60.0
DEPTH, RFID = "/kinect/depth/image", "/rfid"
TAG_TYPE = "ward_msgs/msg/TagArray"


@dataclass
class Ear:
    """The robot's feed, in a process of its own (`ros2_ear`)."""

    process: Process

    async def answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = await asyncio.wait_for(self.process.stdout.readline(), ANSWER_TIMEOUT_S)
        if not line:
            _, said = await self.process.communicate()
            raise AssertionError(said.decode()[-2_000:])
        answer: dict[str, Any] = json.loads(line)
        return answer

    async def ask(self, question: str) -> dict[str, Any]:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{question}\n".encode())
        await self.process.stdin.drain()
        return await self.answer()

    async def until(self, question: str, told: Any) -> dict[str, Any]:
        """Ask until what is answered is as `told` says."""
        async with asyncio.timeout(ANSWER_TIMEOUT_S):
            while True:
                answer = await self.ask(question)
                if told(answer):
                    return answer
                await asyncio.sleep(0.05)


@dataclass
class Ros2Graph:
    """Whatever processes a test starts, all of which see one another and nobody else. `folder` is their home."""

    folder: Path
    environment: dict[str, str]
    processes: list[Process] = field(default_factory=list)

    async def start(self, *arguments: str, **environment: str) -> Process:
        """Start Python in the project's folder, with ROS 2 sourced."""
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, *arguments),
            cwd=ROOT,
            env={**self.environment, **environment},
            stdin=PIPE,
            stdout=PIPE,
            stderr=PIPE,
        )
        self.processes.append(process)
        return process

    async def listen(self, wanted: dict[str, str], *, topics: str = TOPICS_FILE, **more: Any) -> Ear:
        """Open the robot's feed; raises AssertionError with its words if it refuses."""
        settings = json.dumps({"wanted": wanted, "topics": topics, **more})
        ear = Ear(await self.start("-m", "tests.robot_live.ros2_ear", settings))
        if not more:
            assert await ear.answer() == {"opened": True}
        return ear

    async def talk(self, **settings: Any) -> Process:
        """Start drivers; return when they are up. Settings are those of `ros2_talker`."""
        process = await self.start(
            "-m", "tests.robot_live.ros2_talker", json.dumps(settings), HOME=str(self.folder.parent)
        )
        assert process.stdout is not None
        said = await asyncio.wait_for(process.stdout.readline(), ANSWER_TIMEOUT_S)
        assert said == b"up\n", (await process.communicate())[1].decode()[-2_000:]
        return process


@contextlib.asynccontextmanager
async def ros2_graph(folder: Path, *, workspace: bool = True) -> AsyncIterator[Ros2Graph]:
    """An empty graph. Without `workspace` Python does not find the package of the tags' own type."""
    environment = {**sourced(install(), workspace=workspace), "HOME": str(folder), "TMPDIR": str(folder)}
    graph = Ros2Graph(folder, environment)
    try:
        yield graph
    finally:
        await kill_all(graph.processes)

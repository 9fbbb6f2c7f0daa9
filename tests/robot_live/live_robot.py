"""The robot's own command in a process of its own, listening live beside real middleware. For tests of this folder."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import signal
import sys
from asyncio.subprocess import Process
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

from tests.cluster.killed_robot import PURPOSE, ROOT, KilledRobot

VIEWPOINT = "ward-3"
COMMAND_TIMEOUT_S = 60
END_TIMEOUT_S = 120


class LiveCommands:
    """Commands of a robot of `folder` that hears by `source`, the command's arguments for that, in an `environment`."""

    def __init__(
        self, folder: Path, topics: str, source: tuple[str, ...], environment: Mapping[str, str], robots: Path
    ) -> None:
        self.folder = folder
        self._robots = robots
        self._source = source
        self._environment = environment
        self.genesis = folder / "genesis.json"
        self._topics = folder / "topics.toml"
        self.use_topics(topics)

    def use_topics(self, topics: str) -> None:
        """Let commands from now on read this topics file."""
        self._topics.write_text(topics, encoding="utf-8")

    async def measure_antennas(self, seconds: int) -> dict[str, Any]:
        """Watch a walk; return what the command says."""
        words = ("--topics", str(self._topics), "--viewpoint", VIEWPOINT, "--seconds", str(seconds))
        return await self.do("antennas", *self._source, *words)

    async def do(self, *arguments: str) -> dict[str, Any]:
        """Run a command to its end and return its JSON."""
        process = await self._start(*arguments, "--json")
        output, said = await asyncio.wait_for(process.communicate(), COMMAND_TIMEOUT_S)
        assert process.returncode == 0, (output, said.decode()[-2_000:])
        answer: dict[str, Any] = json.loads(output)
        return answer

    async def approve_viewpoint(self) -> None:
        """Record what the camera sees now, for two seconds, and approve it."""
        recorded = await self.do(
            *("background", "record", *self._source, "--viewpoint", VIEWPOINT),
            *("--topics", str(self._topics), "--seconds", "2"),
        )
        assert recorded["frames"] >= 10
        await self.do("background", "approve", VIEWPOINT, "--by", "A. Nurse", "--yes")

    async def _start(self, *arguments: str) -> Process:
        home = self.folder / "home"
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "network.cli.main", "robot", "--robot-dir", str(self._robots)),
            *("--genesis", str(self.genesis), *arguments),
            cwd=ROOT,
            env={**self._environment, "HOME": str(home), "TMPDIR": str(home), "BLOCKROBOT_HOME": str(self.folder)},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )


class LiveRobot(LiveCommands):
    """One that runs, on real nodes."""

    def __init__(
        self, robot: KilledRobot, folder: Path, topics: str, source: tuple[str, ...], environment: Mapping[str, str]
    ) -> None:
        super().__init__(folder, topics, source, environment, robot.robot.parent)
        self.robot = robot
        self.genesis = robot.network.folder / "genesis.json"
        self.notices: list[str] = []

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[Process]:
        """A live run, which listens already."""
        process = await self._start(
            *("run", *self._source, "--topics", str(self._topics), "--viewpoint", VIEWPOINT),
            *("--purpose", PURPOSE, "--json", *self.robot.approved),
        )
        try:
            await self.until_it_says(process, '"progress"')
            yield process
        finally:
            if process.returncode is None:
                process.kill()
                await process.communicate()

    async def until_it_says(self, process: Process, what: str) -> None:
        """Read what a run says until a line matches."""
        assert process.stderr is not None
        said = []
        async with asyncio.timeout(COMMAND_TIMEOUT_S):
            async for line in process.stderr:
                said.append(line.decode())
                self._note(said[-1])
                if re.search(what, said[-1]):
                    return
        raise AssertionError(f"it never said {what}, but {said[-5:]}")

    async def end(self, process: Process) -> dict[str, Any]:
        """End a run by Ctrl-C; return its summary."""
        process.send_signal(signal.SIGINT)
        output, said = await asyncio.wait_for(process.communicate(), END_TIMEOUT_S)
        assert process.returncode == 0, (output, said.decode()[-2_000:])
        for line in said.decode().splitlines():
            self._note(line)
        summary: dict[str, Any] = json.loads(output)
        return summary

    def _note(self, line: str) -> None:
        if '"notice"' in line:
            self.notices.append(json.loads(line)["notice"])

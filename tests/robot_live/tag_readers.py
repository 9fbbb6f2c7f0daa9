"""Tag readers in processes of their own: llrpkit's emulator on the loopback address. They end with the test."""

from __future__ import annotations

import asyncio
import json
import sys
from asyncio.subprocess import Process
from pathlib import Path
from typing import Any

from clients.robot.sources.messages.topics import LlrpReader
from tests.robot_live.ward import START_TIMEOUT_S, free_port

READER = Path(__file__).with_name("llrp_reader.py")
ANN, BEN = "E28011606000020500000001", "E28011606000020500000002"


class TagReaders:
    """The readers of a test."""

    def __init__(self) -> None:
        self.running: list[Process] = []

    async def start(self, port: int = 0, **settings: Any) -> LlrpReader:
        """Start a reader; return what a robot is told of it: antenna 1 looks forward, 2 back."""
        port = port or free_port()
        told = {"port": port, "tags": {ANN: [1], BEN: [2]}, **settings}
        self.running.append(
            await asyncio.create_subprocess_exec(
                *(sys.executable, str(READER), json.dumps(told)),
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
            )
        )
        output = self.running[-1].stdout
        assert output is not None
        assert await asyncio.wait_for(output.readline(), START_TIMEOUT_S) == b"ready\n"
        return LlrpReader("127.0.0.1", port, front=(1,), back=(2,))

    async def kill(self) -> None:
        """Kill the newest reader."""
        process = self.running.pop()
        process.kill()
        await process.communicate()

    async def stop(self) -> None:
        """Kill all that run."""
        while self.running:
            await self.kill()

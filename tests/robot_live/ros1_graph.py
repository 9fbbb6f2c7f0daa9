"""A real ROS 1 graph on this machine for tests: Debian's rosmaster, and drivers in processes of their own.

Everything binds to the loopback address, keeps its files in a folder of the test, and ends with it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
from asyncio.subprocess import Process
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.robot_live.ward import free_port, kill_all, published_counts, wait_for_port

DEBIAN_PYTHON = "/usr/bin/python3"
PUBLISHER = Path(__file__).with_name("ros1_publisher.py")


@dataclass
class Ros1Graph:
    """One master and whatever drivers a test starts. `folder` is for their files."""

    folder: Path
    port: int
    master: Process | None = None
    drivers: list[Process] = field(default_factory=list)

    @property
    def uri(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        """What every process of the graph is given."""
        kept = {name: value for name, value in os.environ.items() if not name.startswith("ROS")}
        return {
            **kept,
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(self.folder / "ros-home"),
            "PYTHONWARNINGS": "",
        }

    async def start_master(self) -> None:
        self.master = await asyncio.create_subprocess_exec(
            *(DEBIAN_PYTHON, "/usr/bin/rosmaster", "--core", "-p", str(self.port)),
            env=self.environment,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )
        await wait_for_port(self.port)

    async def kill_master(self) -> None:
        assert self.master is not None
        self.master.kill()
        await self.master.wait()

    async def start_drivers(self, scene: Path, **settings: Any) -> Process:
        """Start drivers that publish a scene; settings are those of `ros1_publisher`."""
        process = await asyncio.create_subprocess_exec(
            *(DEBIAN_PYTHON, str(PUBLISHER), json.dumps({"scene": str(scene), **settings})),
            env=self.environment,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        self.drivers.append(process)
        return process

    async def publish(self, scene: Path, **settings: Any) -> dict[str, int]:
        """Publish a scene to its end; return how many of each were published."""
        return await published_counts(await self.start_drivers(scene, **settings))

    async def stop(self) -> None:
        await kill_all([*self.drivers, *([self.master] if self.master else [])])


@contextlib.asynccontextmanager
async def ros1_graph(folder: Path) -> AsyncIterator[Ros1Graph]:
    """A running master, which nothing knows yet."""
    await asyncio.to_thread(folder.mkdir, parents=True, exist_ok=True)
    graph = Ros1Graph(folder, free_port())
    try:
        await graph.start_master()
        yield graph
    finally:
        await graph.stop()

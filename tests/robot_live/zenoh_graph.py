"""A real Zenoh network on this machine for tests: a router, and drivers in processes of their own, as with `rmw_zenoh`.

Everything binds to the loopback address, and ends with the test.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from asyncio.subprocess import Process
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.robot_live.ward import free_port, kill_all, published_counts, wait_for_port

PUBLISHER = Path(__file__).with_name("zenoh_publisher.py")
ROOT = Path(__file__).parents[2]


@dataclass
class ZenohGraph:
    """One router and whatever drivers a test starts."""

    port: int
    router: Process | None = None
    drivers: list[Process] = field(default_factory=list)

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self.port}"

    async def _start(self, **settings: Any) -> Process:
        return await asyncio.create_subprocess_exec(
            *(sys.executable, str(PUBLISHER), json.dumps({"port": self.port, **settings})),
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )

    async def start_router(self) -> None:
        self.router = await self._start(router=True)
        await wait_for_port(self.port)

    async def kill_router(self) -> None:
        assert self.router is not None
        self.router.kill()
        await self.router.communicate()

    async def start_drivers(self, scene: Path, **settings: Any) -> Process:
        """Start drivers that publish a scene; settings are those of `zenoh_publisher`."""
        process = await self._start(scene=str(scene), **{"rate": 10, "seconds": 1, **settings})
        self.drivers.append(process)
        return process

    async def publish(self, scene: Path, **settings: Any) -> dict[str, int]:
        """Publish a scene to its end; return how many of each were published."""
        return await published_counts(await self.start_drivers(scene, **settings))

    async def stop(self) -> None:
        await kill_all([*self.drivers, *([self.router] if self.router else [])])


@contextlib.asynccontextmanager
async def zenoh_graph() -> AsyncIterator[ZenohGraph]:
    """A running router, which nothing knows yet."""
    graph = ZenohGraph(free_port())
    try:
        await graph.start_router()
        yield graph
    finally:
        await graph.stop()

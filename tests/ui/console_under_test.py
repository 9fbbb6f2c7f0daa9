"""A real network with work, and the console's command beside it: what the console's stories and pictures begin with."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from pathlib import Path
from typing import Any

import aiohttp
from playwright.async_api import Page, expect

from tests.cluster.network_under_test import NetworkUnderTest

ROOT = Path(__file__).resolve().parents[2]
WORK_EVERY_S = 0.15
ANSWER_TIMEOUT_S = 60.0


class ConsoleUnderTest:
    """Nodes (four unless told otherwise) that always have something to do, and `blockrobot console` as a process."""

    def __init__(self, folder: Path, nodes: int = 4) -> None:
        self.folder = folder
        self.network = NetworkUnderTest(folder / "network", nodes=nodes, network="ward-seven")
        self._process: asyncio.subprocess.Process | None = None
        self._work: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start the nodes and the work."""
        await self.network.start()
        self._work = asyncio.create_task(self._keep_busy())

    async def _keep_busy(self) -> None:
        """Hand a transaction to whichever node takes it, again and again."""
        network = self.network
        while True:
            for name in network.names:
                if not network.cluster.is_running(name) or network.cluster.is_paused(name):
                    continue
                with contextlib.suppress(aiohttp.ClientError, TimeoutError):
                    async with asyncio.timeout(1.0):
                        await network.submit(name, [network.transaction()])
                    break
            await asyncio.sleep(WORK_EVERY_S)

    async def open(self, page: Page) -> None:
        """Start the command, and open the page as a browser that is handed its file does."""
        await self.end_console()
        command = ["-m", "network.cli.main", "console", "--dir", str(self.network.folder), "--no-browser", "--json"]
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            *command,
            stdout=asyncio.subprocess.PIPE,
            env={"BLOCKROBOT_HOME": str(self.folder / "home"), "PATH": "/usr/bin:/bin"},
            cwd=ROOT,
        )
        self.said = await self._read_object()
        assert self.said["ok"]
        await page.goto(Path(self.said["open"]).as_uri())
        await expect(page.get_by_role("heading", name="Cluster console")).to_be_visible()

    async def _read_object(self) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        text = b""
        async with asyncio.timeout(ANSWER_TIMEOUT_S):
            while True:
                line = await self._process.stdout.readline()
                assert line, "the console ended before it said where it is"
                text += line
                with contextlib.suppress(ValueError):
                    said: dict[str, Any] = json.loads(text)
                    return said

    async def end_console(self) -> None:
        """End the console as Ctrl-C does; the network goes on."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            await process.communicate()
            assert process.returncode == 0

    async def close(self) -> None:
        """End everything."""
        await self.end_console()
        if self._work is not None:
            self._work.cancel()
            await asyncio.gather(self._work, return_exceptions=True)
        await self.network.close()

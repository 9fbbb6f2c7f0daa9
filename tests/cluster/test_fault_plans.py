"""A plan of faults from the command line, under load, with somebody watching: what is said is what was done."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.cluster.story import WORK_TIMEOUT_S, Story
from tests.json_answers import differences

PLAN = """
seed = 11
[[step]]
at = "0"
do = "link"
link = "node-1 <-> node-2"
profile = "hospital-wifi"
[[step]]
at = "1s"
do = "kill"
node = "node-3"
[[step]]
at = "2s"
do = "kill"
node = "node-3"
[[step]]
at = "4s"
do = "restart"
node = "node-3"
[[step]]
at = "7s"
do = "heal"
"""

CHAOS = """
seed = {seed}
[[random]]
from = "0"
to = "30s"
every = "3s"
lasting = "2s"
do = ["kill", "pause", "partition", "link", "skew"]
[[step]]
at = "34s"
do = "heal"
"""


async def _blockrobot(*arguments: str) -> tuple[int, str]:
    """Run the command; return its exit code and what it printed."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "network.cli.main", *arguments, stdout=asyncio.subprocess.PIPE
    )
    output, _ = await process.communicate()
    return process.returncode or 0, output.decode()


def _said_of(pictures: list[dict[str, Any]], words: str) -> bool:
    return any(words in line for picture in pictures for line in picture["changes"])


class Watcher:
    """`blockrobot status --watch` as somebody leaves it on: `pictures` is what it has shown."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.pictures: list[dict[str, Any]] = []

    async def until(self, is_so: Callable[[list[dict[str, Any]]], bool]) -> None:
        """Wait until what was shown is so."""
        assert self.process.stdout is not None
        async with asyncio.timeout(WORK_TIMEOUT_S):
            while not is_so(self.pictures):
                line = await self.process.stdout.readline()
                assert line, "nothing more is shown"
                self.pictures.append(json.loads(line))


@asynccontextmanager
async def watching(folder: str) -> AsyncIterator[Watcher]:
    """Watch a network until the end of the block."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "network.cli.main", "status", "--watch", "--json", "--dir", folder),
        stdout=asyncio.subprocess.PIPE,
        limit=1 << 20,
    )
    try:
        yield Watcher(process)
    finally:
        process.terminate()
        await process.communicate()


async def test_a_plan_is_carried_out_under_load_and_the_watcher_sees_it(story: Story, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN, encoding="utf-8")
    folder = str(story.network.folder)
    await story.work("node-1", "node-2", "node-4")
    await story.until_told()
    started_s = time.monotonic()
    async with watching(folder) as watcher:
        await watcher.until(bool)
        planned = asyncio.create_task(_blockrobot("fault", "run", str(plan), "--json", "--dir", folder))
        await watcher.until(lambda pictures: _said_of(pictures, "node-1 faults: none"))
        code, output = await planned
    done = json.loads(output)
    assert [(step["do"], (step["error"] or {}).get("code")) for step in done["steps"]] == [
        ("link node-1 <-> node-2: 3-15 ms, 1.0% lost, 2500 kB/s", None),
        ("kill node-3", None),
        ("kill node-3", "FAULT_TARGET_ABSENT"),
        ("restart node-3", None),
        ("heal everything", None),
    ]
    assert (code, done["ok"]) == (1, False)
    pictures = watcher.pictures
    assert [line for picture in pictures for line in differences("status --watch", picture)] == []
    assert _said_of(pictures, "node-3 is stopped")
    assert _said_of(pictures, "node-1 faults: -> node-2: 3-15 ms")
    assert _said_of(pictures, "node-1 faults: none")
    assert pictures[-1]["finalized_height"] > pictures[0]["finalized_height"]
    await story.until_told()
    story.report_gap("plan", started_s)
    await story.end()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
async def test_half_a_minute_of_random_faults_loses_and_doubles_nothing(
    story: Story, tmp_path: Path, seed: int
) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(CHAOS.format(seed=seed), encoding="utf-8")
    await story.work()
    await story.until_told()
    started_s = time.monotonic()
    code, output = await _blockrobot("fault", "run", str(plan), "--json", "--dir", str(story.network.folder))
    assert code == 0, output
    await story.until_told()
    story.report_gap("chaos", started_s)
    await story.end()

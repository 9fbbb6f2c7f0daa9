"""A plan of faults from the command line, under load, with somebody watching: what is said is what was done."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.cluster.story import Story
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


async def test_a_plan_is_carried_out_under_load_and_the_watcher_sees_it(story: Story, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN, encoding="utf-8")
    folder = str(story.network.folder)
    await story.work("node-1", "node-2", "node-4")
    await story.until_told()
    started_s = time.monotonic()
    watching = asyncio.create_task(_blockrobot("status", "--watch", "--json", "--seconds", "14", "--dir", folder))
    await asyncio.sleep(2.0)
    code, output = await _blockrobot("fault", "run", str(plan), "--json", "--dir", folder)
    done = json.loads(output)
    assert [(step["do"], (step["error"] or {}).get("code")) for step in done["steps"]] == [
        ("link node-1 <-> node-2: 3-15 ms, 1.0% lost, 2500 kB/s", None),
        ("kill node-3", None),
        ("kill node-3", "FAULT_TARGET_ABSENT"),
        ("restart node-3", None),
        ("heal everything", None),
    ]
    assert (code, done["ok"]) == (1, False)
    pictures = [json.loads(line) for line in (await watching)[1].splitlines()]
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

"""The processes that run contracts are killed and stopped under load: no transaction is lost, all states stay equal."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.cluster.story import Story

KILLS_COUNT = 12
BACK_TIMEOUT_S = 90.0
"""A stopped worker is given up after fifteen seconds without processor time; machines are busy."""


def _command(pid: int) -> bytes:
    """The command line of a process, nothing if there is none."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except FileNotFoundError:
        return b""


async def _worker(story: Story, name: str) -> int:
    """The process of a node that runs contracts; one that was killed a moment ago is said to be there for a while."""

    def is_there(status: dict[str, Any]) -> bool:
        pid = status and status["contracts"]["blocks"]["pid"]
        return bool(pid) and b"node.execution.contract_worker" in _command(pid)

    said = await story.wait_until(name, is_there)
    return int(said["contracts"]["blocks"]["pid"])


async def _kill_in_turns(story: Story) -> None:
    for turn in range(KILLS_COUNT):
        name = story.names[turn % len(story.names)]
        os.kill(await _worker(story, name), signal.SIGKILL)
        await story.until_told(2)


async def test_workers_of_all_nodes_are_killed_under_load_again_and_again(story: Story) -> None:
    await story.work()
    await story.until_told()
    await _kill_in_turns(story)
    await story.until_told()
    for name in story.names:
        blocks = (await story.status(name))["contracts"]["blocks"]
        assert blocks["replaced"] >= KILLS_COUNT // len(story.names)
        assert blocks["missing"] == {}
    await story.end()


@pytest.mark.smoke
async def test_all_workers_are_killed_at_once(story: Story) -> None:
    await story.work()
    await story.until_told()
    for pid in [await _worker(story, name) for name in story.names]:
        os.kill(pid, signal.SIGKILL)
    await story.until_told(10)
    await story.end()


async def test_a_stopped_worker_holds_up_its_own_node_only_and_not_for_good(story: Story) -> None:
    await story.work("node-2", "node-3", "node-4")
    await story.until_told()
    os.kill(await _worker(story, "node-1"), signal.SIGSTOP)
    await story.until_told(10)

    def is_back(status: dict[str, Any]) -> bool:
        return bool(status and status["contracts"]["blocks"]["replaced"])

    await story.wait_until("node-1", is_back, BACK_TIMEOUT_S)
    await story.until_told(10)
    await story.end()


async def test_a_killed_node_leaves_no_worker_behind(story: Story) -> None:
    await story.work()
    await story.until_told()
    pid = await _worker(story, "node-1")
    story.cluster.kill("node-1")
    async with asyncio.timeout(BACK_TIMEOUT_S):
        while _command(pid):  # noqa: ASYNC110 - it ends in a process of its own
            await asyncio.sleep(0.1)
    story.cluster.start("node-1")
    await story.cluster.wait_ready(["node-1"])
    assert await _worker(story, "node-1") != pid
    await story.until_told()
    await story.end()

"""Calls and versions of contracts that use up the workers of some nodes, or of all: what is final goes on being final."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from pathlib import Path

from tests.cluster.commands import must
from tests.cluster.story import Story
from tests.cluster.test_contract_lifecycle import decide, write_source

WEAK_MIB = 6
"""Less than the modelled budget of a call (8 MiB), so that a call within the rules uses it up."""
AMPLE_MIB = 256
GAP_MAX_S = 25.0
KILLS_S = 8.0

GREEDY = '''
@export
def take(count: int) -> int:
    """Take so many times a hundred kilobytes."""
    taken = []
    for number in range(count):
        taken.append("x" * (100000 + number))
    return len(taken)
'''
MIGRATING = (
    GREEDY
    + '''

@migrate
def carry_over():
    """Take nearly all that a call may take."""
    take(75)
'''
)


def set_memory(story: Story, memory_mib: int, *names: str) -> None:
    """Start these nodes anew, with workers of this size."""
    cluster = story.network.cluster
    for name in names:
        cluster.stop(name)
        path = cluster.config(name).data_dir / "node.toml"
        lines = [line for line in path.read_text().splitlines() if not line.startswith("memory_mib")]
        place = lines.index("[contracts]") + 1
        path.write_text("\n".join([*lines[:place], f"memory_mib = {memory_mib}", *lines[place:]]) + "\n")
        cluster.start(name)


async def restart_with(story: Story, memory_mib: int, *names: str) -> None:
    set_memory(story, memory_mib, *names)
    await story.network.cluster.wait_ready()


async def deploy(story: Story, source: str) -> None:
    height = await decide(story.network, "propose", write_source(story.network, source), "--name", "greedy")
    await story.network.wait_height("node-1", height)


async def take(story: Story, node: str, count: int) -> None:
    """Submit a call; what becomes of it is not waited for."""
    transaction = story.network.transaction(contract="greedy", entry="take", arguments=[count])
    await story.network.submit(node, [transaction])


async def status_of(story: Story, version: int) -> str:
    shown = await must(story.network, "contract", "show", "greedy", "--version", str(version))
    return str(shown["status"])


async def test_calls_near_the_limit_of_some_workers_do_not_stop_finality(story: Story) -> None:
    """Two nodes can execute them and two cannot: neither is a quorum."""
    await deploy(story, GREEDY)
    await restart_with(story, WEAK_MIB, "node-1", "node-2")
    await story.work()
    await story.until_told(10)
    began_s = time.monotonic()
    for node in ("node-1", "node-3", "node-4"):
        await take(story, node, 75)
    await story.until_told(30)
    await asyncio.sleep(5)
    await story.until_told(10)
    assert story.report_gap("without finality, two of four workers exhausted", began_s) < GAP_MAX_S
    told = [(await story.status(name))["execution"] for name in ("node-1", "node-2")]
    assert any(one["failures"] for one in told), told
    await restart_with(story, AMPLE_MIB, "node-1", "node-2")
    await story.until_told(10)
    await story.end()


async def test_a_migration_that_exhausts_all_workers_fails_and_goes_through_once_they_may_take_more(
    story: Story,
) -> None:
    await deploy(story, GREEDY)
    await restart_with(story, WEAK_MIB, *story.names)
    await story.work()
    await story.until_told(10)
    began_s = time.monotonic()
    await deploy(story, MIGRATING)
    await story.until_told(10)
    assert story.report_gap("without finality, a migration exhausted all workers", began_s) < GAP_MAX_S
    assert await status_of(story, 2) == "failed"
    cluster = story.network.cluster
    cluster.stop_all()
    cluster.start_all()
    await cluster.wait_ready()
    await story.until_told(10)
    await restart_with(story, AMPLE_MIB, *story.names)
    await story.network.wait_height("node-1", await decide(story.network, "activate", "greedy", "2"))
    assert await status_of(story, 2) == "active"
    await story.until_told(10)
    await story.end()


async def test_workers_of_two_nodes_that_are_killed_in_a_loop_stop_nothing(story: Story) -> None:
    await story.work("node-1", "node-2", "node-3", "node-4")
    await story.until_told(10)
    began_s = time.monotonic()
    while time.monotonic() < began_s + KILLS_S:
        for name in ("node-1", "node-2"):
            pid = ((await story.status(name)) or {}).get("contracts", {}).get("blocks", {}).get("pid")
            if pid and b"node.execution.contract_worker" in _command(int(pid)):
                os.kill(int(pid), signal.SIGKILL)
        await asyncio.sleep(0.25)
    await story.until_told(10)
    assert story.report_gap("without finality, workers of two nodes killed in a loop", began_s) < GAP_MAX_S
    await story.end()


def _command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except FileNotFoundError:
        return b""

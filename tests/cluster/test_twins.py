"""One producer key on two machines: the second node on a copied data directory falls silent, or both are found out.

The field's incidents: a failover with one key forks the chain or confirms twice (EOSIO/eos#3442, #7600, #5538); measured
on EOS (Leap 4.1), two nodes with one key signed 24 of 24 slots twice under load, and nothing recorded evidence.
"""

from __future__ import annotations

import asyncio
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp

from network.cluster import fetch_status
from network.faults.actions import Kill, Restart
from node.config import CONFIG_FILE, NodeConfig, config_to_toml, load_config
from tests.cluster.commands import must
from tests.cluster.network_under_test import find_base_port
from tests.cluster.story import SAME_TIMEOUT_S, Story

NAME = "node-1"
TOGETHER_COUNT = 20
LOOKS_COUNT = 12
_POLL_S = 0.1


def _twin_of(story: Story, folder: Path) -> NodeConfig:
    """Copy the data directory of the node, which must be down, and give the copy ports of its own."""
    shutil.copytree(story.cluster.config(NAME).data_dir, folder)
    port = find_base_port(1)
    config = replace(load_config(folder), p2p_port=port, api_port=port + 1, operator_port=port + 2)
    (folder / CONFIG_FILE).write_text(config_to_toml(config), encoding="utf-8")
    return config


@contextmanager
def _running(config: NodeConfig) -> Iterator[None]:
    """Run a node that the cluster knows nothing of."""
    with (config.data_dir / "output.log").open("ab") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "node.main", "--data-dir", str(config.data_dir)], stdout=output, stderr=output
        )
    try:
        yield
        assert process.poll() is None, "the twin stopped by itself"
    finally:
        process.terminate()
        process.wait(timeout=60)


async def _status(config: NodeConfig) -> dict[str, Any]:
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=2)) as session:
        return await fetch_status(session, config) or {}


async def _same_as_others(story: Story, twin: NodeConfig) -> None:
    """The twin has the others' state, at the height that they agree on."""
    root = await story.same_state(story.names)
    for _ in range(round(SAME_TIMEOUT_S / _POLL_S)):
        if (said := await _status(twin)).get("state_root") == root:
            return
        await asyncio.sleep(_POLL_S)
    raise AssertionError(f"the twin stays apart: {said}")


async def _seat(story: Story) -> dict[str, Any]:
    listed = await must(story.network, "producer", "list")
    return next(row for row in listed["producers"] if row["node"] == NAME)


async def _is_noticed(story: Story, twin: NodeConfig) -> bool:
    """Tell whether one of the twins fell silent, or both words of one round brought the key before the chain."""
    logs = [config.log_path.read_text(encoding="utf-8") for config in (twin, story.cluster.config(NAME))]
    return any('"outdated"' in text for text in logs) or (await _seat(story))["status"] == "suspended"


async def test_two_nodes_with_one_producer_key_make_no_fork_and_never_go_unnoticed(
    story: Story, tmp_path: Path
) -> None:
    """Each new connection of a name takes the place of the older one: the twins throw each other out by turns."""
    await story.work("node-2", "node-3", "node-4")
    await story.until_told(10)
    await story.do(Kill(NAME))
    twin = _twin_of(story, tmp_path / "twin")
    await story.do(Restart(NAME))
    await story.cluster.wait_ready([NAME])
    await story.until_told(20)
    began_s = await story.do()
    with _running(twin):
        for _ in range(LOOKS_COUNT):
            await story.until_told(TOGETHER_COUNT)
            if await _is_noticed(story, twin):
                break
        await story.until_told(TOGETHER_COUNT)
        story.report_gap("twins", began_s)
        await story.rest()
        await _same_as_others(story, twin)
        seat = await _seat(story)
        story.report("seat", seat["status"])
        assert await _is_noticed(story, twin)
    await story.end(liars=[NAME])

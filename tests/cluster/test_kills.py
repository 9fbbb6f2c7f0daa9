"""Nodes are killed under load, one after another and all at once, and come back by themselves: no flag, no replay by hand.

The field's incidents: EOS refuses to start after kill -9 ("database dirty flag set", EOSIO/eos#4742, #5613, #5960,
leap#1007) and may lose its reversible blocks for good (eos#10140, spring#380); Tendermint waits for a vote that it cannot
sign again (tendermint#8739); BFT networks whose nodes were all restarted never agree again (besu#8307).
"""

from __future__ import annotations

import asyncio
import time

import pytest

from network.faults.actions import Kill, Restart
from tests.cluster.story import Story

GAP_MAX_S = 5.0
"""For a machine that is busy with other tests; with default settings a dead leader costs half a second."""


async def test_each_node_in_turn_is_killed_under_load_and_comes_back(story: Story) -> None:
    await story.work()
    await story.until_told()
    for name in story.names:
        killed_s = await story.do(Kill(name))
        await story.until_told(8)
        assert story.report_gap(f"{name}_killed", killed_s) < GAP_MAX_S
        back_s = await story.do(Restart(name))
        await story.cluster.wait_ready([name])
        await story.until_told()
        story.report_gap(f"{name}_back", back_s)
    await story.end()


@pytest.mark.smoke
async def test_power_is_cut_under_load_twice_and_everything_acknowledged_is_there(story: Story) -> None:
    """The second cut comes while the nodes start."""
    await story.work()
    await story.until_told(10)
    cut_s = await story.power_cut()
    for name in story.names:
        story.cluster.start(name)
    await asyncio.sleep(1.0)
    await story.power_cut()
    began_s = time.monotonic()
    for name in story.names:
        story.cluster.start(name)
    await story.cluster.wait_ready()
    story.report("restart_ready_s", round(time.monotonic() - began_s, 3))
    await story.until_told(10)
    story.report_gap("power_cut_twice", cut_s)
    await story.end()


@pytest.mark.parametrize("story", [1], indirect=True)
async def test_a_network_of_one_node_is_killed_and_goes_on(story: Story) -> None:
    """Elsewhere a single validator cannot be restarted (besu#6457). Nobody is there to ask what it said last."""
    await story.work()
    await story.until_told(10)
    killed_s = await story.do(Kill("node-1"))
    await story.do(Restart("node-1"))
    await story.until_told(10)
    story.report_gap("lone_node_killed", killed_s)
    await story.end()

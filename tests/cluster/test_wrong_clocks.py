"""A clock is wrong: safety needs none, and as long as a quorum's clocks agree, only the wrong one's turns are lost."""

from __future__ import annotations

import asyncio

import pytest

from network.faults.actions import Skew
from tests.cluster.story import Story

HOUR_MS = 3_600_000
WRONG_S = 8.0
GAP_MAX_S = 5.0
"""For a machine that is busy with other tests."""


@pytest.mark.parametrize("offset_ms", [HOUR_MS, -HOUR_MS], ids=["ahead", "behind"])
async def test_a_node_whose_clock_is_an_hour_off_stops_nobody(story: Story, offset_ms: int) -> None:
    await story.work("node-1", "node-3", "node-4")
    await story.until_told()
    wrong_s = await story.do(Skew("node-2", offset_ms))
    await asyncio.sleep(WRONG_S)
    right_s = await story.do(Skew("node-2", 0))
    assert story.report_gap("clock_off", wrong_s, right_s) < GAP_MAX_S
    await story.until_told()
    await story.end()


async def test_a_clock_that_jumps_back_and_forth_under_load_loses_and_doubles_nothing(story: Story) -> None:
    await story.work("node-1", "node-2", "node-3", "node-4")
    await story.until_told()
    first_s = await story.do(Skew("node-2", 4_000))
    for offset_ms in (-HOUR_MS, 4_000, -60_000, 0):
        await asyncio.sleep(1.0)
        await story.do(Skew("node-2", offset_ms))
    await story.until_told()
    story.report_gap("clock_jumps", first_s)
    await story.end()


async def test_when_every_clock_jumps_back_three_seconds_the_chain_does_not_wait_for_them(story: Story) -> None:
    """Blocks then carry the parent's time and a millisecond, as long as that is within the drift that voters allow."""
    await story.work("node-1", "node-2")
    await story.until_told()
    before = story.told_count
    jumped_s = await story.do(*(Skew(name, -3_000) for name in story.names))
    await story.until_told()
    assert story.told_count > before
    story.report_gap("all_clocks_back", jumped_s)
    await story.do(*(Skew(name, 0) for name in story.names))
    await story.end()

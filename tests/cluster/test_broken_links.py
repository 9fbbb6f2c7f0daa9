"""Links are cut, slow and lossy: whoever has a quorum goes on, nobody decides alone, and healing brings all together."""

from __future__ import annotations

import asyncio

import pytest

from network.faults.actions import Heal, Pause, Resume, SetLink, link_profile
from node.p2p.link_faults import LinkFault
from tests.cluster.story import Story

CUT_S = 8.0
"""Many rounds of the default timeout (500 ms)."""
GAP_MAX_S = 5.0
"""For a machine that is busy with other tests."""


async def test_a_node_that_is_paused_longer_than_the_timeout_costs_its_turns_and_comes_back(story: Story) -> None:
    await story.work("node-1", "node-2", "node-3")
    await story.until_told()
    paused_s = await story.do(Pause("node-4"))
    await asyncio.sleep(CUT_S)
    resumed_s = await story.do(Resume("node-4"))
    assert story.report_gap("paused", paused_s, resumed_s) < GAP_MAX_S
    await story.until_told()
    await story.end()


async def test_clients_of_a_node_that_freezes_as_leader_are_served_by_the_others(story: Story) -> None:
    """Elsewhere followers who never heard of a frozen leader's transactions wait with it (hyperledger/fabric#4438)."""
    frozen = await story.leader()
    await story.work(frozen)
    await story.until_told()
    paused_s = await story.do(Pause(frozen))
    await story.until_told()
    story.report_gap("own_node_frozen", paused_s)
    await story.do(Resume(frozen))
    await story.until_told()
    await story.end()


async def test_three_nodes_go_on_without_the_one_that_is_cut_off_which_catches_up(story: Story) -> None:
    await story.work("node-1", "node-2", "node-3")
    await story.until_told()
    cut_s = await story.do(story.control.reader.partition("node-4"))
    before = (await story.until_still("node-4"))["node-4"]
    await asyncio.sleep(CUT_S)
    assert (await story.status("node-4"))["finalized_height"] == before
    healed_s = await story.do(Heal())
    assert story.report_gap("cut_3_1", cut_s, healed_s) < GAP_MAX_S
    await story.until_told()
    await story.end()


@pytest.mark.smoke
async def test_two_and_two_decide_nothing_and_go_on_together_when_healed(story: Story) -> None:
    await story.work()
    await story.until_told()
    await story.do(story.control.reader.partition("node-1,node-2 | node-3,node-4"))
    heights = await story.until_still(*story.names)
    await asyncio.sleep(CUT_S)
    # What was final before the cut may be told long after it: a client whose own node lags asks the others in turn.
    assert max(write.height for write in story.history.writes) <= max(heights.values())
    assert {name: (await story.status(name))["finalized_height"] for name in story.names} == heights
    healed_s = await story.do(Heal())
    await story.until_told(1)
    story.report_gap("after_healing_2_2", healed_s)
    await story.until_told()
    await story.end()


async def test_one_direction_that_is_cut_stops_nobody(story: Story) -> None:
    await story.work()
    await story.until_told()
    one_way = [SetLink("node-1", name, LinkFault(cut=True)) for name in ("node-2", "node-3")]
    cut_s = await story.do(*one_way)
    await asyncio.sleep(CUT_S / 2)
    story.report_gap("one_way", cut_s)
    await story.do(Heal())
    await story.end()


async def test_over_links_that_lose_every_tenth_frame_everything_still_becomes_final(story: Story) -> None:
    await story.work()
    await story.until_told()
    lossy = link_profile("lossy")
    pairs = [(a, b) for place, a in enumerate(story.names) for b in story.names[place + 1 :]]
    sick_s = await story.do(*(SetLink(a, b, lossy, is_both=True) for a, b in pairs))
    await story.until_told(10)
    story.report_gap("lossy", sick_s)
    await story.do(Heal())
    await story.end()

"""A disk is full: who cannot write says so and signs nothing; freed, it goes on by itself, and nothing was lost."""

from __future__ import annotations

import asyncio

import pytest

from network.faults.actions import FillDisk, Kill, Restart
from tests.cluster.story import Story

FULL_S = 3.0
SILENT_S = 8.0
GAP_MAX_S = 5.0
"""For a machine that is busy with other tests."""


@pytest.mark.parametrize("disk", ["journal", "ledger"])
async def test_one_full_disk_silences_its_node_until_it_is_freed(story: Story, disk: str) -> None:
    await story.work("node-1", "node-2", "node-4")
    await story.until_told()
    full_s = await story.do(FillDisk("node-3", disk))
    await story.wait_until("node-3", lambda said: bool(said.get("fault")))
    await asyncio.sleep(SILENT_S)
    freed_s = await story.do(FillDisk("node-3", disk, is_full=False))
    assert story.report_gap(f"full_{disk}", full_s, freed_s) < GAP_MAX_S
    await story.wait_until("node-3", lambda said: said.get("fault") == "" and bool(said.get("ready")))
    await story.until_told()
    await story.end()


async def test_when_every_journal_is_full_nothing_is_said_and_freed_all_go_on(story: Story) -> None:
    await story.work("node-1", "node-3")
    await story.until_told()
    await story.do(*(FillDisk(name, "journal") for name in story.names))
    for name in story.names:
        await story.wait_until(name, lambda said: bool(said.get("fault")))
    before = story.told_count
    await asyncio.sleep(FULL_S)
    assert story.told_count <= before + len(story.clients)
    freed_s = await story.do(*(FillDisk(name, "journal", is_full=False) for name in story.names))
    await story.until_told()
    story.report_gap("all_disks_freed", freed_s)
    await story.end()


async def test_a_node_that_is_killed_on_a_full_disk_starts_on_it_and_goes_on_when_it_is_freed(story: Story) -> None:
    """Elsewhere such a node cannot start again (hyperledger/fabric#4162)."""
    await story.work("node-1", "node-2", "node-4")
    await story.until_told()
    full_s = await story.do(*(FillDisk("node-3", disk) for disk in ("journal", "ledger")))
    await story.wait_until("node-3", lambda said: bool(said.get("fault")))
    await story.do(Kill("node-3"), Restart("node-3"))
    await story.cluster.wait_answering("node-3")
    await story.until_told()
    freed_s = await story.do(*(FillDisk("node-3", disk, is_full=False) for disk in ("journal", "ledger")))
    story.report_gap("killed_on_a_full_disk", full_s, freed_s)
    await story.wait_until("node-3", lambda said: said.get("fault") == "" and bool(said.get("ready")))
    await story.until_told()
    await story.end()

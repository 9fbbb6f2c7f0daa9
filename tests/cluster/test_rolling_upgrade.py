"""All nodes are restarted one after another while the organisations change a setting; clients notice neither.

The field's incidents: adding a validator halts the network (besu#8425), one validator that is down degrades it (besu#6398,
#6613), finality is violated or lost where the rules change (spring#351, #319, leap#2277).
"""

from __future__ import annotations

from network.faults.actions import Restart
from tests.cluster.commands import must
from tests.cluster.story import Story

NEW_TIMEOUT_MS = 700
GAP_MAX_S = 5.0
"""For a machine that is busy with other tests."""


async def _restart(story: Story, *names: str) -> None:
    for name in names:
        await story.do(Restart(name))
        await story.cluster.wait_ready([name])


async def test_a_rolling_restart_with_a_change_of_settings_half_way(story: Story) -> None:
    await story.work()
    await story.until_told()
    began_s = await story.do()
    await _restart(story, "node-1", "node-2")
    proposed = await must(
        story.network, "settings", "propose", "base_timeout_ms", str(NEW_TIMEOUT_MS), "--as", "hospital"
    )
    await _restart(story, "node-3")
    approved = await must(story.network, "settings", "approve", proposed["proposal"]["id"], "--as", "university")
    assert (approved["executed"], approved["epoch"]) == (True, 1)
    await _restart(story, "node-4")
    await story.until_told()
    assert story.report_gap("rolling_restart", began_s) < GAP_MAX_S
    listed = await must(story.network, "settings", "list")
    assert listed["settings"]["base_timeout_ms"] == NEW_TIMEOUT_MS
    for name in story.names:
        await story.wait_until(name, lambda said: said.get("epoch") == 1)
    await story.end()

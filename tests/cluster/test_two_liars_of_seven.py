"""Two of seven producers lie with their genuine keys, as many as seven bear: both are suspended, and nobody else.

The field's incidents: votes that contradict each other leave no evidence (two EOS producers with one key signed 24 of 24
slots twice, and nothing recorded it), or evidence that differs from node to node (CVE-2021-21271).
"""

from __future__ import annotations

from typing import Any

import pytest

from network.faults.actions import GoByzantine, Restart
from tests.cluster.commands import must
from tests.cluster.story import Story

LIARS = {"node-6": "equivocate", "node-7": "double-vote"}
LOOKS_COUNT = 20


async def _listed(story: Story) -> dict[str, dict[str, Any]]:
    """What `blockrobot producer list` shows, by node."""
    return {row["node"]: row for row in (await must(story.network, "producer", "list"))["producers"]}


@pytest.mark.parametrize("story", [7], indirect=True)
async def test_an_equivocator_and_a_double_voter_are_both_suspended_by_their_own_signatures(story: Story) -> None:
    honest = [name for name in story.names if name not in LIARS]
    await story.work("node-1", "node-3")
    await story.until_told()
    lying_s = await story.do(*(GoByzantine(name, how, seed=11) for name, how in LIARS.items()))
    for name in LIARS:
        await story.cluster.wait_answering(name)
    rows = await _listed(story)
    for _ in range(LOOKS_COUNT):
        if {rows[name]["status"] for name in LIARS} == {"suspended"}:
            break
        await story.until_told(5)
        rows = await _listed(story)
    story.report_gap("two_liars", lying_s)
    for name in LIARS:
        assert (rows[name]["status"], rows[name]["leads"]) == ("suspended", False)
        assert rows[name]["evidence"]["first_id"] < rows[name]["evidence"]["second_id"]
    assert {rows[name]["status"] for name in honest} == {"producing"}
    assert not any(rows[name]["evidence"] for name in honest)
    await story.do(*(Restart(name) for name in LIARS))
    for name in LIARS:
        await story.cluster.wait_answering(name)
    await story.until_told()
    await story.end(liars=LIARS)

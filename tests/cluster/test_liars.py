"""One of four producers lies with its genuine key: nobody is deceived, work goes on, and what can be proved is punished."""

from __future__ import annotations

from typing import Any

import pytest

from clients.sdk.network_client import NetworkClient
from network.byzantine import BEHAVIOURS
from network.faults.actions import GoByzantine, Restart
from tests.cluster.story import Story

LIAR = "node-4"
PROVABLE = ("equivocate", "double-vote")
"""What leaves two signatures of one round behind."""
REWRITING = ("wrong-roots", "stale-certificates", "forged-certificates", "wrong-epochs")
"""What signs another block than its journal holds: made honest it may send the journal's last messages, and be caught."""


async def _seat(story: Story) -> dict[str, Any]:
    """The liar's entry among the producers, proved by an honest node."""
    genesis = story.network.genesis
    honest = genesis.nodes[0]
    key = b"producers\x00candidate/" + genesis.node(LIAR).producer_key
    async with NetworkClient(genesis, {honest.name: honest.api_url}) as reader:
        entry: dict[str, Any] = (await reader.state_values([key], story.clients[0].key)).values[key]
        return entry


async def _lie(story: Story, behaviour: str) -> None:
    await story.work("node-1", "node-2", "node-3")
    await story.until_told()
    assert (await _seat(story))["status"] == "producing"
    lying_s = await story.do(GoByzantine(LIAR, behaviour, seed=7))
    await story.cluster.wait_answering(LIAR)
    await story.until_told(30)
    story.report_gap(behaviour, lying_s)


@pytest.mark.parametrize("behaviour", [pytest.param(PROVABLE[0], marks=pytest.mark.smoke), *PROVABLE[1:]])
async def test_who_contradicts_itself_is_suspended_by_the_evidence_and_stays_so_when_honest(
    story: Story, behaviour: str
) -> None:
    await _lie(story, behaviour)
    for _ in range(30):
        if (await _seat(story))["status"] == "suspended":
            break
        await story.until_told(3)
    seat = await _seat(story)
    assert seat["status"] == "suspended"
    # Who equivocates votes for both of its blocks: whichever is noticed first is the evidence.
    assert seat["evidence"]["kind"] in ({"proposal", "vote"} if behaviour == "equivocate" else {"vote"})
    await story.do(Restart(LIAR))
    await story.cluster.wait_answering(LIAR)
    await story.until_told()
    assert (await _seat(story))["status"] == "suspended"
    await story.end(liars=[LIAR])


@pytest.mark.long
@pytest.mark.parametrize("behaviour", sorted(set(BEHAVIOURS) - set(PROVABLE)))
async def test_other_lies_deceive_nobody_stop_nothing_and_end_with_a_restart(story: Story, behaviour: str) -> None:
    await _lie(story, behaviour)
    await story.do(Restart(LIAR))
    await story.cluster.wait_answering(LIAR)
    await story.until_told()
    if behaviour not in REWRITING:
        assert (await _seat(story))["status"] == "producing"
    await story.end(liars=[LIAR])

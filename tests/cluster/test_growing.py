"""A network takes producers in and lets them go under load, until none of the first ones is left.

All is done as its users do it, with commands. What is checked comes from the clients' own books.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from clients.sdk.network_client import NetworkClient
from consensus.primitives.keys import PrivateKey
from consensus.state.producers import EPOCH
from tests.cluster.commands import agree, must
from tests.cluster.network_under_test import NetworkUnderTest, find_base_port
from tests.cluster.story import Story
from tests.cluster.test_membership import knock_as

TWO_ROUNDS_S = 1.5
"""Two rounds that time out, one after the other, by the default settings: 500 ms and then twice as long."""
BUSY_MACHINE_FACTOR = 4
"""What is allowed beyond that for ten nodes, their clients and commands that share two cores with other work."""


async def add(story: Story, *options: str) -> str:
    """Take one more producer in: keys, agreement, start, votes, its own word, its seat."""
    port = str(find_base_port(1))
    added = await must(story.network, "node", "add", "--producer", "--base-port", port, *options)
    assert added["waiting_for"] == []
    story.network.took_in(added["node"])
    return str(added["node"])


async def seated(network: NetworkUnderTest) -> list[str]:
    """Whose turns the schedule has, in their order, as the state proves it."""
    listed = await must(network, "producer", "list")
    turns = {row["turn"]: row["node"] for row in listed["producers"] if row["turn"] is not None}
    return [turns[turn] for turn in sorted(turns)]


async def follow(story: Story, names: Sequence[str], epoch: int) -> None:
    """Wait until these nodes are in an epoch."""
    for name in names:
        await story.wait_until(name, lambda said: said.get("epoch", -1) >= epoch)


async def cut_off(story: Story, name: str, others: Sequence[str]) -> None:
    """A removed node has no peers, its certificate opens no door, and it says itself what it is."""
    for other in others:
        await story.wait_until(other, lambda said: "peers" in said and name not in said["peers"])
    await knock_as(story.network, name, others[0])
    await story.wait_until(name, lambda said: not said.get("peers", [name]))
    refused = await story.network.submit_anyhow(name)
    assert refused["code"] == "NODE_REMOVED", "what it took in would never be final"


def report_gap(story: Story, what: str, from_s: float) -> None:
    gap_s = story.report_gap(what, from_s)
    story.report(f"two_timed_out_rounds_{what}", round(gap_s / TWO_ROUNDS_S, 2))
    assert gap_s < BUSY_MACHINE_FACTOR * TWO_ROUNDS_S, f"nothing became final for {gap_s:.2f} s"


async def proved_producers(wallet: NetworkClient, key: PrivateKey) -> dict[str, Any]:
    await wallet.catch_up(key)  # some node may be a block behind the one that was told of the change
    found: dict[str, Any] = (await wallet.state_values([EPOCH.flat], key)).values[EPOCH.flat]
    return found


def names_of(client: NetworkClient) -> set[str]:
    return {node.name for node in client.nodes}


async def test_one_producer_takes_anothers_place_and_one_changes_its_key_under_load(
    story: Story, tmp_path: Path
) -> None:
    network, registrar = story.network, story.network.registrar
    async with NetworkClient(network.genesis) as wallet:
        await wallet.newest_header(registrar)
        await story.work("node-2", "node-3")
        await story.until_told()
        began_s = time.monotonic()

        assert await add(story, "--organisation", "hospital") == "node-5"
        assert await seated(network) == ["node-1", "node-2", "node-3", "node-4", "node-5"]
        removed = await agree(network, "remove-node", "node-1")
        left = ["node-2", "node-3", "node-4", "node-5"]
        await follow(story, left, removed["epoch"])
        await cut_off(story, "node-1", left)
        new_key = await rekey(network, "node-2", tmp_path / "new-producer.key")
        await story.until_told()
        report_gap(story, "replacing_and_rekeying", began_s)

        decided = await proved_producers(wallet, registrar)
        assert decided["producers"][0] == new_key.public_key
        assert network.genesis.node("node-1").producer_key not in decided["producers"]
        assert names_of(wallet) == set(left)
        pinned = wallet.pinned
    async with NetworkClient(network.genesis, pinned=pinned) as later:
        assert names_of(later) == set(left)
        assert (await later.newest_header(registrar)).epoch == decided["number"]
    await signs_with_its_new_key(story, "node-2")
    await story.end(without=["node-1"])


async def rekey(network: NetworkUnderTest, name: str, path: Path) -> PrivateKey:
    """Let the organisations agree on a new producer key of a node, and give it to the node at that moment."""
    new_key = PrivateKey(secrets.token_bytes(32))
    await asyncio.to_thread(path.write_bytes, new_key.secret)
    await agree(network, "rekey-producer", name, "--producer-key", str(path))
    place = network.cluster.config(name).producer_key_path
    assert place is not None
    await asyncio.to_thread(network.cluster.stop, name)
    await asyncio.to_thread(place.write_bytes, new_key.secret)
    network.cluster.start(name)
    await network.cluster.wait_ready([name])
    return new_key


async def signs_with_its_new_key(story: Story, name: str) -> None:
    """Three of four make a quorum; without one of the others, nothing is final but with this node's votes."""
    await asyncio.to_thread(story.cluster.pause, "node-4")
    await story.until_told()
    story.cluster.resume("node-4")
    assert (await story.status(name))["lockout"] is None


@pytest.mark.long
@pytest.mark.timeout(1200)
async def test_four_grow_to_seven_and_ten_and_four_others_are_left(story: Story) -> None:
    network, registrar = story.network, story.network.registrar
    first = list(story.names)
    await story.work(*first)
    await story.until_told()

    for goal in (7, 10):
        began_s = time.monotonic()
        while len(story.names) < goal:
            # The two that come last are custodians: they take over from node-1 and node-2.
            await add(story, *(["--custodian"] if len(story.names) >= 8 else []))
        assert await seated(network) == story.names
        await story.until_told()
        report_gap(story, f"growing_to_{goal}", began_s)
    async with NetworkClient(network.genesis) as wallet:
        await wallet.newest_header(registrar)
        pinned_at_ten = wallet.pinned

    began_s = time.monotonic()
    for gone in ("node-1", "node-2", "node-3", "node-4", "node-5", "node-6"):
        if gone in ("node-5", "node-6"):  # to retire one's own needs nobody else; it follows on without a seat
            owner = (await story.status(gone))["organisation"]
            await must(network, "producer", "remove", gone, "--as", owner)
        removed = await agree(network, "remove-node", gone)
        left = story.names[story.names.index(gone) + 1 :]
        await follow(story, left, removed["epoch"] or 0)
        await cut_off(story, gone, left)
        await asyncio.to_thread(network.cluster.stop, gone)
    last = ["node-7", "node-8", "node-9", "node-10"]
    assert await seated(network) == last
    await story.until_told()
    report_gap(story, "shrinking_to_4", began_s)

    async with NetworkClient(network.genesis, pinned=pinned_at_ten) as later:
        decided = await proved_producers(later, registrar)
        assert names_of(later) == set(last)
    keys = {node.producer_key for node in network.genesis.nodes}
    assert len(decided["producers"]) == 4
    assert not keys.intersection(decided["producers"])
    await story.end(without=[name for name in story.names if name not in last])

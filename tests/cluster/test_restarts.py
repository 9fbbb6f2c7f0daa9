"""Nodes are killed and come back: what was acknowledged is still there, and those who were away catch up."""

from __future__ import annotations

import asyncio
import json

from consensus.transaction import Transaction
from tests.cluster.network_under_test import NetworkUnderTest


async def _stream(network: NetworkUnderTest, name: str, stop: asyncio.Event) -> list[Transaction]:
    """Submit one after another to one node, each once the one before is final; return those acknowledged."""
    acknowledged: list[Transaction] = []
    while not stop.is_set():
        transaction = network.transaction()
        await network.finalize(name, transaction)
        acknowledged.append(transaction)
    return acknowledged


async def test_the_leader_is_killed_under_load_and_nothing_acknowledged_is_lost(network: NetworkUnderTest) -> None:
    await network.finalize("node-1", network.transaction())
    victim = (await network.status("node-1"))["leader"]
    clients = [name for name in network.names if name != victim]
    stop = asyncio.Event()
    streams = [asyncio.create_task(_stream(network, name, stop)) for name in clients]
    await asyncio.sleep(1.0)
    await asyncio.to_thread(network.cluster.kill, victim)
    await asyncio.sleep(4.0)
    network.cluster.start(victim)
    await network.cluster.wait_ready([victim])
    stop.set()
    acknowledged = [transaction for stream in await asyncio.gather(*streams) for transaction in stream]
    assert len(acknowledged) > 10
    last = network.transaction()
    await network.finalize(victim, last)
    for transaction in [*acknowledged, last]:
        blocks = {await network.block_id(name, transaction.txid) for name in (victim, clients[0])}
        assert len(blocks) == 1


async def test_a_node_that_was_away_for_many_blocks_fetches_them(network: NetworkUnderTest) -> None:
    await asyncio.to_thread(network.cluster.stop, "node-4")
    for _ in range(60):
        await network.finalize("node-1", network.transaction())
    height = (await network.status("node-1"))["finalized_height"]
    assert height > 60
    network.cluster.start("node-4")
    await network.wait_height("node-4", height)
    await network.finalize("node-4", network.transaction())
    log = network.cluster.config("node-4").log_path.read_text(encoding="utf-8")
    installed = [json.loads(line)["blocks"] for line in log.splitlines() if "sync_finished" in line]
    assert installed
    assert max(installed) > 60


async def test_all_four_are_killed_at_once_and_the_chain_goes_on_where_it_was(network: NetworkUnderTest) -> None:
    before = [network.transaction() for _ in range(20)]
    for transaction in before:
        await network.finalize("node-2", transaction)
    for name in network.names:
        await asyncio.to_thread(network.cluster.kill, name)
    await network.start()
    after = network.transaction()
    await network.finalize("node-3", after)
    for transaction in [*before, after]:
        blocks = {await network.block_id(name, transaction.txid) for name in network.names}
        assert len(blocks) == 1


async def test_all_four_stop_cleanly_and_start_again(network: NetworkUnderTest) -> None:
    transaction = network.transaction()
    first = await network.finalize("node-1", transaction)
    await asyncio.to_thread(network.cluster.stop_all)
    await network.start()
    assert (await network.place("node-4", transaction.txid))["block_id"] == first["block_id"]
    await network.finalize("node-4", network.transaction())

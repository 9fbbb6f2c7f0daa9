"""Nodes are stopped and come back: what was acknowledged is still there, and those who were away catch up."""

from __future__ import annotations

import asyncio

from tests.cluster.network_under_test import NetworkUnderTest


async def test_a_node_that_was_away_for_many_blocks_fetches_them(network: NetworkUnderTest) -> None:
    """By sync or, where it is a matter of some dozens, as ancestors of what its peers greet it with."""
    await asyncio.to_thread(network.cluster.stop, "node-4")
    missed = [network.transaction() for _ in range(60)]
    for transaction in missed:
        await network.finalize("node-1", transaction)
    height = (await network.status("node-1"))["finalized_height"]
    assert height >= 60
    network.cluster.start("node-4")
    await network.wait_height("node-4", height)
    for transaction in missed[::10]:
        assert len({await network.block_id(name, transaction.txid) for name in ("node-1", "node-4")}) == 1
    await network.finalize("node-4", network.transaction())


async def test_all_four_stop_cleanly_and_start_again(network: NetworkUnderTest) -> None:
    transaction = network.transaction()
    first = await network.finalize("node-1", transaction)
    await asyncio.to_thread(network.cluster.stop_all)
    await network.start()
    assert await network.block_id("node-4", transaction.txid) == first["block_id"]
    await network.finalize("node-4", network.transaction())

"""Four processes agree on one order of transactions, whichever node they were handed to."""

from __future__ import annotations

import asyncio

import pytest
import pytest_asyncio

from tests.cluster.network_under_test import NetworkUnderTest

pytestmark = [pytest.mark.smoke, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def network(shared_network: NetworkUnderTest) -> NetworkUnderTest:
    """One network for all tests here: none of them breaks it."""
    return shared_network


MANY_COUNT = 250
"""Within what one sender may have looked at in one go."""
QUIET_MAX_S = 20.0
"""How long a busy machine may take to bring the last rounds to their end; an idle network's next block comes later."""


async def test_a_transaction_handed_to_any_node_is_final_on_every_node_in_the_same_block(
    network: NetworkUnderTest,
) -> None:
    for name in network.names:
        transaction = network.transaction()
        await network.finalize(name, transaction)
        blocks = {await network.block_id(other, transaction.txid) for other in network.names}
        assert len(blocks) == 1


async def test_many_transactions_at_once_are_all_final_and_each_only_once(network: NetworkUnderTest) -> None:
    transactions = [network.transaction() for _ in range(MANY_COUNT)]
    await asyncio.gather(
        *(
            network.submit(name, transactions[start : start + 50])
            for start in range(0, MANY_COUNT, 50)
            for name in network.names[:2]
        )
    )
    places = await asyncio.gather(*(network.place("node-3", item.txid, 20_000) for item in transactions))
    assert {place["status"] for place in places} == {"finalized"}
    assert len({(place["height"], place["index"]) for place in places}) == MANY_COUNT


async def test_an_idle_network_makes_no_blocks(network: NetworkUnderTest) -> None:
    await network.finalize("node-1", network.transaction())
    async with asyncio.timeout(QUIET_MAX_S):
        before = -1
        while (now := (await network.status("node-1"))["round"]) != before:
            before = now
            await asyncio.sleep(1.0)
    await asyncio.sleep(2.0)
    assert (await network.status("node-1"))["round"] == before


async def test_a_transaction_that_is_final_is_refused_when_it_comes_again(network: NetworkUnderTest) -> None:
    transaction = network.transaction()
    await network.finalize("node-1", transaction)
    await network.block_id("node-2", transaction.txid)
    for name in ("node-1", "node-2"):
        answer = (await network.submit(name, [transaction]))[0]
        assert answer["status"] == "rejected"
        assert answer["error"]["code"] == "TRANSACTION_REPLAYED"

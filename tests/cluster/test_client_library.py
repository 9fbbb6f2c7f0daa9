"""The client library against real nodes: every answer is proved from the genesis file alone."""

from __future__ import annotations

import asyncio

import pytest

from clients.sdk.network_client import NetworkClient
from clients.sdk.quorum import confirm_with_quorum, is_rejected_by_network
from clients.sdk.trust_pin import open_pin
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from tests.cluster.network_under_test import NetworkUnderTest


async def test_a_call_is_proved_final_and_its_state_can_be_read_at_once_from_every_node(
    network: NetworkUnderTest,
) -> None:
    urls = {node.name: node.api_url for node in network.genesis.nodes}
    async with NetworkClient(network.genesis) as client:
        transaction = network.transaction()
        receipt = await client.submit_and_wait(transaction)
        assert (receipt.txid, receipt.height >= 1) == (transaction.txid, True)
        for name, url in urls.items():
            async with NetworkClient(network.genesis, {name: url}, pinned=client.pinned) as one:
                state = await one.state_values([b"records\x00announcement-count"], network.registrar)
                assert state.height >= receipt.height
                assert state.values == {b"records\x00announcement-count": None}
                assert (await one.announcements(0, network.registrar)).count == 0


async def test_who_reads_from_node_to_node_is_never_led_back_though_one_lags(network: NetworkUnderTest) -> None:
    ahead, behind = network.names[0], network.names[1]
    count = [b"records\x00announcement-count"]
    async with NetworkClient(network.genesis) as client:
        await client.submit_and_wait(network.transaction())
        network.cluster.pause(behind)
        try:
            for _ in range(3):
                await client.submit_and_wait(network.transaction())
            async with NetworkClient(network.genesis, {ahead: network.url(ahead)}) as first:
                shown = await first.state_values(count, network.registrar)
        finally:
            network.cluster.resume(behind)
        async with NetworkClient(network.genesis, {behind: network.url(behind)}, pinned=first.pinned) as second:
            assert (await second.state_values(count, network.registrar)).height >= shown.height


async def test_many_clients_receipts_are_proved_wherever_they_ask(network: NetworkUnderTest) -> None:
    async with NetworkClient(network.genesis) as client:
        transactions = [network.transaction() for _ in range(40)]
        assert await client.submit_batch(transactions) == [None] * 40
        receipts = await asyncio.gather(*(client.wait_final(item.txid) for item in transactions))
        assert [receipt.txid for receipt in receipts] == [item.txid for item in transactions]
        assert open_pin(network.genesis, client.pinned)[0].header.height >= max(one.height for one in receipts)


async def test_the_client_goes_on_when_the_node_it_talks_to_dies(network: NetworkUnderTest) -> None:
    async with NetworkClient(network.genesis) as client:
        await client.submit_and_wait(network.transaction())
        network.cluster.kill(network.names[0])
        receipt = await client.submit_and_wait(network.transaction())
        assert receipt.height >= 2


async def test_a_view_is_answered_and_an_unknown_one_is_refused(network: NetworkUnderTest) -> None:
    async with NetworkClient(network.genesis) as client:
        assert await client.query("records", "announcements", [0, 10], network.registrar) == []
        with pytest.raises(BlockRobotError, match=r"^TRANSACTION_CONTRACT_UNKNOWN:"):
            await client.query("records", "nothing", [], network.registrar)


async def test_a_quorum_is_heard_over_one_node_that_is_gone_and_not_over_two(network: NetworkUnderTest) -> None:
    async with NetworkClient(network.genesis) as client:
        await client.submit_and_wait(network.transaction())
        assert await confirm_with_quorum(client, network.registrar)
        network.cluster.kill(network.names[0])
        assert await confirm_with_quorum(client, network.registrar)
        network.cluster.kill(network.names[1])
        assert not await confirm_with_quorum(client, network.registrar)
        assert not await is_rejected_by_network(client, network.registrar)
        assert await is_rejected_by_network(client, PrivateKey(bytes([77]) * 32))

"""Custodians that keep their data on a MongoDB-compatible server: each follows the chain in a database of its own."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from pymongo import MongoClient

from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest, running


@pytest.fixture
async def mongo_network(mongo_uri: str, tmp_path: Path) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes, two of them custodians on the server."""
    own_name = f"test-{secrets.token_hex(4)}"  # a server given by MONGO_URI may hold other networks' databases
    async with running(NetworkUnderTest(tmp_path / "network", nodes=4, store=mongo_uri, network=own_name)) as network:
        yield network
        with MongoClient(mongo_uri) as client:
            for name in _databases(network).values():
                client.drop_database(name)


def _databases(network: NetworkUnderTest) -> dict[str, str]:
    """The database of each custodian, by its node's name."""
    stores = {node.name: network.cluster.config(node.name).custody_store for node in network.genesis.custodians}
    return {name: urlsplit(store).path.lstrip("/") for name, store in stores.items()}


async def _wait_checkpoint(network: NetworkUnderTest, name: str, height: int) -> None:
    deadline = time.monotonic() + FINAL_TIMEOUT_S
    while ((await network.status(name)).get("custody_checkpoint") or -1) < height:
        assert time.monotonic() < deadline, f"the custodian of {name} did not follow to height {height}"
        await asyncio.sleep(0.1)


@pytest.mark.smoke
async def test_custodians_follow_the_chain_each_in_a_database_of_its_own_and_go_on_after_a_kill(
    mongo_network: NetworkUnderTest, mongo_uri: str
) -> None:
    network, databases = mongo_network, _databases(mongo_network)
    assert len(set(databases.values())) == len(databases) == 2
    for _ in range(5):
        place = await network.finalize("node-3", network.transaction())
    for name in databases:
        await _wait_checkpoint(network, name, place["height"])

    killed = next(iter(databases))
    await asyncio.to_thread(network.cluster.kill, killed)
    for _ in range(5):
        place = await network.finalize("node-3", network.transaction())
    network.cluster.start(killed)
    await network.cluster.wait_ready([killed])
    for name in databases:
        await _wait_checkpoint(network, name, place["height"])

    with MongoClient(mongo_uri) as client:
        for database in databases.values():
            (point,) = client[database]["checkpoint"].find()
            assert point["height"] >= place["height"]
            assert client[database]["missing"].count_documents({}) == 0

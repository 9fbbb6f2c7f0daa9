"""Producers and settings change on a running network under load: nothing stops, nothing is lost, every client follows."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Sequence
from typing import Any

from clients.sdk.network_client import NetworkClient
from consensus.primitives.keys import PrivateKey
from consensus.state.producers import EPOCH
from tests.cluster.network_under_test import FINAL_TIMEOUT_S, NetworkUnderTest

GAP_MAX_S = 6.0
"""Two timed-out rounds of the default settings, four times over for a machine that is busy with other tests."""


class Load:
    """Clients that submit one transaction after another, and when each was acknowledged."""

    def __init__(self, network: NetworkUnderTest, clients: list[str]) -> None:
        self.network = network
        self.acknowledged: list[bytes] = []
        self.times: list[float] = []
        self._stop = asyncio.Event()
        self._tasks = [asyncio.create_task(self._stream(name)) for name in clients]

    async def _stream(self, name: str) -> None:
        while not self._stop.is_set():
            transaction = self.network.transaction()
            await self.network.finalize(name, transaction)
            self.acknowledged.append(transaction.txid)
            self.times.append(time.monotonic())

    async def end(self) -> float:
        """Stop; return the longest time without an acknowledgement (s)."""
        self._stop.set()
        await asyncio.gather(*self._tasks)
        return max(later - earlier for earlier, later in itertools.pairwise(sorted(self.times)))


class Organisations:
    """The admins of both organisations, who decide together."""

    def __init__(self, network: NetworkUnderTest) -> None:
        self._network = network
        folders = [network.folder / "organisations" / entry.name for entry in network.genesis.organisations]
        self._admins = [PrivateKey((folder / "admin.key").read_bytes()) for folder in folders]

    async def decide(self, contract: str, proposal: list[Any], *, approve_key: bytes | None = None) -> None:
        """Propose as the first and approve as the second; a producer is approved by its key, others by proposal id."""
        first, second = self._admins
        async with NetworkClient(self._network.genesis) as client:
            receipt = await client.call(first, contract, "propose", proposal)
            await client.call(second, contract, "approve", [receipt.txid if approve_key is None else approve_key])

    async def remove_own(self, number: int, producer_key: bytes) -> None:
        """An organisation takes a producer of its own out."""
        async with NetworkClient(self._network.genesis) as client:
            await client.call(self._admins[number], "producers", "remove", [producer_key])


async def _wait_epoch(network: NetworkUnderTest, number: int, names: list[str]) -> None:
    deadline = time.monotonic() + FINAL_TIMEOUT_S
    for name in names:
        while (await network.status(name)).get("epoch", -1) < number:
            assert time.monotonic() < deadline, f"{name} did not reach epoch {number}"
            await asyncio.sleep(0.05)


async def _check_everywhere(network: NetworkUnderTest, txids: list[bytes], names: Sequence[str] = ()) -> None:
    """Each acknowledged transaction stands in the same block on these nodes (or all), each of which proves its receipt."""
    for txid in txids[:: max(1, len(txids) // 25)]:
        assert len({await network.block_id(name, txid) for name in names or network.names}) == 1
    for name in names or network.names:
        async with NetworkClient(network.genesis, {name: network.genesis.node(name).api_url}) as client:
            receipts = [await client.wait_final(txid) for txid in (txids[0], txids[-1])]
            assert receipts[0].height <= receipts[1].height


async def test_a_producer_is_taken_out_and_comes_back_under_load_and_every_client_follows(
    network: NetworkUnderTest,
) -> None:
    organisations, removed = Organisations(network), network.genesis.node("node-4")
    wallet = NetworkClient(network.genesis)
    await wallet.newest_header(network.registrar)
    pinned_at_first = wallet.pinned
    load = Load(network, ["node-1", "node-2", "node-3", "node-4"])
    await organisations.remove_own(1, removed.producer_key)
    await _wait_epoch(network, 1, network.names)
    await asyncio.sleep(1.0)
    assert (await wallet.newest_header(network.registrar)).epoch == 1
    await organisations.decide("producers", [removed.producer_key], approve_key=removed.producer_key)
    await _wait_epoch(network, 2, network.names)
    await asyncio.sleep(1.0)
    gap_s = await load.end()
    state = await wallet.state_values([EPOCH.flat], network.registrar)
    assert state.values[EPOCH.flat]["producers"][-1] == removed.producer_key
    assert wallet.light_client.epoch.number == 2
    await wallet.close()
    async with NetworkClient(network.genesis, pinned=pinned_at_first) as later:
        assert (await later.newest_header(network.registrar)).epoch == 2
    await _check_everywhere(network, load.acknowledged)
    assert gap_s < GAP_MAX_S, f"nothing was acknowledged for {gap_s:.2f} s"


async def test_settings_change_while_a_node_is_away_and_it_comes_back_into_the_newest_epoch(
    network: NetworkUnderTest,
) -> None:
    organisations = Organisations(network)
    await network.finalize("node-1", network.transaction())
    await asyncio.to_thread(network.cluster.kill, "node-3")
    load = Load(network, ["node-1", "node-2"])
    for base_timeout_ms in (400, 300):
        await organisations.decide("settings", ["base_timeout_ms", base_timeout_ms])
    await _wait_epoch(network, 2, ["node-1", "node-2", "node-4"])
    network.cluster.start("node-3")
    await _wait_epoch(network, 2, ["node-3"])
    await asyncio.to_thread(network.cluster.kill, "node-1")
    network.cluster.start("node-1")
    await network.cluster.wait_ready(["node-1", "node-3"])
    await load.end()
    assert (await network.status("node-1"))["epoch"] == 2
    await network.finalize("node-3", network.transaction())
    await _check_everywhere(network, load.acknowledged)


async def test_a_producer_that_was_taken_out_speaks_of_every_epoch_and_moves_nobody(network: NetworkUnderTest) -> None:
    """Its node's certificate still counts; its producer key signs as of its old seat, in epochs over, present and far."""
    honest = ["node-1", "node-2", "node-3"]
    organisations, removed = Organisations(network), network.genesis.node("node-4")
    await network.finalize("node-1", network.transaction())
    await organisations.remove_own(1, removed.producer_key)
    await _wait_epoch(network, 1, network.names)
    await asyncio.to_thread(network.cluster.kill, "node-4")
    network.cluster.start("node-4", behaviour="wrong-epochs", seed=5)
    await network.cluster.wait_answering("node-4")
    load = Load(network, honest)
    await asyncio.sleep(2.0)
    await organisations.decide("settings", ["base_timeout_ms", 400])
    await _wait_epoch(network, 2, honest)
    await asyncio.sleep(2.0)
    gap_s = await load.end()
    for name in honest:
        status = await network.status(name)
        assert (status["epoch"], status["lockout"]) == (2, None), name
    async with NetworkClient(network.genesis) as client:
        state = await client.state_values([EPOCH.flat], network.registrar)
    assert removed.producer_key not in state.values[EPOCH.flat]["producers"]
    await _check_everywhere(network, load.acknowledged, honest)
    assert gap_s < GAP_MAX_S, f"nothing was acknowledged for {gap_s:.2f} s"

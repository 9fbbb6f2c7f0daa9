"""Clients that work all the while on a host of their own, and notice what goes wrong; at the end all must be there.

`python -m network.lab.hosts.steady_clients`: the orders come on standard input, one JSON object a line; each line gets one.
"""

from __future__ import annotations

import asyncio
import secrets
import sys
import time
from collections import Counter
from typing import Self

import msgspec
from msgspec import Struct

from clients.sdk.connections import ANONYMOUS_LANE, Connections, NodeAddress
from clients.sdk.network_client import NetworkClient
from consensus.bounded_text import read_json_as
from consensus.chain.genesis import Genesis, genesis_from_json
from consensus.errors import BlockRobotError
from consensus.members.vouchers import decode_card_code
from consensus.state.records import RECORD
from network.bench.conditions import percentile
from network.bench.finality_probe import longest_gap_s
from network.bench.fresh_network import LoadRobot, enrol_robot
from network.lab.hosts.founded_network import FoundedNetwork
from network.lab.hosts.remote_program import RemoteProgram

PAUSE_S, CONNECT_EVERY_S = 0.3, 0.4
"""So that all clients of this host together stay within one address's budget at a node."""
FINAL_MAX_S = 60.0
PROOF_KEYS_COUNT = 100
_MODULE = "network.lab.hosts.steady_clients"


class Orders(Struct):
    """The first line: whose network it is, and the cards of the robots that work."""

    genesis: str
    codes: list[str]


class Seen(Struct, kw_only=True):
    """What clients saw since they were asked last. `refused`: calls by error; a connection is a new one over TLS."""

    seconds: float
    finals: int
    refused: dict[str, int]
    longest_gap_s: float
    connections: int
    connections_refused: dict[str, int]
    connect_p95_ms: float
    connect_max_ms: float


class Kept(Struct, kw_only=True):
    """After the end: records that clients were told are final, and how many of them each node lacks."""

    acknowledged: int
    missing: dict[str, int]


class _Work:
    def __init__(self, genesis: Genesis) -> None:
        self._genesis = genesis
        self._records: list[bytes] = []
        self._robots: list[LoadRobot] = []
        self._begin()

    def _begin(self) -> None:
        self._since_s = time.monotonic()
        self._finals_s: list[float] = []
        self._refused: Counter[str] = Counter()
        self._connects_ms: list[float] = []
        self._unconnected: Counter[str] = Counter()

    async def enrol(self, codes: list[str]) -> None:
        for number, code in enumerate(codes):
            first = self._genesis.nodes[number % len(self._genesis.nodes)].name
            client = NetworkClient(self._genesis, first=first)
            self._robots.append(await enrol_robot(client, decode_card_code(code)))

    async def work(self) -> None:
        tasks = [self._record(robot) for robot in self._robots]
        await asyncio.gather(*tasks, *(self._connect(node) for node in addresses(self._genesis)))

    async def _record(self, robot: LoadRobot) -> None:
        while True:
            transaction = robot.sign_record()
            try:
                receipt = await robot.client.submit_and_wait(transaction, round(FINAL_MAX_S * 1000))
                receipt.require_ok()
            except BlockRobotError as error:
                self._refused[error.code] += 1
            else:
                self._records.append(transaction.arguments()[0])
                self._finals_s.append(time.monotonic())
            await asyncio.sleep(PAUSE_S)

    async def _connect(self, node: NodeAddress) -> None:
        while True:
            connections, begun_s = Connections(), time.monotonic()
            try:
                await connections.request(node, "GET", "/v1/epochs?after=0", lane=ANONYMOUS_LANE)
                self._connects_ms.append((time.monotonic() - begun_s) * 1000)
            except BlockRobotError as error:
                self._unconnected[f"{node.name} {error.code}"] += 1
            finally:
                await connections.close()
            await asyncio.sleep(CONNECT_EVERY_S)

    def tell(self) -> Seen:
        now_s = time.monotonic()
        seen = Seen(
            seconds=round(now_s - self._since_s, 1),
            finals=len(self._finals_s),
            refused=dict(self._refused),
            longest_gap_s=round(longest_gap_s(self._finals_s, self._since_s, now_s), 3),
            connections=len(self._connects_ms),
            connections_refused=dict(self._unconnected),
            connect_p95_ms=round(percentile(self._connects_ms, 0.95), 1),
            connect_max_ms=round(max(self._connects_ms, default=0.0), 1),
        )
        self._begin()
        return seen

    async def look_up(self) -> Kept:
        """At each node alone, by proofs of a state that is as new as what clients know."""
        pinned = max((robot.client for robot in self._robots), key=lambda one: one.light_client.header.height).pinned
        missing = {}
        for node in self._genesis.nodes:
            async with NetworkClient(self._genesis, {node.name: node.api_url}, pinned=pinned) as reader:
                missing[node.name] = await self._count_missing(reader)
        for robot in self._robots:
            await robot.client.close()
        return Kept(acknowledged=len(self._records), missing=missing)

    async def _count_missing(self, reader: NetworkClient) -> int:
        count = 0
        for start in range(0, len(self._records), PROOF_KEYS_COUNT):
            keys = [RECORD.key(each) for each in self._records[start : start + PROOF_KEYS_COUNT]]
            values = (await reader.state_values(keys, self._robots[0].key)).values
            count += sum(values[key] is None for key in keys)
        return count


def addresses(genesis: Genesis) -> list[NodeAddress]:
    """Of all nodes, with the authority that each one's certificate is from."""
    authorities = {organisation.name: organisation.ca_certificate for organisation in genesis.organisations}
    return [NodeAddress(node.name, node.api_url, authorities[node.organisation]) for node in genesis.nodes]


async def _run() -> None:
    loop = asyncio.get_running_loop()
    orders = read_json_as(await loop.run_in_executor(None, sys.stdin.readline), Orders)
    work = _Work(genesis_from_json(orders.genesis))
    await work.enrol(orders.codes)
    working = loop.create_task(work.work())
    _print(work.tell())
    while await loop.run_in_executor(None, sys.stdin.readline):
        if working.done():
            working.result()
        _print(work.tell())
    if working.done():
        working.result()
    working.cancel()
    await asyncio.gather(working, return_exceptions=True)
    _print(await work.look_up())


def _print(told: Struct) -> None:
    sys.stdout.write(msgspec.json.encode(told).decode() + "\n")
    sys.stdout.flush()


class SteadyClients(RemoteProgram):
    """Clients at work on the visitor's host for as long as `with` lasts."""

    def __init__(self, network: FoundedNetwork, count: int = 4) -> None:
        codes = [network.issue_card(secrets.token_hex(8), "robot") for _ in range(count)]
        self._orders = Orders(genesis=network.genesis_path.read_text(encoding="utf-8"), codes=codes)
        super().__init__(network, network.visitor, _MODULE)

    def __enter__(self) -> Self:
        try:
            self.ask(self._orders)
        except BaseException as error:
            self.__exit__(type(error), error, None)
            raise
        return self

    def see(self, seconds: float = 0.0) -> Seen:
        """Let them work so long, then tell what they saw since they were asked last."""
        time.sleep(seconds)
        return read_json_as(self.ask(), Seen)

    def stop(self) -> Kept:
        """Let them stop, and look for all that they were told is final, at each node."""
        return read_json_as(self.end(), Kept)


if __name__ == "__main__":
    asyncio.run(_run())

"""What strangers and members do to a node from a host of their own: ask too much, forge headers, be slow.

`python -m network.lab.hosts.visits`: one JSON object on standard input, one on standard output.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import ssl
import sys
import time
from collections import Counter
from typing import TypeVar
from urllib.parse import urlsplit

import aiohttp
import msgspec
from msgspec import Struct

from clients.sdk.connections import NodeAddress, tls_context
from clients.sdk.network_client import NetworkClient
from consensus.bounded_text import read_json_as
from consensus.chain.genesis import genesis_from_json
from consensus.errors import BlockRobotError
from consensus.members.vouchers import decode_card_code
from network.bench.fresh_network import LoadRobot, enrol_robot
from network.lab.hosts.founded_network import FoundedNetwork
from network.lab.hosts.namespaces import Host
from network.lab.hosts.remote_program import RemoteProgram
from network.lab.hosts.steady_clients import addresses

FLOOD_S, CALLERS_COUNT, FEW_COUNT = 4.0, 24, 20
REQUEST_MAX_S = 10.0
DRIP_S, SETTLE_S = 1.0, 3.0
HELLO_HEAD = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"
"""How a ClientHello of TLS begins."""
REQUEST_HEAD = b"GET /v1/genesis HTTP/1.1\r\nHost: node\r\nX-Slow: "
BODY_FIRST_BYTES = 96 * 1024
"""So much comes at once of a body that never ends: more than a proxy keeps in memory, and little to a node."""
BODY_HEAD = (
    b"POST /v1/transactions HTTP/1.1\r\nHost: node\r\nContent-Type: application/msgpack\r\n"
    b"Content-Length: 1000000\r\n\r\n" + b"x" * BODY_FIRST_BYTES
)
_MODULE = "network.lab.hosts.visits"
V = TypeVar("V")


class Crowd(Struct, tag=True):
    """Callers of one node: one asks too much and forges headers, others come as its neighbours. `codes`: two cards."""

    genesis: str
    node: str
    codes: list[str]
    neighbour: str
    """Another address of this host."""


class Told(Struct, kw_only=True):
    """How a node answered them, each: statuses, or codes of errors, and how often.

    `flood`: an address without a session, which names another address in each request; `neighbour`: another address
    meanwhile; `member`: a session behind the flooding address; `greedy`: a session that asks too much; `fellow`: a
    session beside it.
    """

    flood_s: float
    flood: dict[str, int]
    neighbour: dict[str, int]
    member: dict[str, int]
    greedy: dict[str, int]
    fellow: dict[str, int]


class Slow(Struct, tag=True):
    """Connections that are kept half open, at each of these places (host:port), until the input ends."""

    places: list[str]
    hellos: int
    """Of each place: so many that stop within the TLS handshake, and as many requests that never end, half with a body."""


class Held(Struct):
    """How many connections were opened, and how many were open at the end."""

    opened: int
    held: int


# Callers


async def _get(session: aiohttp.ClientSession, node: NodeAddress, headers: dict[str, str]) -> str:
    try:
        async with session.get(f"{node.url}/v1/epochs?after=0", headers=headers) as response:
            await response.read()
            return str(response.status)
    except (aiohttp.ClientError, TimeoutError, OSError) as error:
        return type(error).__name__


async def _ask_from(node: NodeAddress, address: str, count: int) -> Counter[str]:
    connector = aiohttp.TCPConnector(local_addr=(address, 0), ssl=tls_context(node))
    timeout = aiohttp.ClientTimeout(total=REQUEST_MAX_S)
    async with aiohttp.ClientSession(connector=connector, timeout=timeout) as session:
        return Counter([await _get(session, node, {}) for _ in range(count)])


async def _flood(node: NodeAddress, until_s: float) -> Counter[str]:
    """From this host's first address, in the name of ever other ones."""
    told: Counter[str] = Counter()
    numbers = itertools.count()
    connector = aiohttp.TCPConnector(ssl=tls_context(node))
    timeout = aiohttp.ClientTimeout(total=REQUEST_MAX_S)
    async with aiohttp.ClientSession(connector=connector, timeout=timeout) as session:

        async def call() -> None:
            while time.monotonic() < until_s:
                named = f"198.51.100.{next(numbers) % 250}"
                told[await _get(session, node, {"X-Forwarded-For": named, "X-Real-IP": named})] += 1

        await asyncio.gather(*(call() for _ in range(CALLERS_COUNT)))
    return told


async def _ask_as(robot: LoadRobot, node: NodeAddress, count: int, callers: int = 1) -> Counter[str]:
    told: Counter[str] = Counter()

    async def call() -> None:
        for _ in range(count):
            try:
                await robot.client.ask_node(node, "GET", "/v1/finality", key=robot.key)
                told["200"] += 1
            except BlockRobotError as error:
                told[error.code] += 1

    await asyncio.gather(*(call() for _ in range(callers)))
    return told


async def _crowd(orders: Crowd) -> Told:
    genesis = genesis_from_json(orders.genesis)
    node = next(each for each in addresses(genesis) if each.name == orders.node)
    robots = [
        await enrol_robot(NetworkClient(genesis, {node.name: node.url}), decode_card_code(code))
        for code in orders.codes
    ]
    try:
        for robot in robots:
            await robot.client.newest_header(robot.key)  # opens a session
        until_s = time.monotonic() + FLOOD_S
        flooding = asyncio.create_task(_flood(node, until_s))
        await asyncio.sleep(FLOOD_S / 2)
        neighbour = await _ask_from(node, orders.neighbour, FEW_COUNT)
        member = await _ask_as(robots[0], node, FEW_COUNT)
        flood = await flooding
        flood_s = time.monotonic() - until_s + FLOOD_S
        greedy_calls = asyncio.create_task(_ask_as(robots[0], node, 2 * FEW_COUNT, CALLERS_COUNT))
        await asyncio.sleep(FLOOD_S / 4)
        fellow = await _ask_as(robots[1], node, FEW_COUNT)
        greedy = await greedy_calls
    finally:
        for robot in robots:
            await robot.client.close()
    return Told(flood_s=flood_s, flood=flood, neighbour=neighbour, member=member, greedy=greedy, fellow=fellow)


# Slow ones


async def _hold(place: str, context: ssl.SSLContext | None, begin: bytes, held: Counter[str]) -> None:
    """Open again whatever the other side closes; without a context stop within the handshake."""
    parts = urlsplit(f"//{place}")
    while True:
        try:
            reader, writer = await asyncio.open_connection(parts.hostname, parts.port, ssl=context)
        except OSError:
            await asyncio.sleep(DRIP_S)
            continue
        held["opened"] += 1
        held["held"] += 1
        try:
            writer.write(begin)
            while not reader.at_eof():
                await writer.drain()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(DRIP_S):
                        await reader.read(1024)
                writer.write(b"x" if context else b"\x00")
        except OSError:
            pass
        finally:
            held["held"] -= 1
            writer.transport.abort()
        await asyncio.sleep(DRIP_S)


async def _be_slow(orders: Slow) -> Held:
    held: Counter[str] = Counter()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE  # a stranger does not care whom it disturbs
    tasks = [
        asyncio.create_task(_hold(place, tls, begin, held))
        for place in orders.places
        for number in range(orders.hellos)
        for tls, begin in ((None, HELLO_HEAD), (context, BODY_HEAD if number % 2 else REQUEST_HEAD))
    ]
    await asyncio.sleep(SETTLE_S)
    _print(Held(held["opened"], held["held"]))
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    told = Held(held["opened"], held["held"])
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return told


class Visit(RemoteProgram):
    """One visit on a host; a slow one lasts until `end`. `with` ends it in any case."""

    def __init__(self, network: FoundedNetwork, host: Host, orders: Crowd | Slow) -> None:
        self._orders = orders
        super().__init__(network, host, _MODULE)

    def go(self, kind: type[V]) -> V:
        """What a crowd was told; of a slow one, what it opened at first."""
        return read_json_as(self.ask(self._orders), kind)


async def _run() -> Told | Held:
    line = await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    orders: Crowd | Slow = read_json_as(line, Crowd | Slow)  # type: ignore[arg-type]
    return await (_crowd(orders) if isinstance(orders, Crowd) else _be_slow(orders))


def _print(told: Told | Held) -> None:
    sys.stdout.write(msgspec.json.encode(told).decode() + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _print(asyncio.run(_run()))

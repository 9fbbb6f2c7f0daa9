"""Whoever tries to use a node up costs himself, not the others: connections, sessions, waits, streams, handshakes."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from urllib.parse import urlsplit

import pytest

from node.api.access.sessions import SESSIONS_OF_KEY_MAX_COUNT
from node.api.server import CONNECTIONS_MAX_COUNT
from pages.listening import HELD_BACK_OF_KEY_MAX_COUNT
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import Intruder

pytestmark = pytest.mark.asyncio(loop_scope="module")

ANSWER_MAX_S = 10.0
ASK_AGAIN_S = 0.2


class Crowd:
    """Many raw connections to one port."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self.connections: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

    async def grow(self, count: int, words: bytes) -> None:
        for _ in range(count):
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection(self._host, self._port)
                self.connections.append((reader, writer))
                writer.write(words.replace(b"TXID", secrets.token_hex(32).encode()))

    def leave(self) -> None:
        for _, writer in self.connections:
            writer.transport.abort()


@contextlib.asynccontextmanager
async def crowd(intruder: Intruder, count: int, words: bytes):
    address = urlsplit(intruder.url(""))
    crowd = Crowd(address.hostname or "", address.port or 0)
    try:
        await crowd.grow(count, words)
        yield crowd
    finally:
        crowd.leave()


async def _answered(intruder: Intruder, path: str) -> None:
    """Ask as a client does: again, if the crowd's requests from the same address used up what it has for a moment."""
    while True:
        status, _, _ = await intruder.ask("GET", path)
        if status != 429:
            break
        await asyncio.sleep(ASK_AGAIN_S)
    assert status == 200


async def _is_served(network: NetworkUnderTest, intruder: Intruder) -> None:
    async with asyncio.timeout(ANSWER_MAX_S):
        await _answered(intruder, "/v1/genesis")
        await _answered(intruder, "/v1/transactions/" + "00" * 32)
        await intruder.final(network.transaction())


@pytest.mark.parametrize(
    "words",
    [
        b"",
        b"GET /v1/genesis HTTP/1.1\r\nHost: x\r\nX-Slow: ",
        b"POST /v1/transactions HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\n\x91",
        b"GET /v1/transactions/TXID?wait_ms=30000 HTTP/1.1\r\nHost: x\r\n\r\n",
    ],
    ids=["silent", "slow head", "slow body", "waiting"],
)
async def test_connections_held_open_keep_nobody_out(
    network: NetworkUnderTest, intruder: Intruder, words: bytes
) -> None:
    async with crowd(intruder, CONNECTIONS_MAX_COUNT + 200, words):
        await _is_served(network, intruder)
    await _is_served(network, intruder)


async def test_one_members_streams_are_bounded(network: NetworkUnderTest, intruder: Intruder) -> None:
    greedy, modest = (await intruder.enrol()).identity, (await intruder.enrol()).identity
    token = (await intruder.session(greedy))["Authorization"].encode()
    words = b"GET /v1/events?cursor=0:0 HTTP/1.1\r\nHost: x\r\nAuthorization: " + token + b"\r\n\r\n"
    async with crowd(intruder, 3 * HELD_BACK_OF_KEY_MAX_COUNT, words) as streams:
        heads = await asyncio.gather(*(reader.readline() for reader, _ in streams.connections))
        assert heads.count(b"HTTP/1.1 200 OK\r\n") == HELD_BACK_OF_KEY_MAX_COUNT
        assert heads.count(b"HTTP/1.1 429 Too Many Requests\r\n") == 2 * HELD_BACK_OF_KEY_MAX_COUNT
        headers = await intruder.session(modest)
        async with intruder.http.get(intruder.url("/v1/events?cursor=0:0"), headers=headers) as stream:
            assert stream.status == 200
        await _is_served(network, intruder)


async def test_one_members_sessions_close_nobody_elses(network: NetworkUnderTest, intruder: Intruder) -> None:
    modest, greedy = (await intruder.enrol()).identity, (await intruder.enrol()).identity
    token, challenge = await intruder.session(modest), await intruder.challenge(modest)
    own = [await intruder.session(greedy) for _ in range(SESSIONS_OF_KEY_MAX_COUNT + 8)]
    statuses = [(await intruder.ask("GET", "/v1/finality", headers=one))[0] for one in own]
    assert statuses == [401] * 8 + [200] * SESSIONS_OF_KEY_MAX_COUNT
    assert (await intruder.ask("GET", "/v1/finality", headers=token))[0] == 200
    assert (await intruder.ask("POST", "/v1/sessions", json=intruder.answer_to(modest, challenge)))[0] == 200


async def test_a_node_rejoins_though_strangers_hold_handshakes_open(network: NetworkUnderTest) -> None:
    target = network.names[1]
    strangers = Crowd("127.0.0.1", network.cluster.config(target).p2p_port)
    try:
        await strangers.grow(500, b"\x16\x03\x01")
        network.cluster.kill(network.names[0])
        network.cluster.start(network.names[0])
        await network.cluster.wait_ready()
        await network.finalize(target, network.transaction())
    finally:
        strangers.leave()

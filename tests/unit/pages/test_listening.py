"""How listeners hold connections: so many and no more, and whoever waits in the queue takes no descriptor."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import resource
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from aiohttp import ClientSession, web

from node import operator_listener
from node.api import server
from node.p2p import network as links
from node.p2p.connection_acceptor import OF_CLIENTS, OF_PEERS
from pages import local_page
from pages.listening import NO_KEY, ConnectionTable, open_listener, serve, share_of_descriptors

WAIT_S = 10.0
HALF_A_HEAD = b"GET / HTTP/1.1\r\nHost: x\r\nX: "
HALF_A_BODY = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\nx"


def application() -> web.Application:
    async def answer(request: web.Request) -> web.Response:
        return web.Response(text="here", headers={"Size": str(len(await local_page.read_object(request)))})

    async def here(_request: web.Request) -> web.Response:
        return web.Response(text="here")

    made = web.Application()
    made.router.add_get("/", here)
    made.router.add_post("/", answer)
    return made


def open_descriptors_count() -> int:
    return len(list(Path("/dev/fd").iterdir()))


@contextlib.asynccontextmanager
async def served(max_count: int) -> AsyncIterator[int]:
    listener = open_listener("127.0.0.1", 0)
    async with serve(application(), listener, max_count, 10):
        yield listener.getsockname()[1]


@contextlib.asynccontextmanager
async def crowd(
    port: int, count: int, words: bytes, address: str = "127.0.0.1"
) -> AsyncIterator[list[asyncio.StreamReader]]:
    held = [await asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0)) for _ in range(count)]
    try:
        for _, writer in held:
            writer.write(words)
        yield [reader for reader, _ in held]
    finally:
        for _, writer in held:
            writer.transport.abort()


@pytest.mark.parametrize("words", [b"", HALF_A_HEAD, HALF_A_BODY], ids=["silent", "half a head", "half a body"])
async def test_who_holds_connections_open_keeps_nobody_out_and_takes_few_descriptors(words: bytes) -> None:
    async with served(4) as port:
        before = open_descriptors_count()
        async with crowd(port, 60, words) as readers:
            async with asyncio.timeout(WAIT_S), ClientSession() as client:
                async with client.get(f"http://127.0.0.1:{port}/") as answer:
                    assert await answer.text() == "here"
                for reader in readers[:50]:
                    with contextlib.suppress(OSError):
                        await reader.read()
            assert open_descriptors_count() - before <= 60 + 4 + 2, "the callers' own ends are among them"


@pytest.mark.parametrize(
    ("address", "words"),
    [("127.0.0.8", b""), ("127.0.0.8", HALF_A_BODY), ("127.0.0.9", b"")],
    ids=["silent", "half a body", "of its own address"],
)
async def test_a_body_that_goes_on_is_not_what_makes_room_for_others(address: str, words: bytes) -> None:
    """At its own address it is no idle connection; one of another address, which has most, goes before it."""
    async with served(4) as port, contextlib.AsyncExitStack() as held, asyncio.timeout(WAIT_S):
        reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.9", 0))
        writer.write(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 8\r\n\r\n")
        for part in (b'{"a"', b": ", b"0", b"}"):
            writer.write(part)
            others = 3 if address == "127.0.0.9" else 20
            await held.enter_async_context(crowd(port, others, words, address))
        assert await reader.readline() == b"HTTP/1.1 200 OK\r\n"
        writer.transport.abort()


@pytest.mark.parametrize(
    "words",
    [
        b"GET / HTTP/1.1\r\nHost: x\r\nTYPE YOUR 24 WORDS AT x.example\x1b[31m\r\n\r\n",
        b"\x1b]0;owned\x07 TYPE YOUR 24 WORDS\r\n\r\n",
        b"GET /" + b"A" * 9000 + b" HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: x\r\nX: " + b"B" * 9000 + b"\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\nzz\r\n",
        b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\nTYPE YOUR 24 WORDS\r\n\r\n",
        b"GET http://[TYPE YOUR 24 WORDS HTTP/1.1\r\nHost: x\r\n\r\n",
    ],
    ids=["header", "no HTTP", "long path", "long header", "two lengths", "chunk", "request line"],
)
async def test_a_stranger_writes_nothing_to_the_terminal_of_who_listens(
    words: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """A logger without a handler of its own prints on standard error: what it is told must not come from outside."""
    async with served(4) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        async with asyncio.timeout(WAIT_S):
            writer.write(words)
            assert b" 400 " in await reader.readline()
        writer.transport.abort()
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING] == []


async def test_a_body_that_does_not_come_is_not_waited_for_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_page, "BODY_TIMEOUT_MS", 20)
    caught: list[str] = []

    async def read(request: web.Request) -> web.Response:
        try:
            await local_page.read_object(request)
        except local_page.BlockRobotError as error:
            caught.append(error.code)
        return web.Response()

    made = web.Application()
    made.router.add_post("/", read)
    listener = open_listener("127.0.0.1", 0)
    async with serve(made, listener, 4, 10), crowd(listener.getsockname()[1], 1, HALF_A_BODY) as (reader,):
        async with asyncio.timeout(WAIT_S):
            assert await reader.readline() == b"HTTP/1.1 200 OK\r\n"
    assert caught == ["REQUEST_TIMEOUT"]


def test_no_address_and_no_visits_at_one_hold_all_places_of_answers_that_wait() -> None:
    table = ConnectionTable(128)

    def hold(key: bytes | None, sharer: str) -> int:
        """Return how many of a hundred are held back, each with a key of its own where none is given."""
        keys = [bytes([2, at]) if key is None else key for at in range(100)]
        return sum(held.enter_context(table.hold_back(each, sharer)) for each in keys)

    for _ in range(2):
        with contextlib.ExitStack() as held:
            assert hold(NO_KEY, "address a") == 16
            assert hold(None, "visit keys at a") == 8
            assert hold(b"member", "session m") == 8
            assert sum(hold(NO_KEY, f"address {at}") for at in range(10)) == 64 - 16
            assert sum(hold(None, f"visit keys at {at}") for at in range(10)) == 32 - 8 - 8


@contextlib.contextmanager
def descriptors(count: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(count, before[1]), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.parametrize("count", [256, 1024, 4096])
def test_all_listeners_of_a_node_together_leave_a_quarter_of_the_descriptors_to_its_own_work(count: int) -> None:
    """The custodian's store, the contract worker's pipes, the ledger, the links to peers that said hello."""
    with descriptors(count):
        taken = sum(
            share_of_descriptors(most, part)
            for most, part in (
                (server.CONNECTIONS_MAX_COUNT, server._DESCRIPTORS_PART),
                (operator_listener.CONNECTIONS_MAX_COUNT, operator_listener._DESCRIPTORS_PART),
                (operator_listener.METRICS_CONNECTIONS_MAX_COUNT, operator_listener._METRICS_DESCRIPTORS_PART),
                *((of.open_max_count, of.descriptors_part) for of in (OF_PEERS, OF_CLIENTS)),
                (links.UNGREETED_MAX_COUNT, links._DESCRIPTORS_PART),
            )
        )
        assert taken <= count - count // 4

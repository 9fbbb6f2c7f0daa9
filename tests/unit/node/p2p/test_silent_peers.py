"""A peer that has shaken hands and says nothing, or begins what it does not end: it has few places, and not for long."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
import pytest_asyncio

from consensus.primitives.encoding import encode
from node.limits.token_buckets import Allowance
from node.p2p import connection
from node.p2p import network as links
from node.p2p.wire import PROTOCOL_VERSION, FrameKind, Hello
from tests.unit.node.p2p.linked_nodes import WAIT_S, LinkedNodes, eventually

HELLO_HEAD = (101).to_bytes(4, "big") + bytes([FrameKind.HELLO])
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@pytest_asyncio.fixture
async def crowd(tmp_path: Path) -> AsyncIterator[LinkedNodes]:
    crowd = LinkedNodes(tmp_path)
    yield crowd
    await crowd.close()


class Thief:
    """Who has the certificate of `a` and calls `b`."""

    def __init__(self, crowd: LinkedNodes) -> None:
        config = crowd.config("a")
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        self._context.check_hostname, self._context.verify_mode = False, ssl.CERT_NONE
        self._context.load_cert_chain(config.tls_certificate_path, config.tls_key_path)
        self._port = crowd.ports["b"]
        self._held: list[asyncio.StreamWriter] = []

    async def call(self, address: str = "127.0.0.1") -> Streams:
        """Shake hands, and read the hello: then the node has looked at the certificate."""
        reader, writer = await asyncio.open_connection(
            "127.0.0.1", self._port, ssl=self._context, local_addr=(address, 0)
        )
        self._held.append(writer)
        await reader.readexactly(5)
        return reader, writer

    def leave(self) -> None:
        for writer in self._held:
            writer.transport.abort()


@contextlib.contextmanager
def thief_at(crowd: LinkedNodes) -> Iterator[Thief]:
    thief = Thief(crowd)
    try:
        yield thief
    finally:
        thief.leave()


async def _ends(reader: asyncio.StreamReader) -> None:
    async with asyncio.timeout(WAIT_S):
        with contextlib.suppress(OSError):
            await reader.read()


async def test_a_certificate_holds_few_connections_that_say_no_hello_and_is_named(crowd: LinkedNodes) -> None:
    await crowd.start({"b": "hospital", "a": "hospital"})
    await eventually(lambda: crowd.nodes["b"].links.connected == ["a"])
    with thief_at(crowd) as thief:
        held = [await thief.call(f"127.0.0.{2 + number % 3}") for number in range(9)]
        for reader, _ in held[: -links.UNGREETED_OF_PEER_MAX_COUNT]:
            await _ends(reader)
        node = crowd.nodes["b"]
        assert len(node.links._open) == 1 + links.UNGREETED_OF_PEER_MAX_COUNT
        assert node.refused() == {"a": "PEER_SILENT"}
        assert node.links.connected == ["a"], "the genuine node keeps its link"


async def test_who_says_no_hello_in_time_is_closed_and_named(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "HELLO_TIMEOUT_MS", 50)
    await crowd.start({"b": "hospital", "a": "hospital"})
    with thief_at(crowd) as thief:
        silent, half = await thief.call(), await thief.call()
        half[1].write(HELLO_HEAD + b"x" * 50)
        await _ends(silent[0])
        await _ends(half[0])
        assert crowd.nodes["b"].refused() == {"a": "PEER_SILENT"}


async def test_all_that_say_no_hello_together_have_so_many_places(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "UNGREETED_MAX_COUNT", 1)
    await crowd.start({"b": "hospital", "a": "hospital"})
    with thief_at(crowd) as thief:
        first, _ = await thief.call(), await thief.call()
        await _ends(first[0])


async def test_a_peer_that_dials_again_while_others_hold_its_places_is_heard(crowd: LinkedNodes) -> None:
    """The oldest makes room, so a thief cannot keep the genuine node out by holding connections."""
    await crowd.start({"b": "hospital", "a": "hospital"})
    with thief_at(crowd) as thief:
        for _ in range(3):
            await thief.call()
        crowd.nodes["b"].links._peers["a"].abort()
        await eventually(lambda: len(crowd.nodes["b"].heard.links_made) == 2)
        assert crowd.nodes["b"].links.connected == ["a"]


async def test_before_the_hello_nothing_longer_is_kept(crowd: LinkedNodes) -> None:
    await crowd.start({"b": "hospital", "a": "hospital"})
    with thief_at(crowd) as thief:
        reader, writer = await thief.call()
        writer.write((8 * 1024 * 1024).to_bytes(4, "big") + bytes([FrameKind.RESPONSE]))
        await _ends(reader)
        assert crowd.nodes["b"].refused() == {}, "it was closed for what it said, not for its silence"


async def test_who_is_refused_and_does_not_close_is_not_waited_for(crowd: LinkedNodes) -> None:
    await crowd.start({"b": "hospital", "a": "hospital"})
    node = crowd.nodes["b"].links
    await eventually(lambda: node.connected == ["a"])
    with thief_at(crowd) as thief:
        _, writer = await thief.call()
        writer.transport.pause_reading()  # type: ignore[attr-defined] # its word that it is closed never comes
        writer.write(b"\x00\x00\x00\x05\x63oops")
        async with asyncio.timeout(WAIT_S):
            await eventually(lambda: len(node._open) == 1)


async def _greet(crowd: LinkedNodes, thief: Thief) -> Streams:
    assert crowd.genesis is not None
    reader, writer = await thief.call()
    hello = encode(Hello(PROTOCOL_VERSION, crowd.genesis.chain_id, "a", 7))
    writer.write((len(hello) + 1).to_bytes(4, "big") + bytes([FrameKind.HELLO]) + hello)
    return reader, writer


async def test_a_frame_that_has_begun_has_to_end_in_time(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connection, "FRAME_TIMEOUT_MS", 50)
    await crowd.start({"b": "hospital", "a": "hospital"})
    await crowd.nodes["a"].links.stop()
    await eventually(lambda: crowd.nodes["b"].links.connected == [])
    with thief_at(crowd) as thief:
        reader, writer = await _greet(crowd, thief)
        await eventually(lambda: crowd.nodes["b"].links.connected == ["a"])
        writer.write((1000).to_bytes(4, "big") + bytes([FrameKind.VOTE]) + b"x")
        await _ends(reader)
        assert "cut_off" not in caplog.text


async def test_records_of_one_byte_are_paid_for_before_their_frame_ends(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each costs a microsecond to open, and 22 bytes that no frame counts."""
    monkeypatch.setattr(links, "LINK_ALLOWANCE", Allowance(us_per_s=60_000, burst_us=8_000))
    await crowd.start({"b": "hospital", "a": "hospital"})
    await crowd.nodes["a"].links.stop()
    await eventually(lambda: crowd.nodes["b"].links.connected == [])
    heard = crowd.nodes["b"].heard
    with thief_at(crowd) as thief:
        _, writer = await _greet(crowd, thief)
        await eventually(lambda: crowd.nodes["b"].links.connected == ["a"])
        writer.write((1_000_001).to_bytes(4, "big") + bytes([FrameKind.TRANSACTIONS]))
        for _ in range(20_000):
            writer.write(b"x")
        await eventually(lambda: "peer a" in heard.over)
        assert heard.frames == []

"""A peer that floods: it is read no faster than it may speak, and cut off for what no honest node sends."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest
import pytest_asyncio

from consensus.errors import BlockRobotError
from node.limits.peer_bans import BAN_FIRST_MS, BAN_MAX_MS, FORGOTTEN_AFTER_MS, PeerBans, monotonic_ms
from node.limits.token_buckets import Allowance, Source, source_at
from node.limits.work_costs import bytes_cost_us
from node.p2p import network as links
from node.p2p.connection_acceptor import OF_CLIENTS, OF_PEERS, ConnectionAcceptor, HandshakeLimits
from node.p2p.network import PeerNetwork
from node.p2p.wire import FrameKind, RequestKind, encode_request
from tests.unit.node.p2p.linked_nodes import LinkedNodes, eventually

LIE = BlockRobotError("SIGNATURE_INVALID")


@pytest_asyncio.fixture
async def crowd(tmp_path: Path) -> AsyncIterator[LinkedNodes]:
    crowd = LinkedNodes(tmp_path)
    yield crowd
    await crowd.close()


class Clock:
    """A clock that goes when it is told to."""

    now_ms = 0

    def __call__(self) -> int:
        return self.now_ms


def test_each_pause_is_twice_as_long_as_the_one_before_up_to_a_limit() -> None:
    clock, pauses = Clock(), []
    bans = PeerBans(clock)
    for wall_ms in range(0, 12_000, 1_000):
        bans.ban("b", LIE)
        (row,) = bans.describe(wall_ms)
        pauses.append(row["until_ms"] - wall_ms)
        clock.now_ms += pauses[-1]
    assert pauses[:3] == [BAN_FIRST_MS, 2 * BAN_FIRST_MS, 4 * BAN_FIRST_MS]
    assert pauses[-1] == BAN_MAX_MS
    assert bans.describe(0)[0]["count"] == 12


def test_what_still_arrives_in_a_pause_makes_it_no_longer_and_a_long_time_forgives() -> None:
    clock = Clock()
    bans = PeerBans(clock)
    bans.ban("b", LIE)
    clock.now_ms = 10
    bans.ban("b", LIE)
    assert bans.describe(0)[0]["count"] == 1
    clock.now_ms = BAN_FIRST_MS - 1
    with pytest.raises(BlockRobotError, match="PEER_CUT_OFF"):
        bans.require_not_banned("b")
    clock.now_ms = BAN_FIRST_MS
    bans.require_not_banned("b")
    bans.require_not_banned("c")
    clock.now_ms = late_ms = BAN_FIRST_MS + FORGOTTEN_AFTER_MS + 1
    assert bans.describe(0) == []
    bans.ban("b", LIE)
    clock.now_ms = late_ms + BAN_FIRST_MS - 1
    assert bans.is_banned("b")
    clock.now_ms += 1
    assert not bans.is_banned("b")


def let_pauses_pass(node: PeerNetwork) -> None:
    node._peer_bans.clock_ms = lambda: monotonic_ms() + BAN_FIRST_MS + 1


async def _linked(crowd: LinkedNodes) -> tuple[PeerNetwork, PeerNetwork]:
    await crowd.start({"a": "hospital", "b": "hospital"})
    first, second = crowd.nodes["a"].links, crowd.nodes["b"].links
    await eventually(lambda: first.connected == ["b"] and second.connected == ["a"])
    return first, second


async def test_a_peer_that_breaks_the_framing_is_cut_off_named_and_told_why(crowd: LinkedNodes) -> None:
    first, second = await _linked(crowd)
    second._peers["a"].transport.write(b"\x00\x00\x00\x05\x63oops")
    await eventually(lambda: first.connected == [])
    (row,) = first.describe()["cut_off_peers"]
    assert (row["peer"], row["code"], row["count"]) == ("b", "PEER_MESSAGE_INVALID", 1)
    assert not first._may_dial("b")
    crowd.nodes["a"].clock_offset_ms += BAN_FIRST_MS + 1
    assert not first._may_dial("b"), "setting the machine's clock ends no pause"
    let_pauses_pass(first)
    await eventually(lambda: first.connected == ["b"])


async def test_a_node_that_is_cut_off_cannot_come_back_by_dialling_until_its_pause_is_over(crowd: LinkedNodes) -> None:
    first, second = await _linked(crowd)
    second.cut_off("a", LIE)
    await eventually(lambda: crowd.nodes["a"].refused_by().get("b") == "PEER_CUT_OFF")
    assert first.connected == second.connected == []
    let_pauses_pass(second)
    await eventually(lambda: second.connected == ["a"])


async def test_a_loud_peer_is_held_up_and_named_while_all_it_says_arrives_in_order(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "CONSENSUS_ALLOWANCE", Allowance(us_per_s=150_000, burst_us=15_000))
    first, second = await _linked(crowd)
    heard = crowd.nodes["a"].heard.frames
    for number in range(400):
        second.broadcast(FrameKind.VOTE, number.to_bytes(4))
    await eventually(lambda: bool(crowd.nodes["a"].heard.over))
    assert len(heard) < 400
    await eventually(lambda: len(heard) == 400)
    assert [payload for _, _, payload in heard] == [number.to_bytes(4) for number in range(400)]
    assert first.connected == ["b"]


async def test_a_fault_while_a_peer_is_held_up_leaves_no_link_that_is_deaf(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "CONSENSUS_ALLOWANCE", Allowance(us_per_s=150_000, burst_us=15_000))
    await _linked(crowd)
    heard, second = crowd.nodes["a"].heard, crowd.nodes["b"].links

    def faulty(_peer: str, _kind: FrameKind, payload: bytes) -> None:
        if payload == (399).to_bytes(4):
            raise RuntimeError("a fault of this program")

    monkeypatch.setattr(heard, "peer_frame", faulty)
    for number in range(400):
        second.broadcast(FrameKind.VOTE, number.to_bytes(4))
    await eventually(lambda: bool(heard.over))
    await eventually(lambda: len(heard.links_made) == 2)
    assert crowd.nodes["a"].links.describe()["cut_off_peers"] == []


async def test_a_peer_with_more_open_requests_than_an_honest_one_has_is_refused_pays_and_is_named(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, second = await _linked(crowd)
    done = asyncio.Event()

    async def slow(_peer: str, _kind: RequestKind, body: bytes) -> bytes:
        await done.wait()
        return body

    monkeypatch.setattr(crowd.nodes["a"].heard, "peer_request", slow)
    asked = [asyncio.create_task(second.request("a", RequestKind.CLIP, b"x", 60_000)) for _ in range(9)]
    with pytest.raises(BlockRobotError, match="PEER_UNAVAILABLE"):
        await asked[8]
    done.set()
    assert await asyncio.gather(*asked[:8]) == [b"x"] * 8
    assert set(crowd.nodes["a"].heard.over) == {"peer b"}


async def test_a_stream_of_answers_that_nobody_asked_for_holds_up_who_sends_it(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "LINK_ALLOWANCE", Allowance(us_per_s=60_000, burst_us=bytes_cost_us(6 * 1024 * 1024)))
    _, second = await _linked(crowd)
    for _ in range(2):
        second.broadcast(FrameKind.RESPONSE, encode_request(7, 0, bytes(1024 * 1024)))
    await eventually(lambda: set(crowd.nodes["a"].heard.over) == {"peer b"})


async def test_an_address_that_only_shakes_hands_gets_no_more_of_them_than_its_budget(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "OF_PEERS", replace(OF_PEERS, allowance=Allowance(us_per_s=1, burst_us=0)))
    await crowd.start({"a": "hospital", "b": "hospital"})
    assert crowd.nodes["b"].links.connected == []
    reader, writer = await asyncio.open_connection("127.0.0.1", crowd.ports["b"])
    assert await reader.read() == b""
    writer.close()
    assert set(crowd.nodes["b"].heard.over) == {"loopback 127.0.0.1"}


async def test_an_address_that_begins_handshakes_and_ends_none_leaves_room_for_others(
    crowd: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links, "OF_PEERS", replace(OF_PEERS, open_max_count=12))
    await _linked(crowd)
    port = crowd.ports["a"]
    silent = [await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0)) for _ in range(4)]
    with contextlib.suppress(ConnectionError):
        assert await silent[0][0].read() == b"", "its oldest"
    assert set(crowd.nodes["a"].heard.over) == {"loopback 127.0.0.2"}
    reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.3", 0))
    with pytest.raises(TimeoutError):  # it is let in, and waited for
        await asyncio.wait_for(reader.read(), 0.2)
    for one in (writer, *(writer for _, writer in silent)):
        one.close()


class Strangers:
    """Handshakes that nobody goes on with, at an acceptor."""

    def __init__(self, limits: HandshakeLimits, known: frozenset[Source] | None = None) -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self.over: list[str] = []
        self._acceptor = ConnectionAcceptor(
            lambda: context,
            lambda source, _wait_s: self.over.append(str(source)),
            limits,
            None if known is None else lambda: known,
        )
        self._ends: list[tuple[str, socket.socket]] = []

    async def begin(self, *hosts: str) -> None:
        for host in hosts:
            here, there = socket.socketpair()
            here.setblocking(False)
            there.setblocking(False)
            self._ends.append((host, here))
            await self._acceptor.accept(asyncio.Protocol, there, host)
            for _ in range(5):
                await asyncio.sleep(0)

    def open(self) -> list[str]:
        """Return whose handshakes are open, the oldest first."""
        return [host for host, end in self._ends if self._is_open(end)]

    @staticmethod
    def _is_open(end: socket.socket) -> bool:
        try:
            return end.recv(1) != b""
        except BlockingIOError:
            return True
        except ConnectionError:
            return False

    def close(self) -> None:
        self._acceptor.close()
        for _, end in self._ends:
            end.close()


UNPAID = Allowance(us_per_s=1, burst_us=10**9)
A, B, C, D, E = (f"198.51.100.{number}" for number in range(1, 6))


async def test_who_has_most_handshakes_open_makes_room_and_of_those_with_its_oldest() -> None:
    strangers = Strangers(HandshakeLimits(8, 1, UNPAID))
    await strangers.begin(A, A, B, B, B, B)
    assert strangers.open() == [A, A, B, B], "a quarter of the places of each"
    assert set(strangers.over) == {f"address {B}"}
    await strangers.begin(C, C, D, D)
    await strangers.begin(E)
    assert strangers.open() == [A, B, B, C, C, D, D, E], "the first of who had most"
    await strangers.begin("2001:db8::1", "2001:db8::2", "2001:db8::3")
    assert strangers.open().count("2001:db8::1") == 0, "a network of IPv6 is one address"
    assert E in strangers.open()
    strangers.close()


async def test_two_addresses_that_go_on_and_on_end_no_handshake_of_another() -> None:
    strangers = Strangers(HandshakeLimits(8, 1, UNPAID))
    await strangers.begin(A, *(B, C) * 40)
    assert strangers.open()[0] == A
    assert len(strangers.open()) == 5
    strangers.close()


async def test_strangers_at_however_many_addresses_leave_places_to_those_that_are_known() -> None:
    strangers = Strangers(HandshakeLimits(8, 1, UNPAID), frozenset({source_at(A), source_at(B)}))
    await strangers.begin(A, B, *(f"203.0.113.{number}" for number in range(200)))
    assert strangers.open() == [A, B, *(f"203.0.113.{number}" for number in range(196, 200))]
    await strangers.begin(A)
    assert strangers.open().count(A) == 2
    strangers.close()


@pytest.mark.parametrize("limits", [OF_PEERS, OF_CLIENTS])
async def test_no_address_has_more_than_a_quarter_of_the_places_that_few_descriptors_leave(
    limits: HandshakeLimits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("node.p2p.connection_acceptor.share_of_descriptors", lambda _most, _part: 8)
    strangers = Strangers(replace(limits, allowance=UNPAID))
    await strangers.begin(*[A] * 5, B)
    assert strangers.open() == [A, A, B]
    strangers.close()

"""A connection passes everything it sends through the shaper, gossip that waited among it, and greets only where it may."""

from __future__ import annotations

import asyncio
from typing import Any, cast

from node.p2p.connection import GOSSIP_ABOVE_BYTES, ConnectionOwner, PeerConnection
from node.p2p.link_faults import LinkFault, LinkFaultShaper
from node.p2p.wire import FrameKind, encode_frame
from tests.virtual_time import in_virtual_time

BATCH = encode_frame(FrameKind.TRANSACTIONS, bytes(600_000))
VOTE = encode_frame(FrameKind.VOTE, b"vote")
HELLO = encode_frame(FrameKind.HELLO, b"hello")


class _Transport:
    """A transport that takes everything at once, or holds it back while `is_slow`."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.unsent_bytes = 0
        self.is_aborted = False

    def get_extra_info(self, _name: str) -> None:
        return None

    def set_write_buffer_limits(self, high: int) -> None:
        self.high = high

    def get_write_buffer_size(self) -> int:
        return self.unsent_bytes

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def is_closing(self) -> bool:
        return self.is_aborted

    def abort(self) -> None:
        self.is_aborted = True


class _Owner:
    def connection_made(self, connection: PeerConnection) -> None:
        connection.peer = "node-2"


def _connect(shaper: LinkFaultShaper | None) -> tuple[PeerConnection, _Transport]:
    connection, transport = PeerConnection(cast("ConnectionOwner", _Owner()), shaper, None), _Transport()
    connection.connection_made(cast("asyncio.BaseTransport", cast("Any", transport)))
    return connection, transport


@in_virtual_time
async def test_gossip_that_waited_goes_through_the_shaper_too() -> None:
    shaper = LinkFaultShaper("node-1")
    connection, transport = _connect(shaper)
    transport.unsent_bytes = GOSSIP_ABOVE_BYTES + 1
    connection.send(FrameKind.TRANSACTIONS, BATCH)
    shaper.set_link("node-2", LinkFault(cut=True))
    transport.unsent_bytes = 0
    connection.resume_writing()
    await asyncio.sleep(1)
    assert transport.written == []
    assert shaper.lost_count == 1


@in_virtual_time
async def test_gossip_waits_for_a_narrow_link_and_goes_on_by_itself_when_there_is_room() -> None:
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(bandwidth_bytes_per_s=1_000_000))
    connection, transport = _connect(shaper)
    for _ in range(6):
        connection.send(FrameKind.TRANSACTIONS, BATCH)
    connection.send(FrameKind.VOTE, VOTE)
    assert shaper.waiting_bytes("node-2") == 2 * len(BATCH) + len(VOTE)
    await asyncio.sleep(10)
    assert transport.written == [BATCH, BATCH, VOTE, BATCH, BATCH, BATCH, BATCH]


@in_virtual_time
async def test_a_connection_over_a_cut_is_not_made() -> None:
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(cut=True))
    connection, transport = _connect(shaper)
    connection.send(FrameKind.HELLO, HELLO)
    assert transport.is_aborted
    shaper.clear()
    connection, transport = _connect(shaper)
    connection.send(FrameKind.HELLO, HELLO)
    assert transport.written == [HELLO]


@in_virtual_time
async def test_what_was_on_its_way_when_the_connection_ended_is_not_written() -> None:
    shaper = LinkFaultShaper("node-1")
    shaper.set_link("node-2", LinkFault(delay_ms=100))
    connection, transport = _connect(shaper)
    connection.send(FrameKind.VOTE, VOTE)
    transport.is_aborted = True
    await asyncio.sleep(1)
    assert transport.written == []


@in_virtual_time
async def test_without_a_shaper_everything_goes_at_once() -> None:
    connection, transport = _connect(None)
    connection.send(FrameKind.VOTE, VOTE)
    transport.unsent_bytes = GOSSIP_ABOVE_BYTES + 1
    connection.send(FrameKind.TRANSACTIONS, BATCH)
    assert transport.written == [VOTE]
    transport.unsent_bytes = 0
    connection.resume_writing()
    assert transport.written == [VOTE, BATCH]

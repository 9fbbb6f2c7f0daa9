"""One TLS connection to one peer: frames, requests and answers.

Excess gossip drops its oldest entry; if consensus messages do not fit, the connection is closed.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, Protocol, cast

import structlog

from consensus.errors import BlockRobotError
from node.limits.work_costs import FRAME_US, READ_US, bytes_cost_us
from node.p2p.frame_costs import FRAME_COSTS
from node.p2p.tls import TlsOverhead
from node.p2p.traffic import Traffic
from node.p2p.wire import (
    GOSSIP_KINDS,
    HEADER_SIZE_BYTES,
    FrameDecoder,
    FrameKind,
    RequestKind,
    decode_request,
    encode_frame,
    encode_request,
)

SEND_BUFFER_MAX_BYTES = 32 * 1024 * 1024
GOSSIP_ABOVE_BYTES = 1024 * 1024
GOSSIP_QUEUE_MAX_COUNT = 256
REQUESTS_SERVED_MAX_COUNT = 8
UNASKED_FACTOR = 4
"""An answer that nobody waits for costs its sender so much more: one may come late, a stream of them is a flood."""

FRAME_TIMEOUT_MS = 60_000
"""From the first byte of a frame to its last, while this node reads: 8 MiB in a minute is slower than any use."""
SLICE_MAX_US = 2_000
_ANSWERED, _REFUSED = 0, 1

log = structlog.get_logger(__name__)


class LinkShaper(Protocol):
    """Injects link faults: decides when, and whether, a frame's bytes are sent."""

    def admits(self, peer: str) -> bool: ...

    def waiting_bytes(self, peer: str) -> int:
        """Bytes held back for this peer; they count as unsent."""
        ...

    def deliver(self, peer: str, frame: bytes, send: Callable[[bytes], None]) -> None: ...


class ConnectionOwner(Protocol):
    """What a connection reports to its network."""

    def connection_made(self, connection: PeerConnection) -> None: ...

    def connection_lost(self, connection: PeerConnection) -> None: ...

    def frame_received(self, connection: PeerConnection, kind: FrameKind, payload: bytes) -> None: ...

    async def answer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Raises BlockRobotError to refuse."""
        ...

    def pay(self, peer: str, kind: FrameKind, cost_us: int) -> None: ...

    def pay_reading(self, peer: str, cost_us: int) -> None: ...

    def too_many_requests(self, peer: str) -> None: ...

    def wait_s(self, peer: str) -> float:
        """0 within its budget."""
        ...

    def offended(self, connection: PeerConnection, error: BlockRobotError) -> None: ...


class PeerConnection(asyncio.Protocol):
    """A connection, dialled or accepted; `peer` is empty until the certificate is checked."""

    def __init__(
        self, owner: ConnectionOwner, shaper: LinkShaper | None, dialled: str | None, traffic: Traffic | None = None
    ) -> None:
        self.peer = ""
        self.dialled = dialled
        self.certificate: bytes | None = None
        self.not_after_ms = 0
        self.greeted = False
        self.closed = asyncio.get_running_loop().create_future()
        self.gossip_dropped_count = 0
        self._owner = owner
        self._shaper = shaper
        self._traffic = traffic or Traffic()
        self._decoder = FrameDecoder()
        self._is_resuming = False
        self._is_cut_off = False
        self._is_held = False
        self._reading_on: asyncio.Handle | None = None
        self._late: asyncio.TimerHandle | None = None
        self._reading = TlsOverhead(None)
        self._transport: asyncio.Transport | None = None
        self._gossip: deque[bytes] = deque(maxlen=GOSSIP_QUEUE_MAX_COUNT)
        self._requests: dict[int, asyncio.Future[bytes]] = {}
        self._next_request = 0
        self._serving: set[asyncio.Task[None]] = set()

    @property
    def transport(self) -> asyncio.Transport:
        """The transport. Raises PEER_UNAVAILABLE once closed."""
        if self._transport is None:
            raise BlockRobotError("PEER_UNAVAILABLE", "The connection is closed.")
        return self._transport

    @property
    def is_open(self) -> bool:
        return self._transport is not None and not self._transport.is_closing()

    def certificate_der(self) -> bytes | None:
        ssl_object = self.transport.get_extra_info("ssl_object")
        return cast("bytes | None", ssl_object.getpeercert(binary_form=True)) if ssl_object else None

    # asyncio.Protocol

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=GOSSIP_ABOVE_BYTES)
        self._reading = TlsOverhead(self._transport.get_extra_info("socket"))
        self._owner.connection_made(self)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        self._transport = None
        if self._reading_on is not None:
            self._reading_on.cancel()
        self._forget_deadline()
        for future in self._requests.values():
            if not future.done():
                future.set_exception(BlockRobotError("PEER_UNAVAILABLE", "The connection to the peer was lost."))
        self._requests.clear()
        for task in self._serving:
            task.cancel()
        if not self.closed.done():
            self.closed.set_result(None)
        self._owner.connection_lost(self)

    def data_received(self, data: bytes) -> None:
        if self._is_cut_off:
            return
        cost_us = self._reading.cost_us(len(data))
        if cost_us > 0:
            self._owner.pay_reading(self.peer, cost_us)
        self._decoder.take(data)
        if self._reading_on is None:
            self._read_on()

    def _read_on(self) -> None:
        """Handle frames for a time slice within the peer's budget."""
        self._reading_on = None
        spent_us = 0
        try:
            while self.is_open and not self._is_cut_off:
                wait_s = self._owner.wait_s(self.peer)
                if wait_s > 0 or spent_us >= SLICE_MAX_US:
                    self._hold(wait_s)
                    return
                frame = self._decoder.next_frame(is_greeted=self.greeted)
                if frame is None:
                    self._wait_for_more(has_cut=spent_us > 0)
                    return
                self._forget_deadline()
                kind, payload = frame
                cost_us = FRAME_US + FRAME_COSTS[kind].us + bytes_cost_us(len(payload))
                spent_us += cost_us
                self._owner.pay(self.peer, kind, cost_us)
                self._dispatch(kind, payload)
        except BlockRobotError as error:
            self._owner.offended(self, error)
        except Exception:
            # A timer may have called this, whose faults the loop only logs: the socket would stay paused for ever.
            log.exception("peer_frame_fault", peer=self.peer)
            self.abort()

    def _wait_for_more(self, *, has_cut: bool) -> None:
        if not has_cut:
            self._owner.pay_reading(self.peer, READ_US)
        if self._decoder.has_begun and self._late is None:
            self._late = asyncio.get_running_loop().call_later(FRAME_TIMEOUT_MS / 1000, self._frame_is_late)
        self._let_go()

    def _frame_is_late(self) -> None:
        log.warning("peer_frame_too_slow", peer=self.peer, timeout_ms=FRAME_TIMEOUT_MS)
        self.abort()

    def _forget_deadline(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def _hold(self, wait_s: float) -> None:
        self._forget_deadline()  # it is this node that reads no further
        loop = asyncio.get_running_loop()
        self._reading_on = loop.call_later(wait_s, self._read_on) if wait_s > 0 else loop.call_soon(self._read_on)
        if not self._is_held and self._transport is not None:
            self._is_held = True
            self._transport.pause_reading()

    def _let_go(self) -> None:
        if self._is_held and self._transport is not None:
            self._is_held = False
            self._transport.resume_reading()

    def resume_writing(self) -> None:
        if self._is_resuming:
            return
        self._is_resuming = True
        try:
            while self._gossip and self.is_open and self._waiting_bytes() < GOSSIP_ABOVE_BYTES:
                self._pass_on(self._gossip.popleft())
        finally:
            self._is_resuming = False

    # Frames

    def _dispatch(self, kind: FrameKind, payload: bytes) -> None:
        self._traffic.note(self.peer, "received", int(kind), HEADER_SIZE_BYTES + len(payload))
        if kind is FrameKind.REQUEST:
            self._serve(payload)
        elif kind is FrameKind.RESPONSE:
            self._resolve(payload)
        else:
            self._owner.frame_received(self, kind, payload)

    def send(self, kind: FrameKind, frame: bytes) -> None:
        if not self.is_open:
            return
        if kind is FrameKind.HELLO and self._shaper is not None and not self._shaper.admits(self.peer):
            self.abort()
            return
        waiting = self._waiting_bytes()
        if kind in GOSSIP_KINDS and (self._gossip or waiting > GOSSIP_ABOVE_BYTES):
            self.gossip_dropped_count += len(self._gossip) == GOSSIP_QUEUE_MAX_COUNT
            self._gossip.append(frame)
            return
        if waiting + len(frame) > SEND_BUFFER_MAX_BYTES:
            log.warning("peer_too_slow", peer=self.peer, waiting_bytes=waiting)
            self.abort()
            return
        self._pass_on(frame)

    def _waiting_bytes(self) -> int:
        held_back = 0 if self._shaper is None else self._shaper.waiting_bytes(self.peer)
        return held_back + self.transport.get_write_buffer_size()

    def _pass_on(self, frame: bytes) -> None:
        self._traffic.note(self.peer, "sent", frame[HEADER_SIZE_BYTES - 1], len(frame))
        if self._shaper is not None:
            self._shaper.deliver(self.peer, frame, self._write)
        else:
            self._write(frame)

    def _write(self, frame: bytes) -> None:
        if self.is_open:
            self.transport.write(frame)
            if self._gossip and self._shaper is not None:
                self.resume_writing()

    def close(self) -> None:
        """Close after what is buffered was sent."""
        if self._transport is not None:
            self._transport.close()

    def cut_off(self, linger_s: float) -> None:
        """Stop reading; send what is buffered within `linger_s`, then close."""
        self._is_cut_off = True
        self.close()
        asyncio.get_running_loop().call_later(linger_s, self.abort)

    def abort(self) -> None:
        self._is_cut_off = True
        if self._transport is not None:
            self._transport.abort()

    # Requests

    async def request(self, kind: RequestKind, body: bytes, timeout_s: float) -> bytes:
        """Raises PEER_UNAVAILABLE if it refuses or times out."""
        if not self.is_open:
            raise BlockRobotError("PEER_UNAVAILABLE")
        self._next_request = number = (self._next_request + 1) & 0xFFFFFFFF
        future = self._requests[number] = asyncio.get_running_loop().create_future()
        try:
            self.send(FrameKind.REQUEST, encode_frame(FrameKind.REQUEST, encode_request(number, kind, body)))
            async with asyncio.timeout(timeout_s):
                answer: bytes = await future
                return answer
        except TimeoutError:
            raise BlockRobotError("PEER_UNAVAILABLE", f"{self.peer} did not answer in {timeout_s} s.") from None
        finally:
            self._requests.pop(number, None)

    def _resolve(self, payload: bytes) -> None:
        number, status, body = decode_request(payload)
        future = self._requests.get(number)
        if future is None or future.done():
            self._owner.pay(self.peer, FrameKind.RESPONSE, UNASKED_FACTOR * bytes_cost_us(len(payload)))
            return
        if status == _ANSWERED:
            future.set_result(body)
        else:
            future.set_exception(BlockRobotError("PEER_UNAVAILABLE", f"{self.peer} refused the request."))

    def _serve(self, payload: bytes) -> None:
        number, kind, body = decode_request(payload)
        try:
            request_kind = RequestKind(kind)
        except ValueError:
            raise BlockRobotError("PEER_MESSAGE_INVALID", f"A request of unknown kind {kind}.") from None
        if len(self._serving) >= REQUESTS_SERVED_MAX_COUNT:
            self._owner.too_many_requests(self.peer)
            self._respond(number, _REFUSED, b"")
            return
        self._spawn(self._answer(number, request_kind, body))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._serving.add(task)
        task.add_done_callback(self._serving.discard)

    async def _answer(self, number: int, kind: RequestKind, body: bytes) -> None:
        try:
            self._respond(number, _ANSWERED, await self._owner.answer(self.peer, kind, body))
        except BlockRobotError as error:
            log.debug("peer_request_refused", peer=self.peer, kind=kind.name, code=error.code)
            self._respond(number, _REFUSED, b"")

    def _respond(self, number: int, status: int, body: bytes) -> None:
        self.send(FrameKind.RESPONSE, encode_frame(FrameKind.RESPONSE, encode_request(number, status, body)))

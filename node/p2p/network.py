"""The node's links to all other nodes: one connection per pair, dialled by the one that stands first in genesis.

Must never pass a frame on from a connection whose certificate and hello were not checked.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import socket
from typing import Protocol

import structlog

from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.primitives.encoding import decode, encode
from node.config import NodeConfig
from node.p2p.connection import LinkShaper, PeerConnection
from node.p2p.tls import client_context, identify_peer, server_context
from node.p2p.wire import PROTOCOL_VERSION, FrameKind, Hello, RequestKind, encode_frame

DIAL_BACKOFF_MIN_MS = 50
DIAL_BACKOFF_MAX_MS = 1_000
DIAL_TIMEOUT_MS = 5_000
REQUEST_TIMEOUT_MS = 5_000
_BACKLOG_COUNT = 128

log = structlog.get_logger(__name__)


class PeerHandler(Protocol):
    """What the node does with its peers' words."""

    def finalized_height(self) -> int:
        """Return the node's finalized height, for the hello."""
        ...

    def peer_connected(self, peer: str, finalized_height: int) -> None:
        """A peer is connected and has said hello."""
        ...

    def peer_disconnected(self, peer: str) -> None:
        """A peer is gone."""
        ...

    def peer_frame(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        """A frame of a peer. Raises BlockRobotError if it is malformed: the peer is then cut off."""
        ...

    async def peer_request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Answer a peer's request. Raises BlockRobotError to refuse."""
        ...


class PeerNetwork:
    """All connections of one node."""

    def __init__(
        self, config: NodeConfig, genesis: Genesis, handler: PeerHandler, shaper: LinkShaper | None = None
    ) -> None:
        self._config = config
        self._genesis = genesis
        self._handler = handler
        self._shaper = shaper
        self._peers: dict[str, PeerConnection] = {}
        self._open: set[PeerConnection] = set()
        self._server: asyncio.Server | None = None
        self._dialling: list[asyncio.Task[None]] = []
        self._server_tls = server_context(config, genesis)
        self._client_tls = client_context(config, genesis)

    @property
    def connected(self) -> list[str]:
        """The names of the connected peers, sorted."""
        return sorted(self._peers)

    async def start(self) -> None:
        """Listen, and dial the nodes that stand behind this one in genesis. Raises PORT_IN_USE."""
        loop = asyncio.get_running_loop()
        listener = bind_listener(self._config.host, self._config.p2p_port)
        self._server = await loop.create_server(
            lambda: PeerConnection(self, self._shaper, None),
            sock=listener,
            ssl=self._server_tls,
            ssl_handshake_timeout=DIAL_TIMEOUT_MS / 1000,
        )
        names = [node.name for node in self._genesis.nodes]
        for name in names[names.index(self._config.name) + 1 :]:
            self._dialling.append(loop.create_task(self._keep_dialling(name), name=f"dial-{name}"))

    async def stop(self) -> None:
        """Close everything."""
        for task in self._dialling:
            task.cancel()
        await asyncio.gather(*self._dialling, return_exceptions=True)
        if self._server is not None:
            self._server.close()
        connections = list(self._open)
        for connection in connections:
            connection.close()
        if connections:
            await asyncio.wait([connection.closed for connection in connections], timeout=1.0)
        for connection in list(self._open):
            connection.abort()
        await asyncio.sleep(0)

    # Sending

    def broadcast(self, kind: FrameKind, payload: bytes) -> None:
        """Send one payload to all connected peers; it is framed once."""
        frame = encode_frame(kind, payload)
        for connection in list(self._peers.values()):
            connection.send(kind, frame)

    def send(self, peer: str, kind: FrameKind, payload: bytes) -> bool:
        """Send to one peer; tell whether it is connected."""
        connection = self._peers.get(peer)
        if connection is None:
            return False
        connection.send(kind, encode_frame(kind, payload))
        return True

    async def request(self, peer: str, kind: RequestKind, body: bytes, timeout_ms: int = REQUEST_TIMEOUT_MS) -> bytes:
        """Ask one peer. Raises PEER_UNAVAILABLE."""
        connection = self._peers.get(peer)
        if connection is None:
            raise BlockRobotError("PEER_UNAVAILABLE", f"{peer} is not connected.")
        return await connection.request(kind, body, timeout_ms / 1000)

    # Dialling

    async def _keep_dialling(self, name: str) -> None:
        backoff_ms = DIAL_BACKOFF_MIN_MS
        while True:
            if await self._dial(name):
                backoff_ms = DIAL_BACKOFF_MIN_MS
            jitter = random.uniform(0.5, 1.0)  # noqa: S311 - no secret
            await asyncio.sleep(backoff_ms * jitter / 1000)
            backoff_ms = min(DIAL_BACKOFF_MAX_MS, backoff_ms * 2)

    async def _dial(self, name: str) -> bool:
        """Dial once; return after the connection ended, True if the peer had been greeted."""
        node = self._genesis.node(name)
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(DIAL_TIMEOUT_MS / 1000):
                _, connection = await loop.create_connection(
                    lambda: PeerConnection(self, self._shaper, name),
                    node.host,
                    node.p2p_port,
                    ssl=self._client_tls,
                )
        except (OSError, TimeoutError):
            return False
        await connection.closed
        return connection.greeted

    # ConnectionOwner

    def connection_made(self, connection: PeerConnection) -> None:
        """Check who it is, and say hello."""
        self._open.add(connection)
        transport_socket = connection.transport.get_extra_info("socket")
        if transport_socket is not None:
            with contextlib.suppress(OSError):
                transport_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            name = identify_peer(connection.certificate_der(), self._genesis)
            self._require_expected(connection, name)
        except (BlockRobotError, ValueError) as error:
            code = error.code if isinstance(error, BlockRobotError) else "PEER_REFUSED"
            log.warning("peer_refused", code=code, detail=str(error))
            connection.abort()
            return
        connection.peer = name
        hello = Hello(
            version=PROTOCOL_VERSION,
            chain_id=self._genesis.chain_id,
            name=self._config.name,
            finalized_height=self._handler.finalized_height(),
        )
        connection.send(FrameKind.HELLO, encode_frame(FrameKind.HELLO, encode(hello)))

    def _require_expected(self, connection: PeerConnection, name: str) -> None:
        if connection.dialled is not None and name != connection.dialled:
            raise BlockRobotError("PEER_REFUSED", f"{name!r} answered where {connection.dialled!r} should be.")
        names = [node.name for node in self._genesis.nodes]
        if connection.dialled is None and names.index(name) >= names.index(self._config.name):
            raise BlockRobotError("PEER_REFUSED", f"{name!r} dialled, though this node dials it.")

    def connection_lost(self, connection: PeerConnection) -> None:
        """Forget it."""
        self._open.discard(connection)
        if self._peers.get(connection.peer) is connection:
            del self._peers[connection.peer]
            log.info("peer_disconnected", peer=connection.peer)
            self._handler.peer_disconnected(connection.peer)

    def frame_received(self, connection: PeerConnection, kind: FrameKind, payload: bytes) -> None:
        """Check the hello, then pass frames on."""
        if kind is not FrameKind.HELLO:
            self._handler.peer_frame(connection.peer, kind, payload)
            return
        hello = decode(payload, Hello)
        if connection.greeted or hello.version != PROTOCOL_VERSION or hello.name != connection.peer:
            raise BlockRobotError("PEER_MESSAGE_INVALID", "The hello does not fit the connection.")
        if hello.chain_id != self._genesis.chain_id:
            raise BlockRobotError("PEER_REFUSED", f"{connection.peer} is on another chain.")
        connection.greeted = True
        previous = self._peers.get(connection.peer)
        self._peers[connection.peer] = connection
        if previous is not None:
            previous.abort()
        log.info("peer_connected", peer=connection.peer, height=hello.finalized_height)
        self._handler.peer_connected(connection.peer, hello.finalized_height)

    async def answer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Pass a request on."""
        return await self._handler.peer_request(peer, kind, body)


def bind_listener(host: str, port: int) -> socket.socket:
    """Return a listening TCP socket. Raises PORT_IN_USE."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(_BACKLOG_COUNT)
    except OSError:
        listener.close()
        raise BlockRobotError("PORT_IN_USE", f"Another program already listens on {host}:{port}.") from None
    return listener

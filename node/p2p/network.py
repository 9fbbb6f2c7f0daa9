"""Links to all other nodes, by the directory: one per pair, dialled by the lower name, or by the other if that cannot."""

from __future__ import annotations

import asyncio
import contextlib
import random
import socket
import ssl
import time
from collections.abc import Callable
from typing import Any, Protocol

import structlog

from consensus.chain.genesis import PARTS, Genesis
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.primitives.encoding import decode, encode
from node.config import NodeConfig
from node.directory.node_directory import Directory
from node.limits.peer_bans import PeerBans
from node.limits.refusal_log import RefusalLog
from node.limits.token_buckets import Allowance, Source, TokenBuckets, source_at
from node.limits.work_costs import REFUSAL_US
from node.p2p.connection import LinkShaper, PeerConnection
from node.p2p.connection_acceptor import OF_PEERS, SHUTDOWN_TIMEOUT_MS, ConnectionAcceptor, bind_listener
from node.p2p.frame_costs import FRAME_COSTS, Lane
from node.p2p.identity import PROVEN_REFUSALS, identify_peer
from node.p2p.tls import Credentials
from node.p2p.traffic import Traffic
from node.p2p.wire import PROTOCOL_VERSION, FrameKind, Hello, Refusal, RequestKind, encode_frame
from pages.listening import share_of_descriptors
from pages.name_lookups import NameLookups

HELLO_TIMEOUT_MS = 5_000


UNGREETED_OF_PEER_MAX_COUNT = 2


UNGREETED_MAX_COUNT = 64


_DESCRIPTORS_PART = 16


class Greeting:
    """Connections awaiting the hello, the oldest first."""

    def __init__(self, give_up: Callable[[PeerConnection, str], None]) -> None:
        """`give_up` gets a connection to close, and why."""
        self._give_up = give_up
        self._max_count = share_of_descriptors(UNGREETED_MAX_COUNT, _DESCRIPTORS_PART)
        self._waiting: dict[PeerConnection, asyncio.TimerHandle] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, connection: PeerConnection) -> None:
        """Await the hello of a connection whose `peer` is known."""
        late = asyncio.get_running_loop().call_later(HELLO_TIMEOUT_MS / 1000, self._end, connection, "in time")
        self._waiting[connection] = late
        of_peer = [each for each in self._waiting if each.peer == connection.peer]
        if len(of_peer) > UNGREETED_OF_PEER_MAX_COUNT:
            self._end(of_peer[0], "while it made further connections")
        elif len(self._waiting) > self._max_count:
            self._end(next(iter(self._waiting)), "before others needed its place")

    def remove(self, connection: PeerConnection) -> None:
        late = self._waiting.pop(connection, None)
        if late is not None:
            late.cancel()

    def _end(self, connection: PeerConnection, why: str) -> None:
        self.remove(connection)
        self._give_up(connection, f"{connection.peer!r} shook hands and said no hello {why}.")


DIAL_BACKOFF_MIN_MS = 50
DIAL_BACKOFF_MAX_MS = 1_000
DIAL_TIMEOUT_MS = 5_000
MISSED_AFTER_MS = 4_000
"""For how long the node with the higher name waits to be dialled, before it dials itself."""
KEEP_ALIVE_S, KEEP_ALIVE_EVERY_S, KEEP_ALIVE_COUNT = 30, 10, 3
"""A link with nothing to say is asked for after so long, so that firewalls do not forget it, and given up if it is mute."""
UNANSWERED_MAX_MS = 20_000
"""A link on which something was sent, and nothing came back for so long, is given up: its other side may be gone."""
REQUEST_TIMEOUT_MS = 5_000
CERTIFICATE_CHECK_MS = 1_000
LINK_RENEWAL_MS = 250
REFUSED_LINGER_MS = 200
LINK_ALLOWANCE = Allowance(us_per_s=60_000, burst_us=120_000)
"""What reading a peer's frames may cost: some 7,000 small ones a second, or 30 MB."""
CONSENSUS_ALLOWANCE = Allowance(us_per_s=80_000, burst_us=200_000)
"""What a peer's votes, proposals and certificates may cost: five times what an honest one says in a busy network."""

log = structlog.get_logger(__name__)


def wall_now_ms() -> int:
    return time.time_ns() // 1_000_000


def _keep_alive(transport_socket: Any) -> None:
    transport_socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if hasattr(socket, "TCP_KEEPIDLE"):  # not on every system
        transport_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEP_ALIVE_S)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        transport_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MAX_MS)
    transport_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEP_ALIVE_EVERY_S)
    transport_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEP_ALIVE_COUNT)


class PeerHandler(Protocol):
    """How the node handles its peers' messages."""

    def finalized_height(self) -> int: ...

    def peer_connected(self, peer: str, finalized_height: int) -> None: ...

    def peer_disconnected(self, peer: str) -> None: ...

    def peer_frame(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        """A peer's frame. Raises BlockRobotError if malformed: the peer is disconnected."""
        ...

    async def peer_request(self, peer: str, kind: RequestKind, body: bytes) -> bytes: ...

    def on_over_budget(self, source: Source, wait_s: float) -> None: ...


class PeerNetwork:
    """All connections of one node."""

    def __init__(
        self,
        config: NodeConfig,
        genesis: Genesis,
        handler: PeerHandler,
        shaper: LinkShaper | None = None,
        *,
        directory: Directory | None = None,
        clock: Callable[[], int] = wall_now_ms,
    ) -> None:
        """Read the node's certificate. Raises CONFIGURATION_INVALID, GENESIS_INVALID."""
        self._config = config
        self._name = config.name
        self._genesis = genesis
        self._handler = handler
        self._shaper = shaper
        self._clock = clock
        self._directory = directory or Directory.of_genesis(genesis)
        self.traffic = Traffic()
        self._peers: dict[str, PeerConnection] = {}
        self._open: set[PeerConnection] = set()
        self._listener: socket.socket | None = None
        self._peer_sources = self._find_peer_sources()
        self._accepting = ConnectionAcceptor(
            lambda: self._credentials.accepting, handler.on_over_budget, OF_PEERS, lambda: self._peer_sources
        )
        self._greeting = Greeting(self._give_up)
        self._links: TokenBuckets[str] = TokenBuckets(lambda _peer: LINK_ALLOWANCE, time.monotonic)
        self._consensus: TokenBuckets[str] = TokenBuckets(lambda _peer: CONSENSUS_ALLOWANCE, time.monotonic)
        self._peer_bans = PeerBans()
        self._lookups = NameLookups()
        self._dialling: dict[str, tuple[tuple[str, int], asyncio.Task[None]]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._refused = RefusalLog("peer_refused")
        self._refused_by = RefusalLog("refused_by_peer")
        self._said_of_own: str | None = None
        self._credentials = Credentials(config.tls_certificate_path, config.tls_key_path, self._directory.content)

    def client_context(self) -> ssl.SSLContext:
        """The newest TLS context for clients."""
        return self._credentials.serving

    @property
    def connected(self) -> list[str]:
        return sorted(self._peers)

    async def start(self) -> None:
        """Listen, and dial the others. Raises PORT_IN_USE, PORT_NOT_PERMITTED, ADDRESS_NOT_HERE."""
        self._listener = bind_listener(self._config.host, self._config.p2p_port)
        self._spawn(self._accepting.run(self._listener, self._connection))
        self._directory.add_listener(self._directory_changed)
        self._dial_the_right_ones()
        self._spawn(self._watch_certificates())

    async def stop(self) -> None:
        self._directory.remove_listener(self._directory_changed)
        tasks = [*self._tasks, *(task for _, task in self._dialling.values())]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self._listener is not None:
            self._listener.close()
        connections = list(self._open)
        for connection in connections:
            connection.close()
        if connections:
            await asyncio.wait([connection.closed for connection in connections], timeout=1.0)
        for connection in list(self._open):
            connection.abort()
        await asyncio.sleep(0)

    def _connection(self, dialled: str | None = None) -> PeerConnection:
        return PeerConnection(self, self._shaper, dialled, self.traffic)

    def _spawn(self, work: Any) -> None:
        task: asyncio.Task[None] = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # Sending

    def broadcast(self, kind: FrameKind, payload: bytes) -> None:
        frame = encode_frame(kind, payload)
        for connection in list(self._peers.values()):
            connection.send(kind, frame)

    def send(self, peer: str, kind: FrameKind, payload: bytes) -> bool:
        connection = self._peers.get(peer)
        if connection is None:
            return False
        connection.send(kind, encode_frame(kind, payload))
        return True

    async def request(self, peer: str, kind: RequestKind, body: bytes, timeout_ms: int = REQUEST_TIMEOUT_MS) -> bytes:
        """Raises PEER_UNAVAILABLE."""
        connection = self._peers.get(peer)
        if connection is None:
            raise BlockRobotError("PEER_UNAVAILABLE", f"{peer} is not connected.")
        return await connection.request(kind, body, timeout_ms / 1000)

    # Dialling

    def _dial_the_right_ones(self) -> None:
        """Others dial as well as they can: a firewall may let only one side of a pair in."""
        wanted = {name: node.address for name, node in self._directory.content.active.items() if name != self._name}
        for name, (address, task) in list(self._dialling.items()):
            if wanted.get(name) != address:
                task.cancel()
                del self._dialling[name]
                for connection in [item for item in self._open if item.dialled == name]:
                    connection.abort()
        for name, address in wanted.items():
            if name not in self._dialling:
                task = asyncio.get_running_loop().create_task(self._keep_dialling(name, *address), name=f"dial-{name}")
                self._dialling[name] = (address, task)

    async def _keep_dialling(self, name: str, host: str, port: int) -> None:
        backoff_ms = DIAL_BACKOFF_MIN_MS
        while True:
            while name < self._name and not await self._is_missed(name):
                pass
            if self._may_dial(name) and await self._dial(name, host, port):
                backoff_ms = DIAL_BACKOFF_MIN_MS
            jitter = random.uniform(0.5, 1.0)  # noqa: S311 - no secret
            await asyncio.sleep(backoff_ms * jitter / 1000)
            backoff_ms = min(DIAL_BACKOFF_MAX_MS, backoff_ms * 2)

    async def _is_missed(self, name: str) -> bool:
        """Wait for a node that is to dial this one; return whether it did not come."""
        await asyncio.sleep(MISSED_AFTER_MS * random.uniform(0.75, 1.0) / 1000)  # noqa: S311 - no secret
        return name not in self._peers

    def _may_dial(self, name: str) -> bool:
        if self._peer_bans.is_banned(name):
            return False
        return not self._credentials.own.facts.is_expired(self._clock())

    async def _dial(self, name: str, host: str, port: int) -> bool:
        """Dial once; return after the connection ended, True if greeted."""
        try:
            async with asyncio.timeout(DIAL_TIMEOUT_MS / 1000):
                connection = await self._connect(name, host, port)
        except ssl.SSLCertVerificationError:
            detail = f"The node at {name}'s address shows a certificate that is not from its organisation's authority."
            self._refused.note(name, BlockRobotError("PEER_CERTIFICATE_FOREIGN", detail), self._clock())
            return False
        except (BlockRobotError, OSError, TimeoutError, UnicodeError, OverflowError):
            return False  # nobody is there, the address that was agreed upon is none, or own files are half-written
        await connection.closed
        return connection.greeted

    async def _connect(self, name: str, host: str, port: int) -> PeerConnection:
        """Raises OSError, BlockRobotError.

        As the server's name (SNI) it says whose node this is, so that its certificate is checked by that alone.
        """
        nodes = self._directory.content.nodes
        organisation = nodes[self._name].organisation if self._name in nodes else self._config.organisation
        failure = OSError("no address")
        for address in await self._lookups.find(host, name):
            try:
                _, connection = await asyncio.get_running_loop().create_connection(
                    lambda: self._connection(name),
                    address,
                    port,
                    ssl=self._credentials.dialling(nodes[name].organisation),
                    server_hostname=organisation or host,
                    ssl_shutdown_timeout=SHUTDOWN_TIMEOUT_MS / 1000,
                )
            except ssl.SSLError:
                raise
            except OSError as error:
                failure = error
            else:
                return connection
        raise failure

    # Following the directory and the certificates

    def _find_peer_sources(self) -> frozenset[Source]:
        """Return where others dial from, as far as the directory has addresses and no names."""
        active = self._directory.content.active
        return frozenset(source_at(node.host) for name, node in active.items() if name != self._name)

    def _directory_changed(self, _directory: Directory) -> None:
        self._peer_sources = self._find_peer_sources()
        self._trust_directory()
        self._check_open_connections()
        self._dial_the_right_ones()

    def _trust_directory(self) -> None:
        try:
            if self._credentials.trust(self._directory.content):
                log.info("authorities_changed", height=self._directory.height)
        except BlockRobotError as error:
            log.error("authorities_unusable", code=error.code, detail=error.detail)

    def _check_open_connections(self) -> None:
        for connection in [item for item in self._open if item.peer]:
            try:
                identify_peer(connection.certificate, self._directory.content, self._clock())
            except BlockRobotError as error:
                self._refuse(connection, error)

    async def _watch_certificates(self) -> None:
        while True:
            self.reload_certificate()
            self._trust_directory()
            self._say_how_own_certificate_is()
            now_ms = self._clock()
            if any(item.peer and item.not_after_ms < now_ms for item in self._open):
                self._check_open_connections()
            await asyncio.sleep(CERTIFICATE_CHECK_MS / 1000)

    def reload_certificate(self) -> None:
        """Reload changed certificate and key files; renew links one by one."""
        try:
            if not self._credentials.reload():
                return
        except BlockRobotError as error:
            self._refused_by.note(self._name, error, self._clock())
            return
        self._refused_by.forget(self._name)
        facts = self._credentials.own.facts
        log.info("certificate_renewed", serial=facts.serial_hex, expires=facts.expires)
        self._spawn(self._renew_links(list(self._peers.values())))

    async def _renew_links(self, connections: list[PeerConnection]) -> None:
        for connection in connections:
            connection.close()
            await asyncio.sleep(LINK_RENEWAL_MS / 1000)

    def _say_how_own_certificate_is(self) -> None:
        own, now_ms = self._credentials.own, self._clock()
        state = own.state(now_ms)
        before, self._said_of_own = self._said_of_own, f"{state} {own.facts.serial_hex}"
        if before == self._said_of_own:
            return
        if state == "expired":
            error = BlockRobotError("CERTIFICATE_EXPIRED", own.sentence(now_ms))
            log.error("certificate_expired", code=error.code, detail=error.detail, next_step=error.next_step)
        elif state == "expiring":
            error = BlockRobotError("CERTIFICATE_EXPIRES_SOON", own.sentence(now_ms))
            log.warning("certificate_expires_soon", code=error.code, detail=error.detail, next_step=error.next_step)

    def own_problem(self) -> BlockRobotError | None:
        now_ms, content = self._clock(), self._directory.content
        own = self._credentials.own
        if own.facts.is_expired(now_ms):
            return BlockRobotError("CERTIFICATE_EXPIRED", own.sentence(now_ms))
        node = content.nodes.get(self._name)
        if node is not None and not content.is_active(node):
            return BlockRobotError("NODE_REMOVED", f"{self._name} was removed from the network.")
        if node is not None and (node.organisation, own.facts.serial) in content.revoked:
            return BlockRobotError("CERTIFICATE_REVOKED", f"The certificate {own.facts.serial_hex} was revoked.")
        return None

    @property
    def certificate_not_after_ms(self) -> int:
        return self._credentials.own.facts.not_after_ms

    def describe(self) -> dict[str, Any]:
        problem, now_ms = self.own_problem(), self._clock()
        return {
            "certificate": self._credentials.own.describe(now_ms),
            "refused_peers": self._refused.describe(now_ms),
            "cut_off_peers": self._peer_bans.describe(now_ms),
            "refused_by": self._refused_by.describe(now_ms),
            "problem": None
            if problem is None
            else {"code": problem.code, "detail": problem.detail, "next_step": problem.next_step},
        }

    # ConnectionOwner

    def connection_made(self, connection: PeerConnection) -> None:
        self._open.add(connection)
        transport_socket = connection.transport.get_extra_info("socket")
        if transport_socket is not None:
            with contextlib.suppress(OSError):
                transport_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                _keep_alive(transport_socket)
        connection.certificate = connection.certificate_der()
        try:
            facts = identify_peer(connection.certificate, self._directory.content, self._clock())
            self._require_expected(connection, facts.name)
            self._peer_bans.require_not_banned(facts.name)
        except BlockRobotError as error:
            self._refuse(connection, error)
            return
        connection.peer, connection.not_after_ms = facts.name, facts.not_after_ms
        self._greeting.add(connection)
        hello = Hello(
            version=PROTOCOL_VERSION,
            chain_id=self._genesis.chain_id,
            name=self._name,
            finalized_height=self._handler.finalized_height(),
            genesis=self._genesis.part_digests,
        )
        connection.send(FrameKind.HELLO, encode_frame(FrameKind.HELLO, encode(hello)))

    def _refuse(self, connection: PeerConnection, error: BlockRobotError) -> None:
        """Close a connection; only a proven node gets the error code."""
        peer = str(error.context.get("peer", "")) or connection.dialled or "unknown"
        self._refused.note(peer, error, self._clock())
        if error.code in PROVEN_REFUSALS:
            connection.send(FrameKind.REFUSAL, encode_frame(FrameKind.REFUSAL, encode(Refusal(code=error.code))))
            connection.cut_off(REFUSED_LINGER_MS / 1000)
        else:
            connection.abort()
        self._forget(connection)

    def _refuse_founding(self, connection: PeerConnection, hello: Hello) -> None:
        """Name the parts that differ; both sides do, since both have said hello."""
        pairs = zip(PARTS, self._genesis.part_digests, hello.genesis, strict=False)
        parts = ", ".join(name for name, own, other in pairs if own != other) or "what nobody can tell"
        detail = f"{connection.peer} is of a network with another genesis file. What differs: {parts}."
        self._refused.note(connection.peer, BlockRobotError("GENESIS_DIFFERS", detail), self._clock())
        self._greeting.remove(connection)
        connection.cut_off(REFUSED_LINGER_MS / 1000)
        self._forget(connection)

    def _give_up(self, connection: PeerConnection, why: str) -> None:
        self._refused.note(connection.peer, BlockRobotError("PEER_SILENT", why), self._clock())
        connection.abort()

    def _require_expected(self, connection: PeerConnection, name: str) -> None:
        if connection.dialled is not None and name != connection.dialled:
            raise BlockRobotError("PEER_REFUSED", f"{name!r} answered where {connection.dialled!r} should be.")
        if name == self._name:
            raise BlockRobotError("PEER_REFUSED", f"{name!r} is this node's own name.", peer=name)

    def _is_better(self, connection: PeerConnection, other: PeerConnection) -> bool:
        """Both sides of a pair keep the same of two links: what the lower name dialled, else the newer one."""
        lower = min(self._name, connection.peer)
        dialled_by = [link.peer if link.dialled is None else self._name for link in (connection, other)]
        return dialled_by[0] == lower or dialled_by[1] != lower

    def connection_lost(self, connection: PeerConnection) -> None:
        self._open.discard(connection)
        self._greeting.remove(connection)
        self._forget(connection)

    def _forget(self, connection: PeerConnection) -> None:
        if self._peers.get(connection.peer) is connection:
            del self._peers[connection.peer]
            log.info("peer_disconnected", peer=connection.peer)
            self._handler.peer_disconnected(connection.peer)

    def frame_received(self, connection: PeerConnection, kind: FrameKind, payload: bytes) -> None:
        if kind is FrameKind.REFUSAL:
            self._note_refused_by(connection, decode(payload, Refusal).code)
            return
        if kind is not FrameKind.HELLO:
            self._handler.peer_frame(connection.peer, kind, payload)
            return
        hello = decode(payload, Hello)
        if connection.greeted or hello.version != PROTOCOL_VERSION or hello.name != connection.peer:
            raise BlockRobotError("PEER_MESSAGE_INVALID", "The hello does not fit the connection.")
        if hello.chain_id != self._genesis.chain_id:
            self._refuse_founding(connection, hello)
            return
        connection.greeted = True
        self._greeting.remove(connection)
        previous = self._peers.get(connection.peer)
        if previous is not None and not self._is_better(connection, previous):
            connection.abort()
            return
        self._peers[connection.peer] = connection
        if previous is not None:
            previous.abort()
        self._refused.forget(connection.peer)
        self._refused_by.forget(connection.peer)
        log.info("peer_connected", peer=connection.peer, height=hello.finalized_height)
        self._handler.peer_connected(connection.peer, hello.finalized_height)

    def _note_refused_by(self, connection: PeerConnection, code: str) -> None:
        """Raises PEER_MESSAGE_INVALID for an unknown reason."""
        if code not in PROVEN_REFUSALS or code not in CATALOGUE:
            raise BlockRobotError("PEER_MESSAGE_INVALID", "The peer's reason for a refusal is none.")
        error = BlockRobotError(code, f"{connection.peer} refuses this node: {CATALOGUE[code].meaning}")
        self._refused_by.note(connection.peer, error, self._clock())
        connection.abort()

    def pay(self, peer: str, kind: FrameKind, cost_us: int) -> None:
        if FRAME_COSTS[kind].lane is Lane.CONSENSUS:
            self._consensus.charge(peer, cost_us)
        else:
            self._links.charge(peer, cost_us - FRAME_COSTS[kind].us)

    def pay_reading(self, peer: str, cost_us: int) -> None:
        self._links.charge(peer, cost_us)

    def too_many_requests(self, peer: str) -> None:
        self._links.charge(peer, REFUSAL_US)
        self._handler.on_over_budget(Source("peer", peer), 1.0)

    def wait_s(self, peer: str) -> float:
        wait_s = max(self._links.wait_s(peer), self._consensus.wait_s(peer))
        if wait_s > 0:
            self._handler.on_over_budget(Source("peer", peer), wait_s)
        return wait_s

    def offended(self, connection: PeerConnection, error: BlockRobotError) -> None:
        if connection.greeted:
            self._peer_bans.ban(connection.peer, error)
            connection.abort()
        else:
            log.warning("peer_message_refused", peer=connection.peer, code=error.code, detail=error.detail)
            connection.cut_off(REFUSED_LINGER_MS / 1000)

    def cut_off(self, peer: str, error: BlockRobotError) -> None:
        """Ignore a misbehaving peer for a time that doubles each time."""
        connection = self._peers.get(peer)
        if connection is not None:
            self.offended(connection, error)

    async def answer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        return await self._handler.peer_request(peer, kind, body)

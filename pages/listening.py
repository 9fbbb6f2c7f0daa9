"""Listeners with limited connections; at the limit, the longest idle one of the address with most is closed."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import resource
import socket
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Hashable, Iterator
from contextlib import AbstractContextManager, asynccontextmanager, contextmanager
from functools import partial
from typing import Any, Generic, TypeVar

from aiohttp import web

IDLE_MAX_MS = 30_000
LINGER_MAX_MS = 2_000
ACCEPT_PAUSE_MS = 100
BACKLOG_COUNT = 1024
HELD_BACK_OF_KEY_MAX_COUNT = 16
OF_SHARER_PART = 4
NETWORK_BITS = 64
"""Of an IPv6 address: what is the same for all addresses of a network."""
NO_KEY = b""
A = TypeVar("A", bound=Hashable)
T = TypeVar("T", bound=Hashable)
_log = logging.getLogger(__name__)
_silent = logging.getLogger("pages.requests")
_silent.setLevel(logging.CRITICAL)
"""aiohttp's loggers tell what callers sent, and print it on standard error: a stranger would write on our terminal."""


def share_of_descriptors(most: int, part: int) -> int:
    """Return `most`, limited to this part of all descriptors."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return most if soft < 0 else max(1, min(most, soft // part))


class ByAddress(Generic[A, T]):
    """What each address holds, the oldest first."""

    def __init__(self) -> None:
        self._held: dict[A, dict[T, None]] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __contains__(self, item: tuple[A, T]) -> bool:
        return item[1] in self._held.get(item[0], ())

    def count_of(self, address: A) -> int:
        return len(self._held.get(address, ()))

    def add(self, address: A, item: T) -> None:
        """As the newest, also where it is held already."""
        self.remove(address, item)
        self._held.setdefault(address, {})[item] = None
        self._count += 1

    def remove(self, address: A, item: T) -> None:
        if (address, item) in self:
            del self._held[address][item]
            self._count -= 1
            if not self._held[address]:
                del self._held[address]

    def pop_oldest(self, address: A | None = None) -> T:
        """Of this address, else of the one that holds most. Raises LookupError."""
        if not self._held:
            raise LookupError
        holder = max(self._held, key=self.count_of) if address is None else address
        item = next(iter(self._held[holder]))
        self.remove(holder, item)
        return item


class ConnectionTable:
    """The open connections of one listener, idle and busy."""

    def __init__(self, max_count: int) -> None:
        self._max_count = max_count
        self._idle: ByAddress[str, Connection] = ByAddress()
        self._busy: set[Connection] = set()
        self._held_back: Counter[Hashable] = Counter()

    def __len__(self) -> int:
        return len(self._idle) + len(self._busy)

    def add(self, connection: Connection) -> None:
        """Add a connection; beyond the limit, close the longest idle one of the address with most idle ones."""
        self._idle.add(connection.network, connection)
        if len(self) > self._max_count:
            self._idle.pop_oldest().abort()

    def remove(self, connection: Connection) -> None:
        self._idle.remove(connection.network, connection)
        self._busy.discard(connection)

    def begin(self, connection: Connection) -> None:
        if (connection.network, connection) in self._idle:
            self._idle.remove(connection.network, connection)
            self._busy.add(connection)

    def note_bytes(self, connection: Connection) -> None:
        """Whoever sends is not idle: its body may take long."""
        if (connection.network, connection) in self._idle:
            self._idle.add(connection.network, connection)

    def end(self, connection: Connection) -> None:
        if connection in self._busy:
            self._busy.discard(connection)
            self._idle.add(connection.network, connection)

    @contextmanager
    def hold_back(self, key: bytes, sharer: str) -> Iterator[bool]:
        """Hold an answer back during the context; yields False without a free place.

        Limits: half for callers without session (NO_KEY), a quarter for keys; of either a quarter for a sharer, such
        as all at one address.
        """
        most = self._max_count // (2 if key == NO_KEY else 4)
        limits: dict[Hashable, int] = {key == NO_KEY: most, sharer: max(1, most // OF_SHARER_PART)}
        if key != NO_KEY:
            limits[key] = HELD_BACK_OF_KEY_MAX_COUNT
        if any(self._held_back[each] >= limit for each, limit in limits.items()):
            yield False
            return
        self._held_back.update(limits.keys())
        try:
            yield True
        finally:
            self._held_back.subtract(limits.keys())
            for each in limits:
                if not self._held_back[each]:
                    del self._held_back[each]


class Connection(web.RequestHandler):
    """One caller's connection."""

    __slots__ = ("_socket", "_table", "network")

    def __init__(self, manager: web.Server, table: ConnectionTable, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(
            manager,
            loop=loop,
            logger=_silent,
            access_log=_silent,
            keepalive_timeout=IDLE_MAX_MS / 1000,
            lingering_time=LINGER_MAX_MS / 1000,
            auto_decompress=False,
        )
        self._table = table
        self._socket: Any = None
        self.network = ""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._socket = transport
        self.network = network_of(str((transport.get_extra_info("peername") or ("",))[0]))
        self._table.add(self)

    def data_received(self, data: bytes) -> None:
        self._table.note_bytes(self)
        super().data_received(data)

    def connection_lost(self, exc: BaseException | None) -> None:
        self._table.remove(self)
        super().connection_lost(exc)

    def handle_error(
        self, request: web.BaseRequest, status: int = 500, exc: BaseException | None = None, message: str | None = None
    ) -> web.StreamResponse:
        """Answer what reached no route; log only the kind of internal errors."""
        if status >= 500:
            _log.error("unexpected fault below the routes: %s", type(exc).__name__)
        return super().handle_error(request, status, exc, message)

    def abort(self) -> None:
        if self._socket is not None:
            self._socket.abort()

    def begin(self) -> None:
        self._table.begin(self)

    def end(self) -> None:
        self._table.end(self)

    def hold_back(self, key: bytes, sharer: str) -> AbstractContextManager[bool]:
        return self._table.hold_back(key, sharer)


@web.middleware
async def _keep_place(
    request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
) -> web.StreamResponse:
    connection = request.protocol
    if not isinstance(connection, Connection):
        return await handler(request)
    connection.begin()
    try:
        return await handler(request)
    finally:
        connection.end()


@contextmanager
def awaiting_body(request: web.BaseRequest) -> Iterator[None]:
    """Allow eviction while a body is awaited, so slow senders block nobody."""
    connection = request.protocol
    if not isinstance(connection, Connection):
        yield
        return
    connection.end()
    try:
        yield
    finally:
        connection.begin()


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches it. A name counts as another machine's, but for `localhost`."""
    if host == "localhost":
        return True
    try:
        return plain_address(host).is_loopback
    except ValueError:
        return False


def plain_address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """As IPv4 where a socket for both tells it as IPv6. Raises ValueError for a name."""
    address = ipaddress.ip_address(host)
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return mapped or address


def network_of(host: str) -> str:
    """The address, or of IPv6 its network: a machine there has 2^64 of them. Loopback and names stay what they are."""
    try:
        address = plain_address(host)
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv6Address) and not address.is_loopback:
        return str(ipaddress.IPv6Network((int(address), NETWORK_BITS), strict=False))
    return str(address)


def open_listener(host: str, port: int) -> socket.socket:
    """Return a listening TCP socket for `serve` or `accept_each`; `::` takes IPv4 too. Raises OSError."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    family, kind, protocol, _, address = found[0]
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        listener.bind(address)
        listener.listen(BACKLOG_COUNT)
    except OSError:
        listener.close()
        raise
    return listener


async def accept_each(listener: socket.socket, take: Callable[[socket.socket, str], Awaitable[None]]) -> None:
    loop = asyncio.get_running_loop()
    listener.setblocking(False)
    while True:
        try:
            accepted, address = await loop.sock_accept(listener)
        except OSError:  # no descriptor left, or the caller is gone already
            await asyncio.sleep(ACCEPT_PAUSE_MS / 1000)
            continue
        await take(accepted, address[0])
        await asyncio.sleep(0)


Accept = Callable[[Callable[[], asyncio.Protocol], socket.socket, str], Awaitable[None]]
"""Makes a connection of an accepted socket, whose other side has this address."""


async def accept_plain(make: Callable[[], asyncio.Protocol], accepted: socket.socket, _host: str) -> None:
    try:
        await asyncio.get_running_loop().connect_accepted_socket(make, accepted)
    except OSError:
        accepted.close()


@asynccontextmanager
async def serve(
    application: web.Application,
    listener: socket.socket,
    max_count: int,
    stop_ms: int,
    kind: Callable[[Any, ConnectionTable, asyncio.AbstractEventLoop], Connection] = Connection,
    accept: Accept = accept_plain,
) -> AsyncIterator[None]:
    """Serve at most `max_count` connections; on exit open requests get `stop_ms`."""
    application.middlewares.insert(0, _keep_place)
    runner = web.AppRunner(application, access_log=None, handle_signals=False, shutdown_timeout=stop_ms / 1000)
    await runner.setup()
    loop, table, manager = asyncio.get_running_loop(), ConnectionTable(max_count), _server_of(runner)

    take = partial(accept, lambda: kind(manager, table, loop))
    accepting = loop.create_task(accept_each(listener, take), name="accepting")
    try:
        yield
    finally:
        accepting.cancel()
        await asyncio.gather(accepting, return_exceptions=True)
        listener.close()
        await runner.cleanup()


def _server_of(runner: web.AppRunner) -> Any:
    if runner.server is None:
        raise RuntimeError("the runner was not set up")
    return runner.server

"""How clients' connections are held: refusals below the routes, and how many may be open. Must never show its insides.

What is no HTTP never reaches a route, so it is answered here, in the same form. Connections are bounded: one that
sends no request in time is closed, and when all places are taken, the one idle for longest makes room. Answers that are
held back have places of their own. So holding connections open costs a stranger his own.
"""

from __future__ import annotations

import asyncio
import logging
import resource
import socket
from collections import Counter, OrderedDict
from collections.abc import AsyncIterator, Iterator
from contextlib import AbstractContextManager, asynccontextmanager, contextmanager
from typing import Any

from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.problems import problem_response

IDLE_MAX_MS = 30_000
LINGER_MAX_MS = 2_000
CONNECTIONS_MAX_COUNT = 2048
HELD_BACK_OF_KEY_MAX_COUNT = 16
NO_KEY = b""
_DESCRIPTORS_DIVISOR = 2
_log = logging.getLogger("node.api")
_silent = logging.getLogger("node.api.requests")
_silent.setLevel(logging.CRITICAL)


def _connections_max_count() -> int:
    """Return how many connections may be open: never more than half of the process's file descriptors."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return CONNECTIONS_MAX_COUNT if soft < 0 else max(1, min(CONNECTIONS_MAX_COUNT, soft // _DESCRIPTORS_DIVISOR))


class ConnectionTable:
    """The open connections of one listener, idle and busy."""

    def __init__(self, max_count: int) -> None:
        self._max_count = max_count
        self._idle: OrderedDict[ApiConnection, None] = OrderedDict()
        self._busy: set[ApiConnection] = set()
        self._held_back: Counter[bytes] = Counter()

    def __len__(self) -> int:
        return len(self._idle) + len(self._busy)

    def add(self, connection: ApiConnection) -> None:
        """Take a new connection; if that is one too many, close the one that has been idle for longest."""
        self._idle[connection] = None
        if len(self) > self._max_count:
            oldest, _ = self._idle.popitem(last=False)
            oldest.abort()

    def remove(self, connection: ApiConnection) -> None:
        """Forget a closed connection."""
        self._idle.pop(connection, None)
        self._busy.discard(connection)

    def begin(self, connection: ApiConnection) -> None:
        """The connection has a request in hand: it is not closed to make room."""
        if connection in self._idle:
            del self._idle[connection]
            self._busy.add(connection)

    def end(self, connection: ApiConnection) -> None:
        """The request is answered."""
        if connection in self._busy:
            self._busy.discard(connection)
            self._idle[connection] = None

    @contextmanager
    def hold_back(self, key: bytes) -> Iterator[bool]:
        """Hold an answer back while the context lasts; yields False if there is no place for that.

        Half of the connections may wait for callers without a session (NO_KEY), a quarter for keys, few for each.
        """
        anonymous = self._held_back[NO_KEY]
        if key == NO_KEY:
            allowed = anonymous < self._max_count // 2
        else:
            keyed = self._held_back.total() - anonymous
            allowed = keyed < self._max_count // 4 and self._held_back[key] < HELD_BACK_OF_KEY_MAX_COUNT
        if not allowed:
            yield False
            return
        self._held_back[key] += 1
        try:
            yield True
        finally:
            self._held_back[key] -= 1
            if not self._held_back[key]:
                del self._held_back[key]


class ApiConnection(web.RequestHandler):
    """One client's connection."""

    __slots__ = ("_socket", "_table")

    def __init__(self, manager: web.Server, table: ConnectionTable, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(
            manager,
            loop=loop,
            access_log=_silent,
            keepalive_timeout=IDLE_MAX_MS / 1000,
            lingering_time=LINGER_MAX_MS / 1000,
            auto_decompress=False,
        )
        self._table = table
        self._socket: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a place in the table."""
        super().connection_made(transport)
        self._socket = transport
        self._table.add(self)

    def connection_lost(self, exc: BaseException | None) -> None:
        """Leave the table."""
        self._table.remove(self)
        super().connection_lost(exc)

    def abort(self) -> None:
        """Close at once."""
        if self._socket is not None:
            self._socket.abort()

    def begin(self) -> None:
        """A request is in hand."""
        self._table.begin(self)

    def end(self) -> None:
        """The request is answered."""
        self._table.end(self)

    def hold_back(self, key: bytes) -> AbstractContextManager[bool]:
        """See `ConnectionTable.hold_back`."""
        return self._table.hold_back(key)

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = 500,
        exc: BaseException | None = None,
        message: str | None = None,  # noqa: ARG002 - the parser's words quote what was sent
    ) -> web.StreamResponse:
        """Answer what is no HTTP, or a fault below the routes, as a problem document, and close.

        Raises ConnectionError where nobody is left to answer; aiohttp takes that quietly.
        """
        if isinstance(exc, ConnectionError):
            _log.debug("client gone: %s", type(exc).__name__)
            raise exc
        if request.writer.output_size > 0:
            raise ConnectionError("A part of an answer is sent already.")
        if status < 500:
            error = BlockRobotError("REQUEST_INVALID", "The request is not HTTP as this node speaks it, or too long.")
        else:
            _log.error("unexpected fault below the routes: %s", type(exc).__name__, exc_info=exc)
            error = BlockRobotError("INTERNAL")
        response = problem_response(error)
        name_server(response)
        response.force_close()
        return response


def name_server(response: web.StreamResponse) -> None:
    """Set the headers of every answer: no guessing of types, and no word on which software of which version."""
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Server"] = "blockrobot"


@asynccontextmanager
async def serve_api(application: web.Application, listener: socket.socket, stop_ms: int) -> AsyncIterator[None]:
    """Serve an application on a bound socket while the context lasts; then give open requests `stop_ms` to end."""
    runner = web.AppRunner(application, access_log=None, shutdown_timeout=stop_ms / 1000)
    await runner.setup()
    loop, manager, table = asyncio.get_running_loop(), _server_of(runner), ConnectionTable(_connections_max_count())
    try:
        server = await loop.create_server(lambda: ApiConnection(manager, table, loop), sock=listener, backlog=1024)
        try:
            yield
        finally:
            server.close()
    finally:
        await runner.cleanup()


def _server_of(runner: web.AppRunner) -> Any:
    if runner.server is None:
        raise RuntimeError("the runner was not set up")
    return runner.server


async def refuse_expectation(request: web.Request) -> web.StreamResponse | None:
    """Answer the header Expect: go on for 100-continue, refuse anything else."""
    if request.headers.get("Expect", "").lower() == "100-continue":
        await request.writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        request.writer.output_size = 0
        return None
    return problem_response(BlockRobotError("REQUEST_INVALID", "The node meets no expectation but 100-continue."))

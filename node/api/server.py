"""HTTP-level handling of API clients below the routes.

Malformed HTTP never reaches a route; connection limits are in `pages.listening`.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.problems import problem_response
from node.p2p.tls import TlsOverhead
from pages.listening import Accept, Connection, ConnectionTable, accept_plain, serve, share_of_descriptors

CONNECTIONS_MAX_COUNT = 2048
CONTINUE = "100-continue"


class Gate(Protocol):
    """What lets addresses pay for what is of no route. Both raise RATE_LIMITED."""

    async def admit_stray(self, request: web.BaseRequest) -> None:
        """An answer."""

    def pay_reading(self, host: str, cost_us: int) -> None:
        """Records of TLS beyond what they carry."""


GATE_KEY: web.AppKey[Gate] = web.AppKey("gate")
_DESCRIPTORS_PART = 2
_log = logging.getLogger("node.api")


class ApiConnection(Connection):
    """One client's connection. It ends when records of TLS with next to nothing in them use up its address's budget."""

    __slots__ = ("_gate", "_host", "_reading")

    def __init__(
        self,
        manager: web.Server,
        table: ConnectionTable,
        loop: asyncio.AbstractEventLoop,
        gate: Gate,
    ) -> None:
        super().__init__(manager, table, loop)
        self._gate = gate
        self._host = ""
        self._reading = TlsOverhead(None)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if transport.get_extra_info("ssl_object") is not None:
            self._host = transport.get_extra_info("peername")[0]
            self._reading = TlsOverhead(transport.get_extra_info("socket"))

    def data_received(self, data: bytes) -> None:
        cost_us = self._reading.cost_us(len(data))
        if cost_us > 0:
            try:
                self._gate.pay_reading(self._host, cost_us)
            except BlockRobotError:
                self.abort()
                return
        super().data_received(data)

    def _make_error_handler(self, err_info: Any) -> Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]:
        answer = super()._make_error_handler(err_info)

        async def handle(request: web.BaseRequest) -> web.StreamResponse:
            try:
                await self._gate.admit_stray(request)
            except BlockRobotError as error:
                return _last_answer(error)
            return await answer(request)

        return handle

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = 500,
        exc: BaseException | None = None,
        message: str | None = None,  # noqa: ARG002 - the parser's words quote what was sent
    ) -> web.StreamResponse:
        """Answer malformed HTTP or a low-level fault with a problem, then close.

        Raises ConnectionError if the client is gone; aiohttp handles that.
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
        return _last_answer(error)


def _last_answer(error: BlockRobotError) -> web.Response:
    response = problem_response(error)
    name_server(response)
    response.force_close()
    return response


def name_server(response: web.StreamResponse) -> None:
    """Set nosniff, and name no software or version."""
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Server"] = "blockrobot"


def serve_api(
    application: web.Application, listener: socket.socket, stop_ms: int, accept: Accept = accept_plain
) -> AbstractAsyncContextManager[None]:
    gate = application[GATE_KEY]
    return serve(
        application,
        listener,
        share_of_descriptors(CONNECTIONS_MAX_COUNT, _DESCRIPTORS_PART),
        stop_ms,
        lambda manager, table, loop: ApiConnection(manager, table, loop, gate),
        accept,
    )


async def meet_expectation(request: web.Request) -> web.StreamResponse | None:
    """Handle Expect: 100-continue; `require_expectation` refuses others later, charged."""
    if _expectation(request) == CONTINUE:
        await request.writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        request.writer.output_size = 0
    return None


def require_expectation(request: web.Request) -> None:
    """Raise REQUEST_INVALID for any Expect except 100-continue."""
    if _expectation(request) not in {"", CONTINUE}:
        raise BlockRobotError("REQUEST_INVALID", "The node meets no expectation but 100-continue.")


def _expectation(request: web.Request) -> str:
    return request.headers.get("Expect", "").lower()

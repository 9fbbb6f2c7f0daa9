"""How clients of the API are answered below its routes, in the same form. Must never show the node's insides.

What is no HTTP never reaches a route. How connections are bounded: `pages.listening`.
"""

from __future__ import annotations

import logging
import socket
from contextlib import AbstractAsyncContextManager

from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.problems import problem_response
from pages.listening import Connection, serve, share_of_descriptors

CONNECTIONS_MAX_COUNT = 2048
_DESCRIPTORS_PART = 2
_log = logging.getLogger("node.api")


class ApiConnection(Connection):
    """One client's connection."""

    __slots__ = ()

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


def serve_api(application: web.Application, listener: socket.socket, stop_ms: int) -> AbstractAsyncContextManager[None]:
    """Serve the API on a listener while the context lasts; see `pages.listening.serve`."""
    return serve(
        application, listener, share_of_descriptors(CONNECTIONS_MAX_COUNT, _DESCRIPTORS_PART), stop_ms, ApiConnection
    )


async def refuse_expectation(request: web.Request) -> web.StreamResponse | None:
    """Answer the header Expect: go on for 100-continue, refuse anything else."""
    if request.headers.get("Expect", "").lower() == "100-continue":
        await request.writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        request.writer.output_size = 0
        return None
    return problem_response(BlockRobotError("REQUEST_INVALID", "The node meets no expectation but 100-continue."))

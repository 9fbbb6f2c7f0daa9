"""A client that leaves in the middle of a request is nobody's fault: no line in the log, and the next one is answered."""

from __future__ import annotations

import logging
import socket

import pytest
from aiohttp import ClientSession, web

from node.api.server import GATE_KEY, serve_api
from tests.resetting import send_and_reset


async def read(request: web.Request) -> web.Response:
    return web.Response(body=await request.read())


class Open:
    """Anybody may."""

    async def admit_stray(self, request: web.BaseRequest) -> None:
        pass

    def pay_reading(self, host: str, cost_us: int) -> None:
        pass


async def test_a_client_that_resets_its_connection_writes_no_line(caplog: pytest.LogCaptureFixture) -> None:
    application = web.Application()
    application[GATE_KEY] = Open()
    application.router.add_post("/read", read)
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    async with serve_api(application, listener, 100):
        await send_and_reset(port, b"POST /read HTTP/1.1\r\nHost: localhost\r\n")
        assert [record.getMessage() for record in caplog.records if record.levelno >= logging.INFO] == []
        async with ClientSession() as session, session.post(f"http://127.0.0.1:{port}/read", data=b"abc") as answer:
            assert await answer.read() == b"abc"

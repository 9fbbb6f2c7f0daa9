"""The operator's listener: liveness, readiness, metrics, status, custody and faults; and one for other machines.

Loopback HTTP, local host names only (DNS rebinding), no web pages; the reading token opens `/metrics`, `/status`, the
operator's token all. What other machines may ask is liveness, readiness and, with the reading token, metrics.
"""

from __future__ import annotations

import hmac
import re
import socket
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

import structlog
from aiohttp import web

from consensus.errors import BlockRobotError
from node.config import READING_TOKEN_FILE_NAME
from node.custody.coordination.custody_admin import CustodyAdmin
from node.custody.coordination.custody_admin_routes import add_custody_routes
from node.faults import FaultSwitch
from pages.listening import Accept, awaiting_body, is_loopback, serve, share_of_descriptors
from pages.serving import is_client_gone

FAULT_REQUEST_MAX_BYTES = 64 * 1024
CONNECTIONS_MAX_COUNT = 32
_DESCRIPTORS_PART = 16
METRICS_CONNECTIONS_MAX_COUNT, _METRICS_DESCRIPTORS_PART = 16, 32
OPEN_PATHS = ("/livez", "/readyz")
"""What is answered without a token, and nothing else (see `docs/reference/authorisation.md`)."""
READING_PATHS = ("/status", "/metrics")
"""What is answered with the reading token too."""
_READING_TOKEN_WRONG = f"The token of {READING_TOKEN_FILE_NAME} is missing or wrong."
_HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
_PORT = re.compile(r":[0-9]{1,5}$", re.ASCII)
METRICS_CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

log = structlog.get_logger(__name__)


class NodeStatus(Protocol):
    """Status shown on the operator's listener; holds no secrets."""

    def is_ready(self) -> bool: ...

    def problem(self) -> BlockRobotError | None: ...

    def describe(self) -> Mapping[str, Any]: ...

    def metrics(self) -> bytes: ...


def create_operator_listener(
    status: NodeStatus,
    faults: FaultSwitch | None = None,
    token: str = "",
    custody_admin: CustodyAdmin | None = None,
    *,
    reading_token: str = "",
) -> web.Application:
    """Return the operator's application; without switch and token it takes no faults."""

    async def describe(request: web.Request) -> web.Response:
        _require_token(request, token, reading_token)
        return web.json_response(dict(status.describe()))

    async def take_faults(request: web.Request) -> web.Response:
        try:
            switch = _require_operator(request, faults, token)
            if request.method == "GET":
                return web.json_response(switch.describe())
            with awaiting_body(request):
                content = await request.read()
            state = switch.request(content)
            log.warning("faults_changed", **state)
            return web.json_response(state)
        except BlockRobotError as error:
            return _problem(error)

    application = web.Application(client_max_size=FAULT_REQUEST_MAX_BYTES, middlewares=[_guard])
    add_custody_routes(application, custody_admin, lambda request: _require_token(request, token))
    application.router.add_get("/faults", take_faults)
    application.router.add_post("/faults", take_faults)
    _add_probes(application, status, custody_admin, lambda request: _require_token(request, token, reading_token))
    application.router.add_get("/status", describe)
    return application


def create_metrics_listener(
    status: NodeStatus, custody_admin: CustodyAdmin | None, *, reading_token: str
) -> web.Application:
    """Return what other machines may ask: an orchestrator for its probes, Prometheus for the figures."""
    application = web.Application(middlewares=[_guard_pages])
    _add_probes(
        application,
        status,
        custody_admin,
        lambda request: _require_shown(request, reading_token, detail=_READING_TOKEN_WRONG),
    )
    return application


def _add_probes(
    application: web.Application,
    status: NodeStatus,
    custody_admin: CustodyAdmin | None,
    require: Callable[[web.Request], None],
) -> None:
    """`require` raises for whoever may not read metrics."""

    async def live(_request: web.Request) -> web.Response:
        return web.json_response({"alive": True})

    async def ready(_request: web.Request) -> web.Response:
        if status.is_ready():
            return web.json_response({"ready": True})
        error = status.problem() or BlockRobotError("NODE_NOT_READY")
        problem = {"ready": False, "code": error.code, "detail": error.detail, "next_step": error.next_step}
        return web.json_response(problem, status=error.entry.status)

    async def metrics(request: web.Request) -> web.Response:
        require(request)
        uploads = b"" if custody_admin is None else await custody_admin.metrics()
        return web.Response(body=status.metrics() + uploads, headers={"Content-Type": METRICS_CONTENT_TYPE})

    application.router.add_get("/livez", live)
    application.router.add_get("/readyz", ready)
    application.router.add_get("/metrics", metrics)


def serve_operator(
    application: web.Application, listener: socket.socket, stop_ms: int
) -> AbstractAsyncContextManager[None]:
    """Serve while the context lasts, with few connections: any local user can connect."""
    places = share_of_descriptors(CONNECTIONS_MAX_COUNT, _DESCRIPTORS_PART)
    return serve(application, listener, places, stop_ms)


def serve_metrics(
    application: web.Application, listener: socket.socket, stop_ms: int, accept: Accept
) -> AbstractAsyncContextManager[None]:
    """As `serve_operator`, for whoever reaches it from elsewhere."""
    places = share_of_descriptors(METRICS_CONNECTIONS_MAX_COUNT, _METRICS_DESCRIPTORS_PART)
    return serve(application, listener, places, stop_ms, accept=accept)


def _problem(error: BlockRobotError) -> web.Response:
    problem = {"code": error.code, "detail": error.detail, "next_step": error.next_step}
    return web.json_response(problem, status=error.entry.status)


@web.middleware
async def _guard(
    request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
) -> web.StreamResponse:
    """Reject foreign host names, and as `_guard_pages`."""
    if _PORT.sub("", request.headers.get("Host", "")).lower() not in _HOSTS:
        return _problem(BlockRobotError("NOT_PERMITTED", "This is for a program of this machine, not for a web page."))
    answered: web.StreamResponse = await _guard_pages(request, handler)
    return answered


@web.middleware
async def _guard_pages(
    request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
) -> web.StreamResponse:
    """Reject web pages; ignore client disconnects."""
    try:
        if "Origin" in request.headers:
            raise BlockRobotError("NOT_PERMITTED", "This is for programs, not for a web page.")
        return await handler(request)
    except BlockRobotError as error:
        return _problem(error)
    except ConnectionError as error:
        if not is_client_gone(request, error):
            raise
        return web.Response()


def _require_operator(request: web.Request, faults: FaultSwitch | None, token: str) -> FaultSwitch:
    """Raises FAULTS_DISABLED, NOT_PERMITTED, OPERATOR_TOKEN_INVALID."""
    if faults is None or not token:
        raise BlockRobotError("FAULTS_DISABLED")
    _require_token(request, token)
    return faults


def _require_token(request: web.Request, *tokens: str) -> None:
    """Raises NOT_PERMITTED (not local, or a web page), OPERATOR_TOKEN_INVALID."""
    if not is_loopback(request.remote or "") or "Origin" in request.headers:
        raise BlockRobotError("NOT_PERMITTED", "This is for a program of this machine, not for a web page.")
    _require_shown(request, *tokens)


def _require_shown(request: web.Request, *tokens: str, detail: str = "") -> None:
    """Raises OPERATOR_TOKEN_INVALID."""
    shown = request.headers.get("Authorization", "").encode("utf-8", "replace")
    if not any(token and hmac.compare_digest(shown, f"Bearer {token}".encode()) for token in tokens):
        raise BlockRobotError("OPERATOR_TOKEN_INVALID", detail)

"""The operator's listener: is the node alive, ready, how is it doing. Must never be reachable but from this machine.

`/livez`, `/readyz`, `/metrics`, `/status`, in plain HTTP on a loopback port of its own; for whoever holds the operator's
token also `/custody` of a custodian, and `/faults`, where node.toml allows faults.
"""

from __future__ import annotations

import hmac
from ipaddress import ip_address

import structlog
from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.services import NodeStatus
from node.faults import FaultSwitch
from node.upkeep import Upkeep
from node.upkeep_routes import add_custody_routes

FAULT_REQUEST_MAX_BYTES = 64 * 1024
OPEN_PATHS = ("/livez", "/readyz", "/status", "/metrics")
"""What is answered without the operator's token, and nothing else (see `docs/reference/authorisation.md`)."""
METRICS_CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

log = structlog.get_logger(__name__)


def create_operator_listener(
    status: NodeStatus, faults: FaultSwitch | None = None, token: str = "", upkeep: Upkeep | None = None
) -> web.Application:
    """Return the application that answers the operator. Without a switch and a token it takes no faults."""

    async def live(_request: web.Request) -> web.Response:
        return web.json_response({"alive": True})

    async def ready(_request: web.Request) -> web.Response:
        if status.is_ready():
            return web.json_response({"ready": True})
        error = status.problem() or BlockRobotError("NODE_NOT_READY")
        problem = {"ready": False, "code": error.code, "detail": error.detail, "next_step": error.next_step}
        return web.json_response(problem, status=error.entry.status)

    async def describe(_request: web.Request) -> web.Response:
        return web.json_response(dict(status.describe()))

    async def metrics(_request: web.Request) -> web.Response:
        return web.Response(body=status.metrics(), headers={"Content-Type": METRICS_CONTENT_TYPE})

    async def take_faults(request: web.Request) -> web.Response:
        try:
            switch = _require_operator(request, faults, token)
            if request.method == "GET":
                return web.json_response(switch.describe())
            state = switch.request(await request.read())
            log.warning("faults_changed", **state)
            return web.json_response(state)
        except BlockRobotError as error:
            problem = {"code": error.code, "detail": error.detail, "next_step": error.next_step}
            return web.json_response(problem, status=error.entry.status)

    application = web.Application(client_max_size=FAULT_REQUEST_MAX_BYTES)
    add_custody_routes(application, upkeep, lambda request: _require_token(request, token))
    application.router.add_get("/faults", take_faults)
    application.router.add_post("/faults", take_faults)
    application.router.add_get("/livez", live)
    application.router.add_get("/readyz", ready)
    application.router.add_get("/status", describe)
    application.router.add_get("/metrics", metrics)
    return application


def _require_operator(request: web.Request, faults: FaultSwitch | None, token: str) -> FaultSwitch:
    """Return the switch to who may use it: a program of this machine, no web page, with the token.

    Raises FAULTS_DISABLED, NOT_PERMITTED, OPERATOR_TOKEN_INVALID.
    """
    if faults is None or not token:
        raise BlockRobotError("FAULTS_DISABLED")
    _require_token(request, token)
    return faults


def _require_token(request: web.Request, token: str) -> None:
    """Let a program of this machine pass that shows the token, and no web page.

    Raises NOT_PERMITTED, OPERATOR_TOKEN_INVALID.
    """
    if not ip_address(request.remote or "0.0.0.0").is_loopback or "Origin" in request.headers:  # noqa: S104
        raise BlockRobotError("NOT_PERMITTED", "This is for a program of this machine, not for a web page.")
    shown = request.headers.get("Authorization", "").encode("utf-8", "replace")
    if not token or not hmac.compare_digest(shown, f"Bearer {token}".encode()):
        raise BlockRobotError("OPERATOR_TOKEN_INVALID")

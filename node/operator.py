"""The operator's listener: is the node alive, ready, how is it doing. Must never be reachable but from this machine.

`/livez`, `/readyz`, `/metrics`, `/status`, in plain HTTP on a loopback port of its own.
"""

from __future__ import annotations

from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.services import NodeStatus

METRICS_CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


def create_operator_listener(status: NodeStatus) -> web.Application:
    """Return the application that answers the operator."""

    async def live(_request: web.Request) -> web.Response:
        return web.json_response({"alive": True})

    async def ready(_request: web.Request) -> web.Response:
        if status.is_ready():
            return web.json_response({"ready": True})
        error = BlockRobotError("NODE_NOT_READY")
        problem = {"ready": False, "code": error.code, "detail": error.detail, "next_step": error.next_step}
        return web.json_response(problem, status=error.entry.status)

    async def describe(_request: web.Request) -> web.Response:
        return web.json_response(dict(status.describe()))

    async def metrics(_request: web.Request) -> web.Response:
        return web.Response(body=status.metrics(), headers={"Content-Type": METRICS_CONTENT_TYPE})

    application = web.Application()
    application.router.add_get("/livez", live)
    application.router.add_get("/readyz", ready)
    application.router.add_get("/status", describe)
    application.router.add_get("/metrics", metrics)
    return application

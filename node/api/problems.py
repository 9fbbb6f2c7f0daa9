"""Errors as problem documents (RFC 9457)."""

from __future__ import annotations

import json
import logging

import msgspec
from aiohttp import web

from consensus.api_documents import Problem
from consensus.errors import BlockRobotError

PROBLEM_TYPE = "application/problem+json"
_log = logging.getLogger("node.api")

_BY_STATUS = {
    404: "ROUTE_UNKNOWN",
    405: "METHOD_NOT_ALLOWED",
    413: "REQUEST_TOO_LARGE",
}


def problem_document(error: BlockRobotError) -> Problem:
    entry = error.entry
    return Problem(
        type=f"urn:blockrobot:error:{error.code}",
        title=entry.meaning,
        status=entry.status,
        code=error.code,
        detail=error.detail,
        next_step=entry.next_step,
        retryable=entry.retryable,
    )


def problem_response(error: BlockRobotError) -> web.Response:
    document = msgspec.structs.asdict(problem_document(error))  # a detail may hold what is no UTF-8
    headers = {"Cache-Control": "no-store"}
    if error.entry.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    if error.entry.status in {429, 503}:
        headers["Retry-After"] = str(error.context.get("retry_after_s", 1))
    return web.Response(
        status=error.entry.status, body=json.dumps(document).encode(), content_type=PROBLEM_TYPE, headers=headers
    )


def problem_from_http(error: web.HTTPException) -> web.Response:
    code = _BY_STATUS.get(error.status, "REQUEST_INVALID" if error.status < 500 else "INTERNAL")
    response = problem_response(BlockRobotError(code))
    if error.status == 405 and "Allow" in error.headers:
        response.headers["Allow"] = error.headers["Allow"]
    return response


def problem_from_fault(error: Exception, route: str) -> web.Response:
    """Log an unforeseen exception and return INTERNAL without details."""
    _log.error("unexpected fault in %s: %s", route, type(error).__name__, exc_info=error)
    return problem_response(BlockRobotError("INTERNAL"))

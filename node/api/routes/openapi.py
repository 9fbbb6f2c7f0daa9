"""GET /v1/openapi.json: the interface described by itself."""

from __future__ import annotations

from aiohttp import web

from node.api.access.route_access import ANYONE
from node.api.routing import JSON, Answer, Call, Route, bytes_answer

DOCUMENT_KEY = web.AppKey("openapi_document", bytes)


async def _get_openapi(call: Call) -> web.StreamResponse:
    return bytes_answer(call.http.config_dict[DOCUMENT_KEY], JSON)


ROUTES = (
    Route(
        "GET",
        "/v1/openapi.json",
        "getOpenApi",
        "This interface as an OpenAPI 3.1 document.",
        ANYONE,
        _get_openapi,
        Answer(JSON, None, "The document."),
    ),
)

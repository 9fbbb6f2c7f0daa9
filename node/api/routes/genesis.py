"""GET /v1/genesis: the file that a client must trust."""

from __future__ import annotations

from aiohttp import web

from node.api.access.route_access import ANYONE
from node.api.routing import JSON, Answer, Call, Route, bytes_answer

GENESIS_KEY = web.AppKey("genesis", bytes)


async def _get_genesis(call: Call) -> web.StreamResponse:
    return bytes_answer(call.http.config_dict[GENESIS_KEY], JSON)


ROUTES = (
    Route(
        "GET",
        "/v1/genesis",
        "getGenesis",
        "The genesis file. Compare it with the one from your organisation before you trust it.",
        ANYONE,
        _get_genesis,
        Answer(JSON, None, "The genesis file."),
    ),
)

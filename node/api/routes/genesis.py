"""GET /v1/genesis: the file that a client must trust. Must never hold anything that only members may see."""

from __future__ import annotations

from aiohttp import web

from consensus.genesis import genesis_to_json
from node.api.access import ANYONE
from node.api.routing import JSON, Answer, Call, Route


async def _get_genesis(call: Call) -> web.StreamResponse:
    return web.Response(text=genesis_to_json(call.services.genesis), content_type=JSON)


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

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from consensus.chain.session_message import sign_session
from consensus.primitives.keys import PrivateKey
from node.api import create_api
from node.api.openapi.openapi_document import errors_of
from node.api.routes import ROUTES
from tests.unit.node.api.small_network import SmallLedger, SmallNode

Api = TestClient[web.Request, web.Application]
OpenSession = Callable[..., Awaitable[dict[str, str]]]


@pytest.fixture
async def node() -> SmallNode:
    return SmallNode.around(await SmallLedger().start())


@pytest.fixture
async def api(node: SmallNode) -> AsyncIterator[Api]:
    """A client of the node; no route may refuse it with a code that its description does not name."""
    undeclared = []

    async def note(request: web.Request, response: web.StreamResponse) -> None:
        place = request.match_info.route.resource
        routes = [each for each in ROUTES if place and (each.method, each.path) == (request.method, place.canonical)]
        if isinstance(response, web.Response) and isinstance(response.body, bytes) and response.status >= 400:
            code = json.loads(response.body)["code"]
            undeclared.extend((each.operation, code) for each in routes if code not in errors_of(each))

    application = create_api(node.services)
    application.on_response_prepare.append(note)
    async with TestClient(TestServer(application)) as client:
        yield client
    assert undeclared == []


@pytest.fixture
def open_session(node: SmallNode, api: Api) -> OpenSession:
    """Open a session for a key; return the headers of a request in it."""

    async def open_for(key: PrivateKey, grant_id: bytes = b"") -> dict[str, str]:
        public_key = key.public_key.hex()
        answer = await api.post("/v1/session-challenges", json={"public_key": public_key})
        challenge = (await answer.json())["challenge"]
        signature = sign_session(key, node.ledger.genesis.chain_id, "n0", bytes.fromhex(challenge))
        document = {"public_key": public_key, "challenge": challenge, "signature": signature.hex()}
        if grant_id:
            document["grant"] = grant_id.hex()
        answer = await api.post("/v1/sessions", json=document)
        assert answer.status == 200, await answer.text()
        return {"Authorization": f"Bearer {(await answer.json())['token']}"}

    return open_for

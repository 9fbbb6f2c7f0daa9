from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer

from clients.sdk.network_client import NetworkClient
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from node.api import create_api
from tests.unit.node.api.small_network import SUBJECT, ManualClock, SmallLedger, SmallNode

DEAD_URL = "http://127.0.0.1:9"


@dataclass
class Seen:
    """What a node sees of its callers: the port of the connection, the route, whether there was a session."""

    port: int
    path: str
    token: str | None
    cookies: bool


@dataclass
class RunningNode:
    node: SmallNode
    server: TestServer
    seen: list[Seen] = field(default_factory=list)

    @property
    def url(self) -> str:
        return str(self.server.make_url(""))


class TwoNodes:
    """Two nodes of one network, n0 and n1; each may stand on a ledger of its own."""

    def __init__(self) -> None:
        self.running: dict[str, RunningNode] = {}
        self.clients: list[NetworkClient] = []

    async def add(self, name: str, ledger: SmallLedger) -> RunningNode:
        node = SmallNode.around(ledger, name)
        api = create_api(node.services)
        running = RunningNode(node, TestServer(api))

        @web.middleware
        async def watch(request: web.Request, handler: object) -> web.StreamResponse:
            peer = request.transport.get_extra_info("peername") if request.transport else ("", 0)
            token = request.headers.get("Authorization")
            running.seen.append(Seen(peer[1], request.path, token, "Cookie" in request.headers))
            return await handler(request)  # type: ignore[operator, no-any-return]

        api.middlewares.insert(0, watch)
        await running.server.start_server()
        self.running[name] = running
        return running

    @property
    def urls(self) -> dict[str, str]:
        return {name: running.url for name, running in self.running.items()}

    def __getitem__(self, name: str) -> RunningNode:
        return self.running[name]

    def client(self, *, pinned: bytes | None = None, urls: dict[str, str] | None = None) -> NetworkClient:
        """A client with a clock of its own."""
        genesis = next(iter(self.running.values())).node.ledger.genesis
        client = NetworkClient(genesis, urls or self.urls, pinned=pinned, clock=ManualClock())
        self.clients.append(client)
        return client

    async def close(self) -> None:
        for client in self.clients:
            await client.close()
        for running in self.running.values():
            await running.server.close()


@pytest.fixture
async def nodes() -> AsyncIterator[TwoNodes]:
    """Two nodes on one ledger."""
    network = TwoNodes()
    ledger = await SmallLedger().start()
    await network.add("n0", ledger)
    await network.add("n1", ledger)
    yield network
    await network.close()


def make_transaction(client: NetworkClient) -> Transaction:
    return client.transactions.build(SUBJECT, "access", "request", [[], "care"])


async def refusal_of(work: Any) -> str:
    with pytest.raises(BlockRobotError) as refusal:
        await work
    return refusal.value.code

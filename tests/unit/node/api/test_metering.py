"""No route answers work that was not charged: whatever a request turns out to take goes on its source's budget."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest
from aiohttp import ClientSession, web
from aiohttp.test_utils import TestClient, TestServer

from consensus.chain.block import ContractEvent, Receipt
from consensus.chain.session_message import sign_session
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode, encode_value
from consensus.primitives.hashing import sha256
from network.bench.flood.flood_routes import CostlyTargets, make_read, read_kinds
from node.api import create_api
from node.api.access import request_rate_limiter
from node.api.access.metering import SLICE_US, Steps
from node.api.access.route_access import ANYONE
from node.api.routes import ROUTES
from node.api.routing import Call, Route
from node.api.server import serve_api
from node.limits.token_buckets import Allowance
from node.limits.work_costs import ROUTE_COSTS, STRAY_US
from node.storage.ledger_view import LedgerView
from tests.unit.node.api.small_network import SUBJECT, SmallLedger, SmallNode

DEAR_US = 30_000
ONE_DEAR = Allowance(us_per_s=1, burst_us=max(ROUTE_COSTS.values()) + DEAR_US // 2)
"""Enough to begin any request, and not enough for one that takes DEAR_US to begin after it."""
Named = list[str]


def burn(us: float) -> None:
    """Take so much CPU time."""
    until_ns = time.thread_time_ns() + us * 1_000
    while time.thread_time_ns() < until_ns:
        pass


async def on_the_loop(_call: Call) -> web.StreamResponse:
    burn(DEAR_US)
    return web.Response()


async def after_a_while(_call: Call) -> web.StreamResponse:
    for _ in range(3):
        burn(DEAR_US / 3)
        await asyncio.sleep(0)
    raise BlockRobotError("NOT_FOUND")


async def in_the_readers_thread(call: Call) -> web.StreamResponse:
    def work(_snapshot: LedgerView) -> Steps[None]:
        for _ in range(60):
            burn(DEAR_US / 60)
            yield

    await call.read(work)
    return web.Response()


@pytest.fixture
def named() -> Named:
    return []


@pytest.fixture
def is_named() -> asyncio.Event:
    return asyncio.Event()


@pytest.fixture
async def node(named: Named, is_named: asyncio.Event) -> SmallNode:
    node = SmallNode.around(await SmallLedger().start())

    def note(who: str, _error: BlockRobotError) -> None:
        named.append(who)
        is_named.set()

    return replace(node, services=replace(node.services, on_over_budget=note))


@pytest.fixture
def serve(node: SmallNode) -> Callable[..., TestClient[web.Request, web.Application]]:
    return lambda *routes: TestClient(TestServer(create_api(node.services, routes or ROUTES)))


def path_of(route: Route) -> str:
    return "".join("0" + part.partition("}")[2] if "}" in part else part for part in route.path.split("{"))


@pytest.mark.parametrize("handler", [on_the_loop, after_a_while, in_the_readers_thread])
@pytest.mark.parametrize("route", ROUTES, ids=lambda route: route.operation)
async def test_every_route_pays_for_what_its_answer_turns_out_to_take(
    route: Route,
    handler: Callable[[Call], Awaitable[web.StreamResponse]],
    serve: Any,
    named: Named,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", ONE_DEAR)
    monkeypatch.setattr(request_rate_limiter, "REFUSAL_DELAY_S", 0)
    async with serve(replace(route, access=ANYONE, handler=handler)) as api:
        first = await api.request(route.method, path_of(route))
        assert first.status in {200, 404}
        second = await api.request(route.method, path_of(route))
    assert second.status == 429
    assert named == ["loopback 127.0.0.1"]


@pytest.mark.parametrize("handler", [on_the_loop, in_the_readers_thread])
async def test_what_is_asked_all_at_once_is_not_all_begun_for_its_price(
    handler: Any, serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", ONE_DEAR)
    monkeypatch.setattr(request_rate_limiter, "REFUSAL_DELAY_S", 0)
    route = next(route for route in ROUTES if route.operation == "getGenesis")
    async with serve(replace(route, handler=handler)) as api:
        answers = await asyncio.gather(*(api.get(route.path) for _ in range(16)))
    served = [answer.status for answer in answers].count(200)
    assert 1 <= served <= 2


async def test_a_reading_lets_the_loop_go_on(serve: Any) -> None:
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    route = next(route for route in ROUTES if route.operation == "getGenesis")
    async with serve(replace(route, handler=in_the_readers_thread)) as api:
        counting = asyncio.create_task(count())
        answer = await api.get(route.path)
        counting.cancel()
    assert answer.status == 200
    assert turns > DEAR_US / SLICE_US / 4


async def test_a_client_that_goes_while_its_answer_is_read_leaves_no_snapshot_open(node: SmallNode) -> None:
    begun, closed = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()

    def work(_snapshot: LedgerView) -> Steps[None]:
        try:
            while True:
                loop.call_soon_threadsafe(begun.set)
                yield
        finally:
            loop.call_soon_threadsafe(closed.set)

    async def endless(call: Call) -> web.StreamResponse:
        await call.read(work)
        return web.Response()

    route = next(route for route in ROUTES if route.operation == "getGenesis")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        api = create_api(node.services, (replace(route, handler=endless),))
        async with serve_api(api, listener, 10), asyncio.timeout(10):
            _, writer = await asyncio.open_connection(*listener.getsockname())
            writer.write(b"GET /v1/genesis HTTP/1.1\r\nHost: node\r\n\r\n")
            await begun.wait()
            writer.close()
        await asyncio.wait_for(closed.wait(), 10)


async def stray_asks(api: Any, count: int, method: str, path: str, headers: dict[str, str]) -> list[int]:
    return [(await api.request(method, path, headers=headers)).status for _ in range(count)]


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/nowhere", {}, 404),
        ("GET", "/nowhere", {"Expect": "wonders"}, 400),
        ("GET", "/v1/genesis/", {}, 404),
        ("DELETE", "/v1/genesis", {}, 405),
        ("OPTIONS", "/v1/genesis", {}, 405),
        ("POST", "/v1/clips/00", {}, 405),
        ("GET", "/v1/genesis", {"Expect": "wonders"}, 400),
        ("GET", "/explorer/nothing.js", {}, 404),
        ("GET", "/explorer/index.html", {}, 200),
    ],
)
async def test_what_is_of_no_route_is_paid_and_its_sender_is_named(
    method: str,
    path: str,
    headers: dict[str, str],
    status: int,
    serve: Any,
    named: Named,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", Allowance(1, 2 * STRAY_US + 100))
    monkeypatch.setattr(request_rate_limiter, "REFUSAL_DELAY_S", 0)
    async with serve() as api:
        assert (await stray_asks(api, 4, method, path, headers))[0] == status
        assert await stray_asks(api, 1, method, path, headers) == [429]
    assert set(named) == {"loopback 127.0.0.1"}


async def test_what_is_no_http_is_paid_and_its_sender_is_named(
    node: SmallNode, named: Named, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", Allowance(1, 2 * STRAY_US))
    monkeypatch.setattr(request_rate_limiter, "REFUSAL_DELAY_S", 0)

    async def ask(place: tuple[str, int]) -> bytes:
        reader, writer = await asyncio.open_connection(*place)
        writer.write(b"WHAT\r\n\r\n")
        answer = await reader.read()
        writer.close()
        return answer.split(b" ")[1]

    with socket.create_server(("127.0.0.1", 0)) as listener:
        async with serve_api(create_api(node.services), listener, 10), asyncio.timeout(10):
            answers = [await ask(listener.getsockname()) for _ in range(4)]
    assert answers == [b"400", b"400", b"429", b"429"]
    assert named == ["loopback 127.0.0.1"] * 2


@pytest.fixture
async def served(node: SmallNode) -> AsyncIterator[ClientSession]:
    """The API with a session of a member."""
    async with TestClient(TestServer(create_api(node.services))) as api:
        public_key = SUBJECT.public_key.hex()
        asked = await api.post("/v1/session-challenges", json={"public_key": public_key})
        challenge = (await asked.json())["challenge"]
        signature = sign_session(SUBJECT, node.ledger.genesis.chain_id, "n0", bytes.fromhex(challenge)).hex()
        document = {"public_key": public_key, "challenge": challenge, "signature": signature}
        token = (await (await api.post("/v1/sessions", json=document)).json())["token"]
        async with ClientSession(api.make_url("/"), headers={"Authorization": f"Bearer {token}"}) as session:
            yield session


async def test_a_stream_pays_for_what_it_carries_and_waits_where_it_cannot(
    node: SmallNode, served: ClientSession, named: Named, is_named: asyncio.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stream from the beginning is opened for one price; then its session can ask nothing more."""
    monkeypatch.setattr(
        request_rate_limiter, "SESSION_ALLOWANCE", Allowance(us_per_s=1, burst_us=ROUTE_COSTS["streamEvents"] + 500)
    )
    monkeypatch.setattr(request_rate_limiter, "REFUSAL_DELAY_S", 0)
    events = tuple(
        ContractEvent(contract="records", name="one", data=encode_value({"n": bytes(500)})) for _ in range(50)
    )
    for number in range(200):
        receipt = Receipt(
            txid=number.to_bytes(32), ok=True, code="OK", message="", line=None, gas_used=1, events=events
        )
        await node.ledger.extend(receipts=(receipt,))
    async with asyncio.timeout(20), served.get("/v1/events?cursor=0:0") as stream:
        assert stream.status == 200
        await stream.content.readuntil(b"\n\n")
        await is_named.wait()
        assert set(named) == {f"session {SUBJECT.public_key.hex()}"}
        assert stream.content.total_bytes < 200 * 50 * 500, "the rest waits"
        async with served.get("/v1/finality") as refused:
            assert refused.status == 429


@pytest.mark.parametrize("kind", read_kinds())
async def test_what_the_flood_bench_asks_is_understood(kind: str, node: SmallNode, served: ClientSession) -> None:
    header = await node.ledger.extend()
    block_id = sha256(encode(header)).hex()
    flood = make_read(kind, CostlyTargets(window=1, height=1, txid="00" * 32, block_id=block_id))
    async with served.request(flood.method, flood.path) as answer:
        understood = answer.status in {200, 304, 308} or (await answer.json(content_type=None))["code"] in {
            "NOT_FOUND",
            "NOT_PERMITTED",
            "CONTRACT_NOT_FOUND",
        }
        assert understood
        assert flood.streams == (answer.content_type == "text/event-stream")

"""The aiohttp application of a node's HTTP interface.

Failures become problem documents; logs name routes, never addresses, which hold ids.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager

from aiohttp import web

from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from node.api.access.metering import Meter, Metered, Readings
from node.api.access.request_rate_limiter import (
    ChargedBudgets,
    FairQueue,
    RefusalDelay,
    RequestRateLimiter,
    is_over_budget,
    source_of,
)
from node.api.access.route_access import Access
from node.api.access.sessions import Session, SessionTable, read_token
from node.api.bodies import Bodies
from node.api.openapi.openapi_document import build_openapi
from node.api.ports import ApiServices
from node.api.problems import problem_from_fault, problem_from_http, problem_response
from node.api.routes import ROUTES
from node.api.routes.genesis import GENESIS_KEY
from node.api.routes.openapi import DOCUMENT_KEY
from node.api.routing import Call, Route
from node.api.server import GATE_KEY, meet_expectation, name_server, require_expectation
from node.limits.work_costs import ROUTE_COSTS, STRAY_US, bytes_cost_us

OPEN_REQUESTS_MAX_COUNT = 4096
_log = logging.getLogger("node.api")
_WebHandler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def require_rules(routes: Iterable[Route]) -> None:
    """Raise CONFIGURATION_INVALID for a route without rule or a duplicate."""
    seen: set[str] = set()
    for route in routes:
        if not isinstance(route.access, Access):
            raise BlockRobotError("CONFIGURATION_INVALID", f"The route {route.method} {route.path} has no access rule.")
        for name in (f"{route.method} {route.path}", route.operation):
            if name in seen:
                raise BlockRobotError("CONFIGURATION_INVALID", f"{name} stands twice in the route table.")
            seen.add(name)


class _Gate:
    def __init__(self, services: ApiServices) -> None:
        self._services = services
        self._limiter = RequestRateLimiter(services.on_over_budget)
        self._sessions = SessionTable(services.genesis.chain_id, services.node_name, services.clock, services.ledger)
        self._turns = FairQueue(services.on_over_budget)
        self._bodies = Bodies(services.on_over_budget)
        self._refusals = RefusalDelay()
        self._readings = Readings(services.ledger)
        self._open_count = 0

    def _session_of(self, request: web.Request) -> Session | None:
        token = read_token(request)
        return None if token is None else self._sessions.resolve(token)

    def _session_if_any(self, route: Route, request: web.Request) -> Session | None:
        try:
            session = self._session_of(request)
            route.access.check(session)
        except BlockRobotError:
            return None
        return session

    def _authorise(self, route: Route, request: web.Request) -> tuple[Session | None, ChargedBudgets]:
        address = self._services.trusted_proxies.address_of(request)
        stranger = source_of(address, None)
        cost_us = ROUTE_COSTS[route.operation]
        try:
            if route.access.asks_session(is_public=self._services.public_explorer):
                session = self._session_of(request)
                route.access.check(session)
            else:
                session = self._session_if_any(route, request)
        except BlockRobotError:
            self._limiter.take(stranger, cost_us)
            raise
        source = stranger if session is None else source_of(address, session)
        return session, self._limiter.take(source, cost_us)

    async def run(self, route: Route, request: web.Request) -> web.StreamResponse:
        meter = Meter()
        async with self._open():
            response = await Metered(self._call(route, request, meter), meter)
        if isinstance(response, web.Response) and isinstance(response.body, bytes):
            meter.add(bytes_cost_us(len(response.body)))
        return response

    async def _call(self, route: Route, request: web.Request, meter: Meter) -> web.StreamResponse:
        session, tab = self._authorise(route, request)
        cost_us = ROUTE_COSTS[route.operation]
        meter.pay_by(tab, cost_us)
        require_expectation(request)
        await self._turns.wait(tab.source, cost_us)
        tab.require()  # what was begun before it may have cost more than its price
        with self._bodies.of(tab.source) as hold:
            return await route.handler(
                Call(self._services, self._sessions, request, route, session, tab, hold, meter, self._readings)
            )

    async def admit_stray(self, request: web.BaseRequest) -> None:
        """Raises RATE_LIMITED."""
        async with self._open():
            source = source_of(self._services.trusted_proxies.address_of(request), None)
            self._limiter.take(source, STRAY_US)
            await self._turns.wait(source, STRAY_US)

    def pay_reading(self, host: str, cost_us: int) -> None:
        """A proxy pays nothing: it would for all behind it. Raises RATE_LIMITED."""
        if not self._services.trusted_proxies.trusts(host):
            self._limiter.take(source_of(host, None), cost_us)

    @asynccontextmanager
    async def _open(self) -> AsyncIterator[None]:
        if self._open_count >= OPEN_REQUESTS_MAX_COUNT:
            raise BlockRobotError("RATE_LIMITED", "The node has as many open requests as it takes.")
        self._open_count += 1
        try:
            yield
        except BlockRobotError as error:
            if is_over_budget(error):
                await self._refusals.wait()
            raise
        finally:
            self._open_count -= 1

    async def stop(self, _application: web.Application) -> None:
        self._readings.stop()


async def _answer(name: str, work: Awaitable[web.StreamResponse]) -> web.StreamResponse:
    started = time.perf_counter()
    try:
        response = await work
    except BlockRobotError as error:
        response = problem_response(error)
        if is_over_budget(error):
            response.force_close()
    except web.HTTPException as error:
        response = problem_from_http(error)
    except (asyncio.CancelledError, ConnectionError):
        raise
    except Exception as error:  # noqa: BLE001 - the last resort: a fault must not reach the caller
        response = problem_from_fault(error, name)
    _log.debug("%s %d %.1f ms", name, response.status, (time.perf_counter() - started) * 1000)
    return response


@web.middleware
async def _problem_middleware(request: web.Request, handler: _WebHandler) -> web.StreamResponse:
    resource = request.match_info.route.resource
    name = f"{request.method} {resource.canonical if resource else 'unknown'}"
    return await _answer(name, handler(request))


async def _prepare(_request: web.Request, response: web.StreamResponse) -> None:
    name_server(response)


def _bind(gate: _Gate, route: Route) -> _WebHandler:
    async def handle(request: web.Request) -> web.StreamResponse:
        return await gate.run(route, request)

    return handle


def _bind_stray(gate: _Gate, routes: Iterable[Route]) -> _WebHandler:
    methods: dict[str, set[str]] = {}
    for route in routes:
        methods.setdefault(route.path, set()).add(route.method)
    patterns = [(re.compile(re.sub(r"\\{\w+\\}", "[^/]+", re.escape(path))), found) for path, found in methods.items()]

    async def handle(request: web.Request) -> web.StreamResponse:
        await gate.admit_stray(request)
        require_expectation(request)
        for pattern, allowed in patterns:
            if pattern.fullmatch(request.rel_url.raw_path):
                raise web.HTTPMethodNotAllowed(request.method, sorted(allowed))
        raise web.HTTPNotFound

    return handle


def create_api(services: ApiServices, routes: tuple[Route, ...] = ROUTES) -> web.Application:
    """Raises CONFIGURATION_INVALID."""
    require_rules(routes)
    application = web.Application(middlewares=[_problem_middleware])
    application.on_response_prepare.append(_prepare)
    application[DOCUMENT_KEY] = json.dumps(build_openapi(routes)).encode()
    application[GENESIS_KEY] = genesis_to_json(services.genesis).encode()
    gate = _Gate(services)
    for route in routes:
        application.router.add_route(route.method, route.path, _bind(gate, route), expect_handler=meet_expectation)
    stray = _bind_stray(gate, routes)
    application.router.add_route("*", "/{path:.*}", stray, expect_handler=meet_expectation)
    application[GATE_KEY] = gate
    application.on_cleanup.append(gate.stop)
    return application

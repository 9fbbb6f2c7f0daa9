"""The aiohttp application of one node's HTTP interface. Must never run a handler before its access rule.

One function handles every route: it limits, authorises, calls, and turns whatever goes wrong into a problem document.
The log names the route, never the address asked for: addresses hold ids.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Iterable

from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.access import Access
from node.api.bodies import Bodies
from node.api.openapi import build_openapi
from node.api.problems import problem_from_fault, problem_from_http, problem_response
from node.api.rate_limit import RateLimiter, RefusalDelay, Turns, is_over_budget, source_of
from node.api.routes import ROUTES
from node.api.routes.openapi import DOCUMENT_KEY
from node.api.routing import Call, Route
from node.api.server import name_server, refuse_expectation
from node.api.services import ApiServices
from node.api.sessions import TOKEN_SIZE_BYTES, Session, SessionTable
from node.budget import Source
from node.costs import ROUTE_COSTS, ROUTE_DEFAULT_US

OPEN_REQUESTS_MAX_COUNT = 4096
_log = logging.getLogger("node.api")
_WebHandler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def require_rules(routes: Iterable[Route]) -> None:
    """Check the route table: every route has a rule, and no method of a path or operation stands in it twice.

    Raises CONFIGURATION_INVALID.
    """
    seen: set[str] = set()
    for route in routes:
        if not isinstance(route.access, Access):
            raise BlockRobotError("CONFIGURATION_INVALID", f"The route {route.method} {route.path} has no access rule.")
        for name in (f"{route.method} {route.path}", route.operation):
            if name in seen:
                raise BlockRobotError("CONFIGURATION_INVALID", f"{name} stands twice in the route table.")
            seen.add(name)


class _Gate:
    """What every request passes: the number of open requests, the rate, the session, the rule."""

    def __init__(self, services: ApiServices) -> None:
        self._services = services
        self._limiter = RateLimiter(services.note_over)
        self._sessions = SessionTable(services.genesis.chain_id, services.node_name, services.clock, services.ledger)
        self._turns = Turns(services.note_over)
        self._bodies = Bodies(services.note_over)
        self._refusals = RefusalDelay()
        self._open_count = 0

    def _session_of(self, request: web.Request) -> Session | None:
        """Return the session of the request's token; a missing header is None, a wrong token is SESSION_EXPIRED."""
        header = request.headers.get("Authorization")
        if header is None:
            return None
        scheme, _, text = header.partition(" ")
        if scheme != "Bearer" or len(text) != 2 * TOKEN_SIZE_BYTES or not set(text) <= set("0123456789abcdef"):
            raise BlockRobotError("SESSION_EXPIRED", "The token does not have the form of one.")
        return self._sessions.resolve(bytes.fromhex(text))

    def _session_if_any(self, route: Route, request: web.Request) -> Session | None:
        """Return the session of who shows one where anybody may ask: he need not wait behind strangers of his address."""
        try:
            session = self._session_of(request)
            route.access.check(session)
        except BlockRobotError:
            return None
        return session

    def _authorise(self, route: Route, request: web.Request) -> tuple[Session | None, Source]:
        """Return the session, if there is one, and who pays. A caller who fails to identify pays as a stranger."""
        stranger = source_of(request.remote, None)
        cost_us = ROUTE_COSTS.get(route.operation, ROUTE_DEFAULT_US)
        try:
            if route.access.asks_session(is_public=self._services.public_explorer):
                session = self._session_of(request)
                route.access.check(session)
            else:
                session = self._session_if_any(route, request)
        except BlockRobotError:
            self._limiter.take(stranger, cost_us)
            raise
        source = stranger if session is None else source_of(request.remote, session)
        self._limiter.take(source, cost_us)
        return session, source

    async def run(self, route: Route, request: web.Request) -> web.StreamResponse:
        """Authorise and answer one request. Raises BlockRobotError for a refusal."""
        if self._open_count >= OPEN_REQUESTS_MAX_COUNT:
            raise BlockRobotError("RATE_LIMITED", "The node has as many open requests as it takes.")
        self._open_count += 1
        try:
            session, source = self._authorise(route, request)
            await self._turns.wait(source, ROUTE_COSTS.get(route.operation, ROUTE_DEFAULT_US))
            with self._bodies.of(source) as hold:
                return await route.handler(Call(self._services, self._sessions, request, route, session, source, hold))
        except BlockRobotError as error:
            if is_over_budget(error):
                await self._refusals.wait()
            raise
        finally:
            self._open_count -= 1


async def _answer(name: str, work: Awaitable[web.StreamResponse]) -> web.StreamResponse:
    """Await a response and turn every failure but cancellation into a problem document."""
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
    except Exception as error:  # noqa: BLE001 - the outermost wall: a fault must not reach the caller
        response = problem_from_fault(error, name)
    _log.debug("%s %d %.1f ms", name, response.status, (time.perf_counter() - started) * 1000)
    return response


@web.middleware
async def _problem_middleware(request: web.Request, handler: _WebHandler) -> web.StreamResponse:
    """Cover what never reaches a route: unknown paths and methods."""
    resource = request.match_info.route.resource
    name = f"{request.method} {resource.canonical if resource else 'unknown'}"
    return await _answer(name, handler(request))


async def _prepare(_request: web.Request, response: web.StreamResponse) -> None:
    name_server(response)


def _bind(gate: _Gate, route: Route) -> _WebHandler:
    async def handle(request: web.Request) -> web.StreamResponse:
        return await gate.run(route, request)

    return handle


def create_api(services: ApiServices, routes: tuple[Route, ...] = ROUTES) -> web.Application:
    """Return the application that serves `/v1` of one node. Raises CONFIGURATION_INVALID for a route without a rule."""
    require_rules(routes)
    application = web.Application(middlewares=[_problem_middleware])
    application.on_response_prepare.append(_prepare)
    application[DOCUMENT_KEY] = build_openapi(routes)
    gate = _Gate(services)
    for route in routes:
        application.router.add_route(route.method, route.path, _bind(gate, route), expect_handler=refuse_expectation)
    return application

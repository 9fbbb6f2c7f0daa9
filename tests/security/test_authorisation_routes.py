"""Every route tried by every caller, with real requests to the real application over a state that real contracts wrote.

What is expected is the table that `docs/reference/authorisation.md` is made from. A cell holds if the handler ran or did
not run as the table says: a refused request never reaches it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from consensus.chain.session_message import sign_session
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from node.api import create_api
from node.api.access import request_rate_limiter
from node.api.access.principals import resolve_principal
from node.api.access.route_access import Access
from node.api.access.sessions import SESSION_LIFETIME_MS, SESSIONS_OF_KEY_MAX_COUNT
from node.api.openapi.authorisation_page import CALLERS, Caller, refusal_of
from node.api.routes import ROUTES
from node.api.routing import Call, Handler, Route
from node.api_adapters import WallClock
from node.faults import FaultSwitch
from node.limits.token_buckets import Allowance
from node.operator_listener import OPEN_PATHS, create_operator_listener
from tests.unit.contracts.privacy.hospital import Hospital, key_of
from tests.unit.node.api.small_network import NOW_MS, SmallLedger, SmallNode

pytestmark = pytest.mark.smoke

STATE_MAX_COUNT = 1_000_000
NOT_FOR_YOU = {"SESSION_REQUIRED", "SESSION_EXPIRED", "SESSION_REFUSED", "NOT_PERMITTED"}
GUARDED = tuple(route for route in ROUTES if route.access.needs_session)
assert len(GUARDED) < SESSIONS_OF_KEY_MAX_COUNT


@dataclass
class Tried:
    """The application, how often each of its handlers ran, and what each caller sends to say who he is."""

    node: SmallNode
    client: TestClient[web.Request, web.Application]
    keys: dict[str, PrivateKey]
    ran: Counter[str]
    grants: dict[str, bytes]
    sessions: dict[str, Iterator[str]] = field(default_factory=dict)

    async def open_session(self, key: PrivateKey, grant_id: bytes = b"") -> str:
        """Return a token for a key, or the code of the refusal."""
        public_key = key.public_key.hex()
        answer = await self.client.post("/v1/session-challenges", json={"public_key": public_key})
        challenge = (await answer.json())["challenge"]
        signature = sign_session(key, self.node.ledger.genesis.chain_id, "n0", bytes.fromhex(challenge))
        document = {"public_key": public_key, "challenge": challenge, "signature": signature.hex()}
        if grant_id:
            document["grant"] = grant_id.hex()
        answer = await self.client.post("/v1/sessions", json=document)
        content = await answer.json()
        return str(content["token"] if answer.status == 200 else content["code"])

    async def open_sessions(self, *callers: str) -> None:
        """A session for each route that may look at one: what was refused once is forgotten."""
        for caller in callers:
            key, grant_id = self.keys[caller], self.grants.get(caller, b"")
            self.sessions[caller] = iter([await self.open_session(key, grant_id) for _ in GUARDED])

    async def ask(self, route: Route, caller: Caller) -> tuple[bool, str]:
        """Return whether the handler ran, and the code of the problem, if there is one."""
        token = next(self.sessions.get(caller.name, iter(())), "") if route in GUARDED else ""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        sizes = {item.name: item.size_bytes for item in route.parameters if item.place == "path"}
        path = route.path.format(**{name: "00" * size if size else "0" for name, size in sizes.items()})
        before = self.ran[route.operation]
        answer = await self.client.request(route.method, path, headers=headers, allow_redirects=False)
        is_problem = answer.content_type == "application/problem+json"
        code = (await answer.json())["code"] if is_problem else ""
        answer.close()
        return self.ran[route.operation] > before, code


def counted(ran: Counter[str], route: Route) -> Route:
    async def handle(call: Call) -> web.StreamResponse:
        ran[route.operation] += 1
        return await handler(call)

    handler: Handler = route.handler
    return replace(route, handler=handle)


def share_with(key: PrivateKey, hospital: Hospital, name: str, *, ended: bool = False) -> bytes:
    """Let somebody share a record with a key, and end that at once if asked; return the grant's id."""
    visit = hospital.open_visit(hospital.enrol(name))
    until_ms = visit.bucket_ms + 3_600_000
    words = [[hospital.record(visit)], key.public_key, key_of("ephemeral").public_key, 7, bytes(32), "care", until_ms]
    shared = hospital.must(visit.key, "access", "grant", *words)
    if ended:
        hospital.must(visit.key, "access", "revoke", shared.txid)
    return bytes(shared.txid)


def people_of(hospital: Hospital) -> dict[str, PrivateKey]:
    members = {name: hospital.enrol(name, name).identity for name in ("subject", "staff", "officer", "auditor")}
    return members | {
        "expired session": hospital.enrol("sleeper").identity,
        "revoked member": hospital.enrol("leaver", "staff").identity,
        "robot": hospital.robot.identity,
        "registrar": hospital.registrar,
        "admin": hospital.admin,
        "custodian": hospital.custodians[0],
        "producer": key_of("custodian-1/producer"),
        "owner key": hospital.open_visit(hospital.enrol("anna")).key,
        "grantee's key": key_of("grantee of ben"),
        "key of an ended grant": key_of("grantee of cleo"),
    }


@pytest.fixture(params=[False, True], ids=["explorer for members", "public explorer"])
async def tried(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Tried]:
    """Everybody has what sessions they can get; one has expired, and one member was revoked in a session."""
    # All of them call from this machine, faster than its budget allows.
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", Allowance(us_per_s=1, burst_us=10**9))
    hospital, ran = Hospital(), Counter[str]()
    hospital.time_ms = NOW_MS - 60_000
    keys = people_of(hospital)
    grants = {
        "grantee's key": share_with(keys["grantee's key"], hospital, "ben"),
        "key of an ended grant": share_with(keys["key of an ended grant"], hospital, "cleo", ended=True),
    }
    node = SmallNode.around(await SmallLedger().start())
    await node.ledger.extend(writes=dict(hospital.state.scan(b"", STATE_MAX_COUNT)))
    routes = tuple(counted(ran, route) for route in ROUTES)
    node.services = replace(node.services, public_explorer=request.param)
    async with TestClient(TestServer(create_api(node.services, routes))) as client:
        tried = Tried(node, client, keys, ran, grants)
        await tried.open_sessions("expired session")
        node.clock.time_ms += SESSION_LIFETIME_MS
        await tried.open_sessions(*(keys.keys() - {"expired session", "producer"}))
        hospital.must(hospital.admin, "identity", "revoke", sha256(b"leaver/handle"))
        await node.ledger.extend(writes=dict(hospital.state.scan(b"", STATE_MAX_COUNT)))
        yield tried


async def test_every_route_lets_in_whom_its_rule_names_and_nobody_else(tried: Tried) -> None:
    for caller in CALLERS:
        for route in ROUTES:
            expected = refusal_of(route.access, caller, is_public=tried.node.services.public_explorer)
            cell = f"{caller.name} at {route.method} {route.path}"
            ran, code = await tried.ask(route, caller)
            if expected:
                assert (ran, code) == (False, expected), cell
            else:
                assert ran, f"{cell}: {code}"
                assert code not in NOT_FOR_YOU | {"INTERNAL"}, cell


async def test_a_producers_key_and_a_revoked_member_open_no_session(tried: Tried) -> None:
    assert await tried.open_session(tried.keys["producer"]) == "SESSION_REFUSED"
    assert await tried.open_session(tried.keys["revoked member"]) == "SESSION_REFUSED"


async def test_the_table_knows_each_key_as_the_node_does(tried: Tried) -> None:
    with tried.node.services.ledger.snapshot() as snapshot:
        for caller in CALLERS:
            if caller.name in tried.keys.keys() - {"expired session"}:
                key, grant_id = tried.keys[caller.name].public_key, tried.grants.get(caller.name, b"")
                found = resolve_principal(snapshot, key, grant_id)
                assert found == caller.standing, caller.name


def test_the_table_tells_a_loosened_rule_from_a_tight_one() -> None:
    subject = next(caller for caller in CALLERS if caller.name == "subject")
    tight = next(route.access for route in ROUTES if route.operation == "uploadClip")
    assert refusal_of(tight, subject) == "NOT_PERMITTED"
    assert refusal_of(Access("anyone", frozenset()), subject) == ""


class _Status:
    def is_ready(self) -> bool:
        return True

    def problem(self) -> BlockRobotError | None:
        return None

    def describe(self) -> dict[str, Any]:
        return {}

    def metrics(self) -> bytes:
        return b""


async def test_the_operators_listener_asks_for_the_token_wherever_nothing_else_is_said(tmp_path: Path) -> None:
    application = create_operator_listener(_Status(), FaultSwitch("node-1", tmp_path, WallClock()), "token")
    routes = [(route.method, route.resource.canonical) for route in application.router.routes() if route.resource]
    assert set(OPEN_PATHS) < {path for _, path in routes}
    refused, token = {"OPERATOR_TOKEN_INVALID", "NOT_PERMITTED"}, {"Authorization": "Bearer token"}
    tries = {
        "OPERATOR_TOKEN_INVALID": ({}, {"Authorization": "Bearer "}, {"Authorization": "Bearer another"}),
        "NOT_PERMITTED": ({"Origin": "http://localhost"}, token | {"Origin": "http://localhost"}),
        "": (token,),
    }
    async with TestClient(TestServer(application)) as client:
        for method, path in (route for route in routes if route[0] != "HEAD"):
            for expected, all_headers in tries.items():
                for headers in all_headers:
                    answer = await client.request(method, path, headers=headers)
                    text = await answer.text()
                    if path in OPEN_PATHS and expected != "NOT_PERMITTED":
                        assert answer.status == 200, path
                    elif expected:
                        assert expected in text, path
                    else:
                        assert not [code for code in refused if code in text], path

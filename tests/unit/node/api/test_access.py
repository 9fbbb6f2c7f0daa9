"""Who may call what. The table here is written by hand, so that a loosened rule in the code fails."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from node.api import create_api
from node.api.routes import ROUTES
from node.api.routing import Route
from tests.unit.node.api.small_network import ADMIN, CUSTODIAN, OWNER, REGISTRAR, ROBOT, SUBJECT, SmallNode

CALLERS = {
    "subject": SUBJECT,
    "robot": ROBOT,
    "registrar": REGISTRAR,
    "admin": ADMIN,
    "custodian": CUSTODIAN,
    "owner": OWNER,
}
MEMBERS = {"subject", "robot", "registrar", "admin", "custodian"}
EVERYBODY_KNOWN = MEMBERS | {"owner"}
ALLOWED = {
    "getGenesis": {"nobody", *EVERYBODY_KNOWN},
    "getOpenApi": {"nobody", *EVERYBODY_KNOWN},
    "submitTransactions": {"nobody", *EVERYBODY_KNOWN},
    "getTransaction": {"nobody", *EVERYBODY_KNOWN},
    "createSessionChallenge": {"nobody", *EVERYBODY_KNOWN},
    "createSession": {"nobody", *EVERYBODY_KNOWN},
    "deleteSession": EVERYBODY_KNOWN,
    "getEpochs": {"nobody", *EVERYBODY_KNOWN},
    "getFinality": EVERYBODY_KNOWN,
    "getHeaders": EVERYBODY_KNOWN,
    "proveState": EVERYBODY_KNOWN,
    "queryContract": EVERYBODY_KNOWN,
    "listAnnouncements": MEMBERS,
    "streamEvents": MEMBERS,
    "listEvents": MEMBERS,
    "uploadClip": {"robot"},
    "downloadClip": {"owner"},
    "putBackground": {"robot"},
    "getBackground": EVERYBODY_KNOWN,
    "listBlocks": MEMBERS,
    "listContracts": MEMBERS,
    "getContract": MEMBERS,
    "getBlock": MEMBERS,
}
FORBIDDEN = [
    pytest.param(route, caller, id=f"{route.operation}-{caller}")
    for route in ROUTES
    for caller in ("nobody", *CALLERS)
    if caller not in ALLOWED[route.operation]
]


def address_of(route: Route) -> str:
    sizes = {parameter.name: parameter.size_bytes for parameter in route.parameters if parameter.place == "path"}
    return route.path.format(**{name: "00" * size if size else "0" for name, size in sizes.items()})


@pytest.mark.parametrize(("route", "caller"), FORBIDDEN)
async def test_a_route_refuses_every_caller_but_those_it_is_for(
    route: Route, caller: str, api: Any, open_session: Any
) -> None:
    headers = {} if caller == "nobody" else await open_session(CALLERS[caller])
    answer = await api.request(route.method, address_of(route), headers=headers, data=b"")
    problem = await answer.json()
    expected = (401, "SESSION_REQUIRED") if caller == "nobody" else (403, "NOT_PERMITTED")
    assert (answer.status, problem["code"]) == expected


def test_every_route_is_in_the_table_of_who_may_call_it() -> None:
    assert {route.operation for route in ROUTES} == set(ALLOWED)


@pytest.mark.parametrize("route", [route for route in ROUTES if route.access.needs_session], ids=lambda r: r.operation)
@pytest.mark.parametrize("token", ["00" * 32, "zz" * 32, "", "00" * 31])
async def test_a_token_that_was_never_given_out_opens_nothing(route: Route, token: str, api: Any) -> None:
    answer = await api.request(route.method, address_of(route), headers={"Authorization": f"Bearer {token}"})
    assert (answer.status, (await answer.json())["code"]) == (401, "SESSION_EXPIRED")


async def test_a_route_without_a_rule_fails_at_the_start(node: SmallNode) -> None:
    bare = replace(ROUTES[0], access=None)  # type: ignore[arg-type]
    with pytest.raises(BlockRobotError) as refusal:
        create_api(node.services, (bare,))
    assert refusal.value.code == "CONFIGURATION_INVALID"


async def test_a_route_that_stands_twice_fails_at_the_start(node: SmallNode) -> None:
    with pytest.raises(BlockRobotError, match="twice"):
        create_api(node.services, (ROUTES[0], ROUTES[0]))

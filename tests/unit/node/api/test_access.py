"""Who may call what. The table here is written by hand, so that a loosened rule in the code fails.

That each rule holds for real requests is tried in `tests/security/test_authorisation_routes.py`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from node.api import create_api
from node.api.openapi.authorisation_page import CALLERS, refusal_of
from node.api.routes import ROUTES
from node.api.routing import Route
from tests.unit.node.api.small_network import SmallNode

MEMBERS = {"subject", "staff", "robot", "officer", "auditor", "registrar", "admin", "custodian"}
EVERYBODY_KNOWN = MEMBERS | {"owner key", "grantee's key"}
READERS = EVERYBODY_KNOWN | {"key of an ended grant"}
EVERYBODY = {caller.name for caller in CALLERS}
ALLOWED = {
    "getGenesis": EVERYBODY,
    "getOpenApi": EVERYBODY,
    "submitTransactions": EVERYBODY,
    "getTransaction": EVERYBODY,
    "createSessionChallenge": EVERYBODY,
    "createSession": EVERYBODY,
    "deleteSession": READERS,
    "getEpochs": EVERYBODY,
    "getFinality": READERS,
    "getHeaders": READERS,
    "proveState": READERS,
    "proveNotices": EVERYBODY,
    "signConsentReceipt": MEMBERS,
    "queryContract": EVERYBODY_KNOWN - {"grantee's key"},
    "listAnnouncements": MEMBERS,
    "streamEvents": MEMBERS,
    "listEvents": MEMBERS,
    "uploadClip": {"robot"},
    "downloadClip": {"owner key"},
    "uploadKeyPart": {"owner key"},
    "downloadSharedClip": {"grantee's key"},
    "putBackground": {"robot"},
    "getBackground": EVERYBODY_KNOWN,
    "listBlocks": MEMBERS,
    "listContracts": MEMBERS,
    "getContract": MEMBERS,
    "getBlock": MEMBERS,
    "getExplorerStatus": MEMBERS,
    "listExplorerHeaders": MEMBERS,
    "getExplorerHeader": MEMBERS,
    "getExplorerEpoch": MEMBERS,
    "listExplorerProducers": MEMBERS,
    "explainRefusal": MEMBERS,
    "redirectToExplorer": EVERYBODY,
    "getExplorer": EVERYBODY,
    "getExplorerFile": EVERYBODY,
    "getSharedFile": EVERYBODY,
}
OPENED_BY_A_PUBLIC_EXPLORER = {
    "getExplorerStatus",
    "listExplorerHeaders",
    "getExplorerHeader",
    "getExplorerEpoch",
    "listExplorerProducers",
    "explainRefusal",
}


def address_of(route: Route) -> str:
    sizes = {parameter.name: parameter.size_bytes for parameter in route.parameters if parameter.place == "path"}
    return route.path.format(**{name: "00" * size if size else "0" for name, size in sizes.items()})


@pytest.mark.parametrize("route", ROUTES, ids=lambda route: route.operation)
def test_each_rule_lets_in_those_of_the_table_written_by_hand(route: Route) -> None:
    assert {caller.name for caller in CALLERS if not refusal_of(route.access, caller)} == ALLOWED[route.operation]


@pytest.mark.parametrize("route", ROUTES, ids=lambda route: route.operation)
def test_a_public_explorer_opens_its_own_routes_and_no_other(route: Route) -> None:
    allowed = {caller.name for caller in CALLERS if not refusal_of(route.access, caller, is_public=True)}
    is_opened = route.operation in OPENED_BY_A_PUBLIC_EXPLORER
    assert allowed == (EVERYBODY if is_opened else ALLOWED[route.operation])


def test_every_route_is_in_the_table_of_who_may_call_it() -> None:
    assert {route.operation for route in ROUTES} == set(ALLOWED)


@pytest.mark.parametrize("route", [route for route in ROUTES if route.access.needs_session], ids=lambda r: r.operation)
@pytest.mark.parametrize("token", ["00" * 32, "zz" * 32, "", "00" * 31])
async def test_a_token_that_was_never_given_out_opens_nothing(route: Route, token: str, api: Any) -> None:
    answer = await api.request(route.method, address_of(route), headers={"Authorization": f"Bearer {token}"})
    assert (answer.status, (await answer.json())["code"]) == (401, "SESSION_EXPIRED")


async def test_a_route_without_a_rule_or_that_stands_twice_fails_at_the_start(node: SmallNode) -> None:
    bare = replace(ROUTES[0], access=None)  # type: ignore[arg-type]
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID:"):
        create_api(node.services, (bare,))
    with pytest.raises(BlockRobotError, match="twice"):
        create_api(node.services, (ROUTES[0], ROUTES[0]))

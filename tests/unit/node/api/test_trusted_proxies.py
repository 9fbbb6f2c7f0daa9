"""Behind a proxy each client has a budget of its own, and nobody gets one by a header that no proxy of ours wrote."""

from __future__ import annotations

from dataclasses import replace

import pytest
from aiohttp.test_utils import TestClient, TestServer
from hypothesis import given
from hypothesis import strategies as st

from node.api import create_api
from node.api.access import request_rate_limiter
from node.api.access.trusted_proxies import HOPS_MAX_COUNT, TrustedProxies
from node.limits.token_buckets import Allowance
from node.limits.work_costs import ROUTE_DEFAULT_US
from tests.unit.node.api.small_network import SmallNode

OURS = TrustedProxies(["10.0.0.1", "10.1.0.0/24", "::1"])


@pytest.mark.parametrize(
    ("remote", "headers", "client"),
    [
        ("192.0.2.9", ["198.51.100.1"], "192.0.2.9"),
        ("10.0.0.1", [], "10.0.0.1"),
        ("10.0.0.1", ["198.51.100.1"], "198.51.100.1"),
        ("10.0.0.1", ["203.0.113.5, 198.51.100.1"], "198.51.100.1"),
        ("10.0.0.1", ["203.0.113.5", "198.51.100.1"], "198.51.100.1"),
        ("10.0.0.1", ["203.0.113.5, 198.51.100.1, 10.1.0.7"], "198.51.100.1"),
        ("10.0.0.1", ["10.1.0.7"], "10.1.0.7"),
        ("10.0.0.1", ["198.51.100.1, unknown"], "10.0.0.1"),
        ("10.0.0.1", [""], "10.0.0.1"),
        ("::ffff:10.0.0.1", ["2001:db8::1"], "2001:db8::1"),
        ("::1", ["::ffff:198.51.100.1"], "198.51.100.1"),
        (None, ["198.51.100.1"], None),
    ],
)
def test_the_client_is_whom_the_last_trusted_proxy_saw(
    remote: str | None, headers: list[str], client: str | None
) -> None:
    assert OURS.find(remote, headers) == client
    assert TrustedProxies().find(remote, headers) == remote


@given(st.lists(st.text(max_size=30), max_size=3))
def test_what_a_client_writes_itself_never_names_another(written: list[str]) -> None:
    """A proxy appends whom it saw."""
    assert OURS.find("10.0.0.1", [*written, "198.51.100.1"]) == "198.51.100.1"
    assert OURS.find("192.0.2.9", written) == "192.0.2.9"
    assert OURS.find("10.0.0.1", ["198.51.100.1", *["10.1.0.7"] * HOPS_MAX_COUNT]) == "10.1.0.7"


async def test_clients_behind_one_proxy_do_not_share_a_budget(node: SmallNode, monkeypatch: pytest.MonkeyPatch) -> None:
    few = Allowance(1, 2 * ROUTE_DEFAULT_US)
    monkeypatch.setattr(request_rate_limiter, "ADDRESS_ALLOWANCE", few)
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", few)
    monkeypatch.setattr(request_rate_limiter, "REFUSAL_DELAY_S", 0)
    node.services = replace(node.services, trusted_proxies=TrustedProxies(["127.0.0.1"]))
    async with TestClient(TestServer(create_api(node.services))) as api:
        for client in ("198.51.100.1", "198.51.100.2"):
            headers = {"X-Forwarded-For": f"203.0.113.5, {client}"}
            answers = [(await api.get("/v1/genesis", headers=headers)).status for _ in range(3)]
            # The second may have cost more than its price, on a slow machine.
            assert (answers[0], answers[2]) == (200, 429), client

"""Refusals are problem documents: a code, a next step, and nothing of the node's inside."""

from __future__ import annotations

import io
import logging
from typing import Any

import pytest
from aiohttp.test_utils import TestClient, TestServer

from consensus.chain.session_message import sign_session
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from node.api import create_api
from node.api.access import request_rate_limiter
from node.api.access.request_rate_limiter import RequestRateLimiter, source_of
from node.api.access.sessions import Session
from node.limits.token_buckets import Allowance
from node.limits.work_costs import ROUTE_DEFAULT_US
from tests.unit.node.api.small_network import OWNER, ROBOT, SUBJECT, SmallNode


async def test_a_refusal_has_every_member_of_a_problem_document(api: Any) -> None:
    answer = await api.get("/v1/finality")
    assert answer.content_type == "application/problem+json"
    assert answer.headers["WWW-Authenticate"] == "Bearer"
    entry = CATALOGUE["SESSION_REQUIRED"]
    assert await answer.json() == {
        "type": "urn:blockrobot:error:SESSION_REQUIRED",
        "title": entry.meaning,
        "status": 401,
        "code": "SESSION_REQUIRED",
        "detail": entry.meaning,
        "next_step": entry.next_step,
        "retryable": False,
    }


@pytest.mark.parametrize("path", ["/", "/v1", "/v2/genesis", "/livez", "/readyz", "/metrics", "/status"])
async def test_an_unknown_address_is_a_problem_too(api: Any, path: str) -> None:
    answer = await api.get(path)
    assert (answer.status, (await answer.json())["code"]) == (404, "ROUTE_UNKNOWN")


async def test_a_wrong_method_names_the_right_ones(api: Any) -> None:
    answer = await api.delete("/v1/genesis")
    assert (answer.status, (await answer.json())["code"]) == (405, "METHOD_NOT_ALLOWED")
    assert "GET" in answer.headers["Allow"]


async def test_a_fault_of_the_node_shows_nothing_of_itself(
    api: Any, node: SmallNode, caplog: pytest.LogCaptureFixture
) -> None:
    node.pool.fault = RuntimeError("the secret inside /home/node")
    with caplog.at_level(logging.ERROR, logger="node.api"):
        answer = await api.post("/v1/transactions", data=b"\x91\xc4\x01x")
    text = await answer.text()
    assert (answer.status, (await answer.json())["code"]) == (500, "INTERNAL")
    assert "secret" not in text
    assert "Traceback" not in text
    assert [record.exc_info is not None for record in caplog.records if record.name == "node.api"] == [True]


async def test_the_log_names_routes_and_never_tokens_or_ids(
    api: Any, open_session: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG, logger="node.api"):
        headers = await open_session(SUBJECT)
        await api.get(f"/v1/transactions/{'ab' * 32}", headers=headers)
    assert any("/v1/transactions/{txid}" in record.getMessage() for record in caplog.records)
    token = headers["Authorization"].removeprefix("Bearer ")
    assert token not in caplog.text
    assert "ab" * 32 not in caplog.text


@pytest.mark.parametrize("path", ["/v1/session-challenges", "/v1/sessions"])
@pytest.mark.parametrize("body", [b"", b"[]", b"{}", b"\xff", b'{"public_key": 1}', b"[" * 900])
async def test_a_body_that_is_not_as_described_is_refused(api: Any, path: str, body: bytes) -> None:
    answer = await api.post(path, data=body)
    assert (answer.status, (await answer.json())["code"]) == (400, "REQUEST_INVALID")


async def test_a_body_beyond_its_routes_limit_is_refused_also_if_its_length_is_unstated(api: Any) -> None:
    answer = await api.post("/v1/session-challenges", data=b" " * 1025)
    assert (answer.status, (await answer.json())["code"]) == (413, "REQUEST_TOO_LARGE")

    async def endless() -> Any:
        for _ in range(100):
            yield b" " * 1024

    answer = await api.post("/v1/session-challenges", data=endless())
    assert (answer.status, (await answer.json())["code"]) == (413, "REQUEST_TOO_LARGE")


async def test_a_clip_of_the_largest_size_passes_the_limit_of_bodies(api: Any, open_session: Any) -> None:
    path, content = f"/v1/clips/{'00' * 16}?owner={'00' * 33}", io.BytesIO(bytes(CLIP_SIZE_MAX_BYTES))
    answer = await api.put(path, data=content, headers=await open_session(ROBOT))
    assert (await answer.json())["code"] == "ENCODING_INVALID"


async def test_a_node_without_a_custodian_sends_the_caller_elsewhere(node: SmallNode) -> None:
    async with TestClient(TestServer(create_api(node.without_custody().services))) as api:
        public_key = SUBJECT.public_key.hex()
        asked = await api.post("/v1/session-challenges", json={"public_key": public_key})
        challenge = (await asked.json())["challenge"]
        signature = sign_session(SUBJECT, node.ledger.genesis.chain_id, "n0", bytes.fromhex(challenge)).hex()
        document = {"public_key": public_key, "challenge": challenge, "signature": signature}
        token = (await (await api.post("/v1/sessions", json=document)).json())["token"]
        answer = await api.get(f"/v1/backgrounds/{'00' * 32}", headers={"Authorization": f"Bearer {token}"})
        assert (answer.status, (await answer.json())["code"]) == (404, "CUSTODY_ELSEWHERE")


async def test_callers_without_a_session_are_slowed_down_and_a_session_is_not_with_them(
    api: Any, monkeypatch: pytest.MonkeyPatch, open_session: Any
) -> None:
    headers = await open_session(SUBJECT)
    allowance = Allowance(1, 2 * ROUTE_DEFAULT_US + ROUTE_DEFAULT_US // 2)
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", allowance)
    answers = [(await api.get("/v1/genesis")).status for _ in range(3)]
    assert (answers[0], answers[2]) == (200, 429), "the second may have cost more than its price"
    answer = await api.get("/v1/finality", headers={"Authorization": f"Bearer {'00' * 32}"})
    assert (answer.status, answer.headers["Retry-After"]) == (429, "60")
    monkeypatch.setattr(request_rate_limiter, "LOOPBACK_ALLOWANCE", Allowance(1, 0))
    assert (await api.get("/v1/genesis")).status == 429
    assert (await api.get("/v1/finality", headers=headers)).status == 200


def test_a_bucket_fills_again_and_addresses_do_not_share_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_rate_limiter, "ADDRESS_ALLOWANCE", Allowance(20 * ROUTE_DEFAULT_US, ROUTE_DEFAULT_US))
    now, over = {"s": 0.0}, []
    limiter = RequestRateLimiter(lambda source, _error: over.append(source), lambda: now["s"])
    first, second = source_of("192.0.2.1", None), source_of("192.0.2.2", None)
    limiter.take(first)
    limiter.take(second)
    with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
        limiter.take(first)
    assert over == ["address 192.0.2.1"]
    now["s"] += 0.05
    limiter.take(first)


def test_a_session_behind_a_loud_address_has_a_budget_of_its_own() -> None:
    limiter = RequestRateLimiter(lambda _source, _error: None, lambda: 0.0)
    loud = source_of("192.0.2.1", None)
    for _ in range(request_rate_limiter.ADDRESS_ALLOWANCE.burst_us // ROUTE_DEFAULT_US):
        limiter.take(loud)
    with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
        limiter.take(loud)
    limiter.take(source_of("192.0.2.1", Session(SUBJECT.public_key, "member", frozenset(), 0)))


def test_the_keys_of_visits_at_one_address_share_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEYS_ALLOWANCE", Allowance(1, 10 * ROUTE_DEFAULT_US))
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEY_ALLOWANCE", Allowance(1, 0))
    limiter = RequestRateLimiter(lambda _source, _error: None, lambda: 0.0)
    keys = [OWNER.public_key, *(bytes([2, number]) + bytes(31) for number in range(10))]
    for key in keys[:10]:
        limiter.take(source_of("192.0.2.1", Session(key, "owner", frozenset(), 0)))
    with pytest.raises(BlockRobotError, match=r"visit keys at 192\.0\.2\.1"):
        limiter.take(source_of("192.0.2.1", Session(keys[10], "owner", frozenset(), 0)))
    limiter.take(source_of("192.0.2.2", Session(keys[10], "owner", frozenset(), 0)))
    limiter.take(source_of("192.0.2.1", Session(SUBJECT.public_key, "member", frozenset(), 0)))


def test_a_visit_that_floods_keeps_no_other_at_its_address_from_asking(monkeypatch: pytest.MonkeyPatch) -> None:
    """All patients of a hospital may stand behind one address, and one of them used up what all of them had."""
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEYS_ALLOWANCE", Allowance(1, 100 * ROUTE_DEFAULT_US))
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEY_ALLOWANCE", Allowance(1, 5 * ROUTE_DEFAULT_US))
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEYS_RESERVE", Allowance(1, 20 * ROUTE_DEFAULT_US))
    limiter = RequestRateLimiter(lambda _source, _error: None, lambda: 0.0)

    def ask(number: int) -> int:
        """Ask until it is refused; return how often it was not."""
        source = source_of("192.0.2.1", Session(bytes([2, number]) + bytes(31), "owner", frozenset(), 0))
        for count in range(1_000):
            try:
                limiter.take(source)
            except BlockRobotError:
                return count
        raise AssertionError("there is no bound")

    assert ask(0) == 105
    assert [ask(number) for number in range(1, 6)] == [5, 5, 5, 0, 0], "many of them have the reserve, and no more"


def test_who_is_refused_for_want_of_the_common_reserve_has_paid_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEYS_ALLOWANCE", Allowance(1, 0))
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEY_ALLOWANCE", Allowance(1, 2 * ROUTE_DEFAULT_US))
    monkeypatch.setattr(
        request_rate_limiter, "VISIT_KEYS_RESERVE", Allowance(2 * ROUTE_DEFAULT_US, 2 * ROUTE_DEFAULT_US)
    )
    now = {"s": 0.0}
    limiter = RequestRateLimiter(lambda _source, _error: None, lambda: now["s"])
    loud, quiet = (
        source_of("192.0.2.1", Session(bytes([2, number]) + bytes(31), "owner", frozenset(), 0)) for number in (1, 2)
    )
    for _ in range(2):
        limiter.take(loud)
    with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
        limiter.take(quiet)
    now["s"] = 1.0
    for _ in range(2):
        limiter.take(quiet)


def test_the_table_of_buckets_stays_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_rate_limiter, "SOURCES_MAX_COUNT", 3)
    limiter = RequestRateLimiter(lambda _source, _error: None, lambda: 0.0)
    for number in range(10):
        limiter.take(source_of(f"192.0.2.{number}", None))
    assert len(limiter) == 3


def test_the_keys_of_visits_in_one_network_of_ipv6_share_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """And with it places and room for bodies, which go by the same source."""
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEYS_ALLOWANCE", Allowance(1, 10 * ROUTE_DEFAULT_US))
    monkeypatch.setattr(request_rate_limiter, "VISIT_KEY_ALLOWANCE", Allowance(1, 0))
    limiter = RequestRateLimiter(lambda _source, _error: None, lambda: 0.0)
    visit = Session(OWNER.public_key, "owner", frozenset(), 0)
    for number in range(10):
        limiter.take(source_of(f"2001:db8:0:1::{number:x}", visit))
    with pytest.raises(BlockRobotError, match=r"visit keys at 2001:db8:0:1::/64"):
        limiter.take(source_of("2001:db8:0:1:ffff::", visit))
    limiter.take(source_of("2001:db8:0:2::1", visit))

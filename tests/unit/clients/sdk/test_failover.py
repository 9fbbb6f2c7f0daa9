from __future__ import annotations

from typing import Any

import msgspec
import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer

from clients.sdk import network_client
from clients.sdk.node_answers import failure_of, may_ask_another
from consensus.api_documents import Problem
from consensus.chain.schedule import Schedule
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.state import records
from node.api.access.sessions import SessionTable
from tests.unit.clients.sdk.conftest import DEAD_URL, make_transaction, refusal_of
from tests.unit.node.api.small_network import SUBJECT

PARTS_COUNT = 10
"""All codes at once are more requests than a node takes of one address where the machine is busy."""
OF_TOMORROW = Problem("urn:x", "", 418, "BRAND_NEW", "Of tomorrow.", "", retryable=False)
AWAY, LATE, FULL = "NODE_UNREACHABLE", "TRANSACTION_EXPIRED", "MEMPOOL_FULL"


@pytest.mark.parametrize(
    ("codes", "raised"),
    [
        ([], AWAY),
        ([AWAY, AWAY], AWAY),
        ([AWAY, FULL, "RATE_LIMITED"], FULL),
        ([LATE, LATE, AWAY], LATE),
        ([LATE, AWAY], AWAY),
        ([LATE, AWAY, AWAY, AWAY], AWAY),
        ([LATE, FULL], FULL),
        ([LATE, LATE, LATE], LATE),
        (["INTERNAL", "SESSION_REFUSED", "SESSION_REFUSED"], "SESSION_REFUSED"),
        (["NODE_ADDRESS_WRONG", "SESSION_REFUSED"], "SESSION_REFUSED"),
        ([AWAY, "NODE_ADDRESS_WRONG"], "NODE_ADDRESS_WRONG"),
    ],
)
def test_after_all_refused_the_most_telling_refusal_is_raised_and_clocks_are_believed_if_most_agree(
    codes: list[str], raised: str
) -> None:
    assert failure_of([BlockRobotError(code) for code in codes]).code == raised


def test_another_node_is_asked_for_what_it_may_do_and_for_nothing_else() -> None:
    asked = ["NODE_UNREACHABLE", "MEMPOOL_FULL", "PROOF_INVALID", "NODE_REMOVED", "TRANSACTION_EXPIRED", "BLOCK_PRUNED"]
    assert all(may_ask_another(BlockRobotError(code)) for code in asked)
    assert not any(may_ask_another(BlockRobotError(code)) for code in ("SENDER_NOT_ADMITTED", "CALL_REFUSED"))


@pytest.mark.parametrize("code", ["TRANSACTION_EXPIRED", "TRANSACTION_TOO_FAR_AHEAD"])
async def test_what_one_wrong_clock_refuses_is_taken_by_another_node(nodes: Any, code: str) -> None:
    client = nodes.client()
    nodes["n0"].node.pool.refuse_with = code
    nodes["n1"].node.pool.finalize_at_once = True
    transaction = make_transaction(client)
    nodes["n0"].node.pool.expired.add(transaction.txid)
    assert (await client.submit_and_wait(transaction)).txid == transaction.txid


async def test_what_every_clock_refuses_is_refused_at_once(nodes: Any) -> None:
    client = nodes.client()
    for name in ("n0", "n1"):
        nodes[name].node.pool.refuse_with = "TRANSACTION_EXPIRED"
    assert await refusal_of(client.submit_and_wait(make_transaction(client))) == "TRANSACTION_EXPIRED"


@pytest.mark.parametrize("part", range(PARTS_COUNT))
async def test_no_refusal_of_one_node_keeps_a_transaction_from_the_chain(
    nodes: Any, monkeypatch: pytest.MonkeyPatch, part: int
) -> None:
    """One that calls it known is as one that takes it and tells nobody: it is sent on while it is not final."""
    monkeypatch.setattr(Schedule, "faults_tolerated", property(lambda _: 1))
    for code in sorted(CATALOGUE.keys() - {"TRANSACTION_REPLAYED"})[part::PARTS_COUNT]:
        nodes["n0"].node.pool.refuse_with = code
        client = nodes.client()
        transaction = make_transaction(client)
        await client.submit(transaction)
        assert nodes["n1"].node.pool.submissions.pop() == transaction.txid, code


async def test_what_more_nodes_refuse_than_may_be_faulty_is_refused(
    nodes: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Schedule, "faults_tolerated", property(lambda _: 1))
    for name in ("n0", "n1"):
        nodes[name].node.pool.refuse_with = "SENDER_NOT_ADMITTED"
    client = nodes.client()
    assert await refusal_of(client.submit_and_wait(make_transaction(client))) == "SENDER_NOT_ADMITTED"
    assert client.troubles == {}, "no trouble of the nodes"


@pytest.mark.parametrize(("refusals_count", "is_answered"), [(4, True), (1_000, False)])
async def test_a_client_whose_budgets_are_used_up_everywhere_waits_and_asks_again(
    nodes: Any, monkeypatch: pytest.MonkeyPatch, refusals_count: int, is_answered: bool
) -> None:
    monkeypatch.setattr(network_client, "BUDGET_WAIT_MS", 1)
    asked: list[str] = []

    async def ask(node: Any) -> str:
        asked.append(node.name)
        if len(asked) <= refusals_count:
            raise BlockRobotError("RATE_LIMITED")
        return "answer"

    work = nodes.client().with_any_node(ask)
    if is_answered:
        assert await work == "answer"
        assert asked == ["n0", "n1"] * 2 + ["n0"]
    else:
        assert await refusal_of(work) == "RATE_LIMITED"
        assert len(asked) == 2 * (1 + network_client.BUDGET_WAITS_MAX_COUNT)


async def test_a_dead_node_is_passed_over(nodes: Any) -> None:
    client = nodes.client(urls={"n2": DEAD_URL, **nodes.urls})
    assert (await client.state_value(records.ANNOUNCEMENT_COUNT.flat, SUBJECT)) == 3


@pytest.mark.parametrize("code", ["NODE_REMOVED", "CERTIFICATE_EXPIRED", "CERTIFICATE_REVOKED"])
async def test_a_node_that_nobody_hears_is_passed_over(nodes: Any, code: str) -> None:
    nodes["n0"].node.pool.fault = BlockRobotError(code)
    nodes["n1"].node.pool.finalize_at_once = True
    receipt = await nodes.client().call(SUBJECT, "access", "request", [[], "care"], timeout_ms=5_000)
    assert receipt.height == 1


async def test_one_node_that_opens_no_session_does_not_speak_for_the_others(nodes: Any) -> None:
    """It may not have the block yet in which somebody became a member, or something was shared with her."""
    client, refusing = nodes.client(), {"n0"}

    async def ask(node: Any) -> str:
        if node.name in refusing:
            raise BlockRobotError("SESSION_REFUSED")
        return str(node.name)

    assert await client.with_any_node(ask) == "n1"
    refusing.add("n1")
    assert await refusal_of(client.with_any_node(ask)) == "SESSION_REFUSED"


async def test_another_node_at_a_removed_ones_address_keeps_nobody_out(nodes: Any) -> None:
    """The genesis file names n2 there still: who answers takes no session for that name."""
    client = nodes.client(urls={"n2": nodes["n0"].url, "n1": nodes["n1"].url})
    assert (await client.state_value(records.ANNOUNCEMENT_COUNT.flat, SUBJECT)) == 3
    assert client.troubles["n2"].code == "NODE_ADDRESS_WRONG"
    assert "SIGNATURE_INVALID" in client.troubles["n2"].detail


@pytest.mark.parametrize("part", range(PARTS_COUNT))
async def test_no_refusal_of_a_session_by_one_node_keeps_anybody_out(
    nodes: Any, monkeypatch: pytest.MonkeyPatch, part: int
) -> None:
    """Of a network of two nodes as well, where none may be faulty: it costs a question."""
    open_session = SessionTable.open
    for code in sorted(CATALOGUE)[part::PARTS_COUNT]:

        def refuse(table: Any, *request: Any, code: str = code) -> Any:
            if table._node_name == "n0":
                raise BlockRobotError(code)
            return open_session(table, *request)

        monkeypatch.setattr(SessionTable, "open", refuse)
        client = nodes.client()
        assert (await client.state_value(records.ANNOUNCEMENT_COUNT.flat, SUBJECT)) == 3, code


async def test_no_refusal_of_one_node_keeps_anything_unread(nodes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Schedule, "faults_tolerated", property(lambda _: 1))
    for code in CATALOGUE:
        client = nodes.client()

        async def ask(node: Any, code: str = code) -> str:
            if node.name == "n0":
                raise BlockRobotError(code)
            return str(node.name)

        assert await client.with_any_node(ask) == "n1", code


async def test_without_any_node_the_network_is_unreachable(nodes: Any) -> None:
    client = nodes.client(urls={"n0": DEAD_URL, "n1": DEAD_URL})
    assert await refusal_of(client.query("echo", "back", [], SUBJECT)) == "NODE_UNREACHABLE"


async def test_a_busy_node_is_passed_over_and_a_clear_refusal_is_not_where_none_may_be_faulty(
    nodes: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Schedule, "faults_tolerated", property(lambda _: 0))
    client = nodes.client()
    nodes["n0"].node.pool.fault = RuntimeError("busy")
    await client.submit(make_transaction(client))
    assert len(nodes["n1"].node.pool.submissions) == 1
    before = len(nodes["n0"].seen)
    assert await refusal_of(client.query("echo", "other", [], SUBJECT)) == "CALL_REFUSED"
    assert len(nodes["n0"].seen) == before


async def serve(answer: web.Response) -> TestServer:
    async def handle(_: web.Request) -> web.Response:
        return answer

    application = web.Application()
    application.router.add_route("*", "/{rest:.*}", handle)
    server = TestServer(application)
    await server.start_server()
    return server


@pytest.mark.parametrize(
    ("answer", "code", "sentence"),
    [
        ({"body": msgspec.json.encode(OF_TOMORROW), "status": 418}, "INTERNAL", "BRAND_NEW: Of"),
        ({"text": '{"code": "NOT_FOUND"}', "status": 404}, "INTERNAL", "404 and no problem document"),
        ({"text": "<html>", "status": 502}, "INTERNAL", "502"),
        ({"text": "<html>", "status": 200}, "INTERNAL", "no SubmitAnswer"),
        ({"text": '{"results": []}', "status": 200}, "INTERNAL", "another number"),
        ({"text": "", "status": 302}, "INTERNAL", "302"),
    ],
)
async def test_an_answer_that_nobody_understands_is_internal(
    nodes: Any, answer: dict[str, Any], code: str, sentence: str
) -> None:
    server = await serve(web.Response(**answer))
    client = nodes.client(urls={"n0": str(server.make_url(""))})
    with pytest.raises(BlockRobotError, match=sentence) as refusal:
        await client.submit(make_transaction(client))
    assert refusal.value.code == code
    await server.close()

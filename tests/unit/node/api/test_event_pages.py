"""Events page by page: who goes on where a page ended misses none and reads none twice."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from consensus.chain.block import ContractEvent, Receipt
from consensus.primitives.encoding import encode_value
from node.api.routes import event_pages
from node.snapshot.making import header_of_block
from tests.unit.node.api.small_network import OWNER, SUBJECT, SmallNode


def receipt(number: int, *names: str, contract: str = "records") -> Receipt:
    events = tuple(ContractEvent(contract=contract, name=name, data=encode_value({"n": number})) for name in names)
    return Receipt(txid=bytes([number]) * 32, ok=True, code="OK", message="", line=None, gas_used=1, events=events)


async def write_six_blocks(node: SmallNode) -> None:
    """Blocks 1 to 6: three events, none, one of another contract, none, two of two transactions, none."""
    await node.ledger.extend(receipts=(receipt(1, "one", "two", "three"),))
    await node.ledger.extend()
    await node.ledger.extend(receipts=(receipt(2, "one", contract="access"),))
    await node.ledger.extend()
    await node.ledger.extend(receipts=(receipt(3, "one"), receipt(4), receipt(5, "two")))
    await node.ledger.extend()


@pytest.fixture
def read(api: Any, open_session: Any) -> Any:
    async def page(query: str = "") -> dict[str, Any]:
        answer = await api.get(f"/v1/events/page?{query}", headers=await open_session(SUBJECT))
        document: dict[str, Any] = await answer.json()
        return document

    return page


def places(page: dict[str, Any]) -> list[str]:
    return [event["place"] for event in page["events"]]


async def test_pages_hold_every_event_once_in_order(node: SmallNode, read: Any) -> None:
    await write_six_blocks(node)
    whole = await read()
    assert places(whole) == ["1:0", "1:1", "1:2", "3:0", "5:0", "5:1"]
    assert [event["txid"][:2] for event in whole["events"]] == ["01", "01", "01", "02", "03", "05"]
    assert (whole["next"], whole["head"], whole["earliest_height"]) == ("7:0", 6, 0)
    for limit in (1, 2, 4, 6):
        joined: list[dict[str, Any]] = []
        place = "0:0"
        while place != "7:0":
            page = await read(f"from={place}&limit={limit}")
            assert len(page["events"]) <= limit
            joined, place = joined + page["events"], page["next"]
        assert joined == whole["events"]


async def test_pages_may_be_of_one_contract_or_one_name_and_a_node_that_is_behind_sends_nobody_back(
    node: SmallNode, read: Any
) -> None:
    await write_six_blocks(node)
    assert places(await read("contract=access")) == ["3:0"]
    assert places(await read("name=one")) == ["1:0", "3:0", "5:0"]
    assert places(await read("contract=records&name=two")) == ["1:1", "5:1"]
    assert (await read("contract=nothing"))["next"] == "7:0"
    page = await read("from=9:4")
    assert (page["events"], page["next"]) == ([], "9:4")


async def test_a_page_looks_at_so_many_events_and_says_where_it_stopped(
    node: SmallNode, read: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    await write_six_blocks(node)
    monkeypatch.setattr(event_pages, "SCAN_MAX_COUNT", 2)
    page = await read("contract=access")
    assert (page["events"], page["next"]) == ([], "1:2")
    assert places(await read("contract=access&from=1:2")) == ["3:0"]


async def test_an_answer_waits_for_a_new_block(node: SmallNode, read: Any) -> None:
    await write_six_blocks(node)
    waiting = asyncio.create_task(read("from=7:0&wait_ms=20000"))
    while not node.ledger.feed._heights:  # noqa: ASYNC110 - the feed has no event for "somebody waits"
        await asyncio.sleep(0)
    await node.ledger.extend(receipts=(receipt(6, "late"),))
    assert places(await waiting) == ["7:0"]


async def test_what_was_pruned_is_said_and_what_was_read_before_is_no_loss(node: SmallNode, read: Any) -> None:
    await write_six_blocks(node)
    assert await node.ledger.store.prune(5, header_of_block) == 5
    problem = await read("from=3:0")
    assert (problem["code"], "from 5 on" in problem["detail"]) == ("BLOCK_PRUNED", True)
    assert places(await read("from=5:1")) == ["5:1"]
    assert places(await read()) == ["5:0", "5:1"]


async def test_a_place_is_two_numbers(api: Any, read: Any, open_session: Any) -> None:
    for wrong in ("1", "a:b", "1:", "-1:0", "1:0:0", "9999999999999999:0"):
        assert (await read(f"from={wrong}"))["code"] == "REQUEST_INVALID"
    answer = await api.get("/v1/events/page", headers=await open_session(OWNER))
    assert answer.status == 403

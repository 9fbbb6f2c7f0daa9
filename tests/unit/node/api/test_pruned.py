"""A node that pruned its past says so, from where on it can answer, and who keeps the rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from aiohttp.test_utils import TestClient, TestServer

from node.api import create_api
from node.snapshot.making import header_of_block
from tests.unit.node.api.small_network import SUBJECT, SmallNode
from tests.unit.node.explorer.test_explorer_routes import a_call


async def test_a_pruned_block_is_no_unknown_one(api: Any, node: SmallNode, open_session: Any) -> None:
    for _ in range(4):
        await node.ledger.extend()
    headers = await open_session(SUBJECT)
    before = await (await api.get("/v1/headers?from_height=0&limit=5", headers=headers)).json()
    assert await node.ledger.store.prune(3, header_of_block) == 3
    for path in ("/v1/blocks/1", "/v1/blocks?from_height=2", "/v1/events?cursor=1:0"):
        answer = await api.get(path, headers=headers)
        problem = await answer.json()
        assert (answer.status, problem["code"]) == (410, "BLOCK_PRUNED")
        assert problem["detail"].endswith("this node has them from 3 on. No peer says to keep it.")
        assert "owner of the receipt" in problem["next_step"]
    page = await (await api.get("/v1/blocks?from_height=3", headers=headers)).json()
    assert (page["earliest_height"], [block["height"] for block in page["blocks"]]) == (3, [3, 4])
    assert (await api.get("/v1/blocks/9", headers=headers)).status == 404
    after = await (await api.get("/v1/headers?from_height=0&limit=5", headers=headers)).json()
    assert after == before


@pytest.mark.parametrize(
    ("names", "told"), [(["n3"], "n3 keeps it."), (["n2", "n3"], "n2, n3 keep it."), ([], "No peer says to keep it.")]
)
async def test_who_asks_for_a_pruned_receipt_is_told_which_peers_keep_it(
    node: SmallNode, names: list[str], told: str
) -> None:
    call, receipt = a_call()
    await node.ledger.extend([call], (receipt,))
    await node.ledger.extend()
    await node.ledger.store.prune(2, header_of_block)
    asked: list[int] = []

    def peers_with_block(height: int) -> list[str]:
        asked.append(height)
        return names

    services = replace(node.services, peers_with_block=peers_with_block)
    async with TestClient(TestServer(create_api(services))) as client:
        answer = await client.get(f"/v1/transactions/{call.txid.hex()}?evidence=1")
        problem = await answer.json()
    assert (answer.status, problem["code"], asked) == (410, "BLOCK_PRUNED", [1])
    assert problem["detail"].endswith(told)

"""A node that pruned its past says so, and from where on it can answer."""

from __future__ import annotations

from typing import Any

from node.snapshot.making import header_of_block
from tests.unit.node.api.small_network import SUBJECT, SmallNode


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
        assert "from 3 on" in problem["detail"]
        assert "earliest_height" in problem["next_step"]
    page = await (await api.get("/v1/blocks?from_height=3", headers=headers)).json()
    assert (page["earliest_height"], [block["height"] for block in page["blocks"]]) == (3, [3, 4])
    assert (await api.get("/v1/blocks/9", headers=headers)).status == 404
    after = await (await api.get("/v1/headers?from_height=0&limit=5", headers=headers)).json()
    assert after == before

"""Fills a measured network's blocks, making requests expensive."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from clients.sdk.node_answers import D, read_answer
from consensus.api_documents import PAGE_MAX_COUNT, BlockAnswer, BlocksAnswer, BlockSummary
from network.bench.flood.flood_routes import Landmarks
from network.bench.fresh_network import LoadRobot

BATCH_COUNT = 256
RECORDS_COUNT = 4_096
BUSY_PAUSE_S = 0.5


async def fill_blocks(robots: Sequence[LoadRobot]) -> Landmarks:
    accepted = 0
    while accepted < RECORDS_COUNT:
        batch = [robots[place % len(robots)].sign_record() for place in range(BATCH_COUNT)]
        refusals = await robots[0].client.submit_batch(batch)
        accepted += (taken := refusals.count(None))
        if taken < len(batch):
            await asyncio.sleep(BUSY_PAUSE_S)
    await asyncio.sleep(BUSY_PAUSE_S)
    rows = await _list_blocks(robots[0])
    fullest = max(rows, key=lambda row: row.transaction_count)
    block = await _ask(robots[0], f"/v1/blocks/{fullest.height}", BlockAnswer)
    counts = {row.height: row.transaction_count for row in rows}
    window = max(counts, key=lambda first: sum(counts.get(first + offset, 0) for offset in range(PAGE_MAX_COUNT)))
    return Landmarks(window, fullest.height, block.txids[len(block.txids) // 2], fullest.block_id)


async def _list_blocks(robot: LoadRobot) -> list[BlockSummary]:
    rows: list[BlockSummary] = []
    while True:
        page = await _ask(robot, "/v1/blocks", BlocksAnswer, {"from_height": len(rows), "limit": PAGE_MAX_COUNT})
        rows += page.blocks
        if len(page.blocks) < PAGE_MAX_COUNT:
            return rows


async def _ask(robot: LoadRobot, path: str, kind: type[D], query: dict[str, str | int] | None = None) -> D:
    client = robot.client
    return read_answer(await client.ask_node(client.nodes[0], "GET", path, key=robot.key, query=query), kind)

"""Fills a measured network's blocks, making requests expensive."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from consensus.api_documents import PAGE_MAX_COUNT
from consensus.bounded_text import read_json_text
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
    fullest = max(rows, key=lambda row: int(row["transaction_count"]))
    block = await _ask(robots[0], f"/v1/blocks/{fullest['height']}", {})
    counts = {int(row["height"]): int(row["transaction_count"]) for row in rows}
    window = max(counts, key=lambda first: sum(counts.get(first + offset, 0) for offset in range(PAGE_MAX_COUNT)))
    txids = block["txids"]
    return Landmarks(window, int(fullest["height"]), txids[len(txids) // 2], fullest["block_id"])


async def _list_blocks(robot: LoadRobot) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    while True:
        page = await _ask(robot, "/v1/blocks", {"from_height": len(rows), "limit": PAGE_MAX_COUNT})
        rows += page["blocks"]
        if len(page["blocks"]) < PAGE_MAX_COUNT:
            return rows


async def _ask(robot: LoadRobot, path: str, query: dict[str, str | int]) -> dict[str, Any]:
    client = robot.client
    answer: dict[str, Any] = read_json_text(
        await client.ask_node(client.nodes[0], "GET", path, key=robot.key, query=query or None)
    )
    return answer

"""Latency of one call on an idle network, including receipt verification."""

from __future__ import annotations

import asyncio
import time

from msgspec import Struct

from consensus.errors import BlockRobotError
from network.bench.conditions import Result, latency_figures, measure_conditions
from network.bench.fresh_network import FreshNetwork, LoadRobot

PAUSE_MS = 50
WARM_UP_COUNT = 3


class LatencyFigures(Struct, frozen=True, kw_only=True):
    """How long calls took, from signing to verified finality."""

    p50_ms: float
    p95_ms: float
    p99_ms: float
    mean_ms: float
    count: int
    errors: int
    error_codes: dict[str, int]


async def run_latency_benchmark(*, count: int, nodes: int) -> Result[LatencyFigures]:
    conditions = measure_conditions(nodes=nodes, clients=1, pause_ms=PAUSE_MS, call="records.record")
    async with FreshNetwork(nodes) as network:
        (robot,) = await network.enrol_robots(1)
        values_ms, errors = await time_calls(robot, count)
    figures = LatencyFigures(
        **latency_figures(values_ms), count=len(values_ms), errors=sum(errors.values()), error_codes=errors
    )
    return Result(name="latency", ok=bool(values_ms) and not errors, figures=figures, conditions=conditions)


async def time_calls(robot: LoadRobot, count: int) -> tuple[list[float], dict[str, int]]:
    """Submit one call after another; return how long each took until it was proved final (ms), and errors by code."""
    values_ms: list[float] = []
    errors: dict[str, int] = {}
    for number in range(WARM_UP_COUNT + count):
        await asyncio.sleep(PAUSE_MS / 1000)
        started_s = time.perf_counter()
        try:
            (await robot.client.submit_and_wait(robot.sign_record())).require_ok()
        except BlockRobotError as error:
            errors[error.code] = errors.get(error.code, 0) + 1
            continue
        if number >= WARM_UP_COUNT:
            values_ms.append((time.perf_counter() - started_s) * 1000)
    return values_ms, errors

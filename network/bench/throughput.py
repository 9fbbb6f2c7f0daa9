"""Throughput and latency of `records.record` calls from many robots over HTTP."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field

from msgspec import Struct

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from network.bench.conditions import Result, latency_figures, measure_conditions
from network.bench.event_follower import FinalityFollower
from network.bench.fresh_network import FreshNetwork, LoadRobot

FINAL_TIMEOUT_S = 20.0
PRESIGNED_PER_SECOND_COUNT = 1_500
PRESIGNED_MAX_COUNT = 40_000


@dataclass(frozen=True, slots=True)
class LoadOptions:
    """Load: concurrent robots, duration, nodes, calls per request."""

    clients: int = 16
    seconds: float = 10.0
    nodes: int = 4
    batch: int = 16


@dataclass(slots=True)
class _Tally:
    latencies_ms: list[float] = field(default_factory=list)
    last_final_s: float = 0.0
    errors: dict[str, int] = field(default_factory=dict)
    signed_late_count: int = 0

    def error(self, code: str) -> None:
        self.errors[code] = self.errors.get(code, 0) + 1


class _Client:
    def __init__(self, robot: LoadRobot, follower: FinalityFollower, tally: _Tally, options: LoadOptions) -> None:
        self._robot = robot
        self._follower = follower
        self._tally = tally
        self._batch_count = options.batch
        wanted = min(PRESIGNED_MAX_COUNT, int(options.seconds * PRESIGNED_PER_SECOND_COUNT)) // options.clients
        self._signed = [robot.sign_record() for _ in range(max(wanted, options.batch))]

    def _next_batch(self) -> list[Transaction]:
        batch, self._signed = self._signed[: self._batch_count], self._signed[self._batch_count :]
        missing = self._batch_count - len(batch)
        self._tally.signed_late_count += missing
        return batch + [self._robot.sign_record() for _ in range(missing)]

    async def run(self, until_s: float) -> None:
        while time.perf_counter() < until_s:
            await self._submit(self._next_batch())

    async def _submit(self, batch: list[Transaction]) -> None:
        finals = self._follower.expect([transaction.txid for transaction in batch])
        started_s = time.perf_counter()
        try:
            refusals = await self._robot.client.submit_batch(batch)
        except BlockRobotError as error:
            refusals = [error] * len(batch)
        for transaction, refusal in zip(batch, refusals, strict=True):
            if refusal is not None:
                self._tally.error(refusal.code)
                self._follower.forget(transaction.txid)
                del finals[transaction.txid]
        if finals:
            await asyncio.wait(finals.values(), timeout=FINAL_TIMEOUT_S)
        for txid, future in finals.items():
            if not future.done():
                self._tally.error("TRANSACTION_NOT_FINAL_IN_TIME")
                self._follower.forget(txid)
                continue
            final_s = future.result()
            self._tally.latencies_ms.append((final_s - started_s) * 1000)
            self._tally.last_final_s = max(self._tally.last_final_s, final_s)


class TxFigures(Struct, frozen=True, kw_only=True):
    """`tps` spans first submission to last finality."""

    tps: float
    p50_ms: float
    p95_ms: float
    p99_ms: float
    mean_ms: float
    count: int
    errors: int
    error_codes: dict[str, int]
    signed_late_count: int


async def run_tx_benchmark(options: LoadOptions) -> Result[TxFigures]:
    """`ok` is False if a call failed."""
    conditions = measure_conditions(
        nodes=options.nodes,
        clients=options.clients,
        batch=options.batch,
        seconds=options.seconds,
        call="records.record",
    )
    tally = _Tally()
    async with FreshNetwork(options.nodes) as network:
        robots = await network.enrol_robots(options.clients)
        async with FinalityFollower(network.genesis, network.genesis.nodes[0], robots[0].key) as follower:
            clients = [_Client(robot, follower, tally, options) for robot in robots]
            started_s = time.perf_counter()
            await asyncio.gather(*(client.run(started_s + options.seconds) for client in clients))
    elapsed_s = tally.last_final_s - started_s
    count = len(tally.latencies_ms)
    figures = TxFigures(
        tps=round(count / elapsed_s, 1) if count else 0.0,
        **latency_figures(tally.latencies_ms),
        count=count,
        errors=sum(tally.errors.values()),
        error_codes=dict(sorted(tally.errors.items())),
        signed_late_count=tally.signed_late_count,
    )
    return Result(name="tx", ok=count > 0 and not tally.errors, figures=figures, conditions=conditions)

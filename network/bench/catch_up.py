"""Benchmark of block catch-up: a node killed and restarted under steady load."""

from __future__ import annotations

import asyncio
import shutil
import time
from dataclasses import dataclass, field
from datetime import datetime

import msgspec
from msgspec import Struct

from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.visible_text import split_lines
from network.bench.conditions import Result, measure_conditions
from network.bench.fresh_network import FreshNetwork, LoadRobot
from node.config import NodeConfig
from node.consensus.journal import Journal

ROBOTS_COUNT = 8
TICK_S = 0.05
CATCH_UP_TIMEOUT_S = 300.0
SETTLE_TIMEOUT_S = 30.0
REFERENCE_TPS = 100.0
_POLL_S = 0.05
_TOLERATED_LAG_BLOCKS = 8


@dataclass(frozen=True, slots=True)
class SyncOptions:
    """Downtime, call rate meanwhile, and whether the node returns empty."""

    seconds: float = 20.0
    rate: int = 100
    nodes: int = 4
    new: bool = False


@dataclass(slots=True)
class _Load:
    robots: list[LoadRobot]
    rate: int
    sent_count: int = 0
    errors: dict[str, int] = field(default_factory=dict)

    async def run(self) -> None:
        started_s = time.perf_counter()
        turn = 0
        while True:
            due = int((time.perf_counter() - started_s) * self.rate) - self.sent_count
            if due > 0:
                robot = self.robots[turn % len(self.robots)]
                turn += 1
                self.sent_count += due
                await self._submit(robot, due)
            await asyncio.sleep(TICK_S)

    async def _submit(self, robot: LoadRobot, count: int) -> None:
        try:
            refusals = await robot.client.submit_batch([robot.sign_record() for _ in range(count)])
        except BlockRobotError as error:
            refusals = [error] * count
        for refusal in refusals:
            if refusal is not None:
                self.errors[refusal.code] = self.errors.get(refusal.code, 0) + 1


class _NodeState(Struct, frozen=True):
    """What is asked of a node's status."""

    ready: bool
    finalized_height: int
    state_root: str


async def _states(network: FreshNetwork) -> dict[str, _NodeState]:
    reports = await network.cluster.status()
    return {report.name: msgspec.convert(report.status, _NodeState) for report in reports if report.status is not None}


def _head(states: dict[str, _NodeState], without: str) -> int:
    return max((row.finalized_height for name, row in states.items() if name != without), default=0)


async def _wait_caught_up(network: FreshNetwork, victim: str) -> bool:
    deadline_s = time.perf_counter() + CATCH_UP_TIMEOUT_S
    while time.perf_counter() < deadline_s:
        states = await _states(network)
        own = states.get(victim)
        if own is not None and own.ready and own.finalized_height >= _head(states, victim) - _TOLERATED_LAG_BLOCKS:
            return True
        await asyncio.sleep(_POLL_S)
    return False


async def _settle(network: FreshNetwork) -> bool:
    deadline_s = time.perf_counter() + SETTLE_TIMEOUT_S
    while time.perf_counter() < deadline_s:
        states = await _states(network)
        if len({row.finalized_height for row in states.values()}) == 1 and len(states) == len(network.genesis.nodes):
            return len({row.state_root for row in states.values()}) == 1
        await asyncio.sleep(_POLL_S)
    return False


def read_first_link(log: str, since: datetime) -> datetime | None:
    for line in split_lines(log):
        entry = read_json_text(line)
        at = datetime.fromisoformat(str(entry.get("timestamp")).replace("Z", "+00:00"))
        if at >= since and entry.get("event") == "peer_connected":
            return at
    return None


def _forget_chain(config: NodeConfig) -> None:
    shutil.rmtree(config.ledger_dir)
    config.journal_path.unlink()
    Journal.create(config.journal_path).close()


class SyncFigures(Struct, frozen=True, kw_only=True):
    """How fast a node caught up.

    `blocks_per_s` and `tps` while catching up; `catchup_ratio` against a chain at 100 calls/s; `restart_s` from process
    start to caught up.
    """

    blocks_per_s: float
    tps: float
    catchup_ratio: float
    restart_s: float
    catch_up_s: float
    blocks: int
    calls: int
    errors: int
    error_codes: dict[str, int]
    same_state: bool


async def run_sync_benchmark(options: SyncOptions) -> Result[SyncFigures]:
    """Let one node miss `seconds` of the chain; `ok` is False after any error or unequal states."""
    conditions = measure_conditions(
        nodes=options.nodes,
        clients=ROBOTS_COUNT,
        rate_tps=options.rate,
        seconds=options.seconds,
        begins_with="nothing" if options.new else "what it had",
        call="records.record",
    )
    async with FreshNetwork(options.nodes) as network:
        victim = network.genesis.nodes[-1].name
        enrolled = await network.enrol_robots(ROBOTS_COUNT)
        living = [robot for number, robot in enumerate(enrolled) if number % options.nodes != options.nodes - 1]
        load = _Load(living, options.rate)
        missed_from = 0 if options.new else (await _states(network))[victim].finalized_height
        await asyncio.to_thread(network.cluster.kill, victim)
        working = asyncio.create_task(load.run())
        await asyncio.sleep(options.seconds)
        missed_calls = load.sent_count
        if options.new:
            _forget_chain(network.cluster.config(victim))
        since = datetime.now().astimezone()
        started_s = time.perf_counter()
        network.cluster.start(victim)
        caught_up = await _wait_caught_up(network, victim)
        restart_s, caught_at = time.perf_counter() - started_s, datetime.now().astimezone()
        blocks = (await _states(network))[victim].finalized_height - missed_from
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)
        is_same = await _settle(network)
        log = await asyncio.to_thread(network.cluster.config(victim).log_path.read_text, encoding="utf-8")
    linked_at = read_first_link(log, since)
    catch_up_s = max(0.001, (caught_at - (linked_at or since)).total_seconds())
    calls_per_s = missed_calls / catch_up_s
    figures = SyncFigures(
        blocks_per_s=round(blocks / catch_up_s, 1),
        tps=round(calls_per_s, 1),
        catchup_ratio=round(calls_per_s / REFERENCE_TPS, 1),
        restart_s=round(restart_s, 2),
        catch_up_s=round(catch_up_s, 2),
        blocks=blocks,
        calls=missed_calls,
        errors=sum(load.errors.values()),
        error_codes=dict(sorted(load.errors.items())),
        same_state=is_same,
    )
    ok = caught_up and is_same and blocks > 0 and not load.errors
    return Result(name="sync", ok=ok, figures=figures, conditions=conditions)

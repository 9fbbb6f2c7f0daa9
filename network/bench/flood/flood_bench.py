"""Effect of floods on finality and `/status` latency: before, during, after."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType

import aiohttp
import msgspec
from msgspec import Struct

from clients.sdk.node_answers import D, read_answer
from consensus.api_documents import PAGE_MAX_COUNT, BlockAnswer, BlocksAnswer, BlockSummary
from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_TRANSACTIONS_MAX_COUNT
from consensus.visible_text import split_lines
from network.bench.conditions import Result, measure_conditions, percentile
from network.bench.event_follower import FinalityFollower
from network.bench.flood.flood_attacker import Orders, Sent
from network.bench.flood.flood_kinds import BATCH_COUNT, FRAMES, Identity
from network.bench.flood.flood_routes import CostlyTargets, kinds_of
from network.bench.fresh_network import FreshNetwork, LoadRobot
from network.cluster import fetch_status
from network.doctor.examination import examine_network
from node.mempool.mempool import BLOCK_SHARE_COUNT

RECORDS_COUNT = 4_096
FILLING_COUNT = BLOCK_TRANSACTIONS_MAX_COUNT // BLOCK_SHARE_COUNT
"""Robots that it takes to fill a block."""
BUSY_PAUSE_S = 0.5
NODES_COUNT = 4
INTERVAL_S = 0.05
STATUS_INTERVAL_S = 0.1
STATUS_TIMEOUT_S = 30.0
SETTLE_S = 5.0
"""Until custodians and streams have dealt with the full blocks: what is measured before that is not quiet."""
QUIET_S = 4.0
REST_S = 2.0
AFTER_S = 3.0
UNDECIDED_S = 0.5  # calls of the last moments may not be final yet
LOST_AFTER_S = 60.0
FINALITY_RATIO_GOAL = 5.0
STATUS_GOAL_MS = 1_000.0
NORMAL_RATIO_GOAL = 2.0
NOISE_MS = 50.0
"""So much later than in quiet is no sign of anything, on a machine that does other things too."""
FLOODS_OF_NETWORK_COUNT = 8
ATTACKERS_ADDRESS, FIRST_ADDRESS = "127.0.0.{}", 66
"""Each flood's own, and not that of honest clients: budgets tell them apart, and so do logs."""


async def fill_blocks(robots: Sequence[LoadRobot]) -> CostlyTargets:
    accepted = 0
    while accepted < RECORDS_COUNT:
        batch = [robots[place % len(robots)].sign_record() for place in range(BATCH_COUNT)]
        refusals = await robots[0].client.submit_batch(batch)
        accepted += (taken := refusals.count(None))
        if taken < len(batch):
            await asyncio.sleep(BUSY_PAUSE_S)
    await asyncio.sleep(SETTLE_S)
    rows = await _list_blocks(robots[0])
    fullest = max(rows, key=lambda row: row.transaction_count)
    block = await _ask(robots[0], f"/v1/blocks/{fullest.height}", BlockAnswer)
    counts = {row.height: row.transaction_count for row in rows}
    window = max(counts, key=lambda first: sum(counts.get(first + offset, 0) for offset in range(PAGE_MAX_COUNT)))
    return CostlyTargets(window, fullest.height, block.txids[len(block.txids) // 2], fullest.block_id)


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


@dataclass(frozen=True, slots=True)
class FloodOptions:
    """Who floods with which kinds (`all`: every possible one), and for how long each."""

    kind: str
    identity: Identity
    seconds: float


@dataclass(slots=True)
class _Latencies:
    """Latency per call; pending calls count up to `until_s`."""

    started_s: list[float] = field(default_factory=list)
    final_s: dict[int, float] = field(default_factory=dict)
    until_s: float = 0.0

    def between(self, from_s: float, until_s: float) -> list[float]:
        return [
            (self.final_s.get(place, self.until_s) - started_s) * 1000
            for place, started_s in enumerate(self.started_s)
            if from_s <= started_s < until_s
        ]

    def recovered_s(self, from_s: float, until_s: float, limit_ms: float) -> float | None:
        """Time until all calls submitted later were final in time."""
        late = [place for place, started_s in enumerate(self.started_s) if from_s <= started_s < until_s]
        for place in reversed(late):
            final_s = self.final_s.get(place)
            if final_s is None or (final_s - self.started_s[place]) * 1000 > limit_ms:
                return None if place == late[-1] else self.started_s[place + 1] - from_s
        return 0.0 if late else None


class _Watch:
    def __init__(self, network: FreshNetwork, robot: LoadRobot) -> None:
        self._network, self._robot = network, robot
        self._follower = FinalityFollower(network.genesis, network.genesis.nodes[0], robot.key)
        self._tasks: list[asyncio.Task[None]] = []
        self._calls: set[asyncio.Task[None]] = set()
        self.calls = _Latencies()
        self.status: list[tuple[float, float]] = []

    async def __aenter__(self) -> _Watch:
        await self._follower.__aenter__()
        self._tasks = [asyncio.create_task(self._submit()), asyncio.create_task(self._ask())]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for task in [*self._tasks, *self._calls]:
            task.cancel()
        await asyncio.gather(*self._tasks, *self._calls, return_exceptions=True)
        await self._follower.__aexit__(kind, error, trace)

    async def _submit(self) -> None:
        while True:
            task = asyncio.create_task(self._call())
            self._calls.add(task)
            task.add_done_callback(self._calls.discard)
            await asyncio.sleep(INTERVAL_S)

    async def _call(self) -> None:
        transaction = self._robot.sign_record()
        place = len(self.calls.started_s)
        self.calls.started_s.append(time.perf_counter())
        (future,) = self._follower.expect([transaction.txid]).values()
        while not future.done():
            with contextlib.suppress(BlockRobotError):
                await self._robot.client.submit_batch([transaction])
                break
            await asyncio.sleep(INTERVAL_S)
        self.calls.final_s[place] = await asyncio.wait_for(future, LOST_AFTER_S)

    async def _ask(self) -> None:
        timeout = aiohttp.ClientTimeout(total=STATUS_TIMEOUT_S)
        async with aiohttp.ClientSession(timeout=timeout) as session:
            while True:
                await asyncio.gather(*(self._ask_one(session, name) for name in self._network.cluster.names))
                await asyncio.sleep(STATUS_INTERVAL_S)

    async def _ask_one(self, session: aiohttp.ClientSession, name: str) -> None:
        started_s = time.perf_counter()
        await fetch_status(session, self._network.cluster.config(name))
        self.status.append((started_s, (time.perf_counter() - started_s) * 1000))

    def status_ms(self, from_s: float, until_s: float) -> list[float]:
        return [took_ms for started_s, took_ms in self.status if from_s <= started_s < until_s]


@dataclass(frozen=True, slots=True)
class _Attacker:
    names: tuple[str, ...]
    orders: Orders


@dataclass(frozen=True, slots=True)
class _Scene:
    network: FreshNetwork
    watched: LoadRobot
    attackers: list[LoadRobot]
    landmarks: CostlyTargets


async def _describe(scene: _Scene, options: FloodOptions, kind: str, own: int) -> _Attacker:
    network, robot, address = scene.network, scene.attackers[own], ATTACKERS_ADDRESS.format(FIRST_ADDRESS + own)
    cluster, genesis = network.cluster, network.genesis
    node = genesis.nodes[NODES_COUNT + own] if options.identity == "node" else genesis.nodes[0]
    async with aiohttp.ClientSession() as session:
        status = await fetch_status(session, cluster.config(cluster.names[0])) or {}
    orders = Orders(
        parent=os.getpid(),
        address=address,
        kind=kind,
        identity=options.identity,
        seconds=options.seconds,
        chain_id=genesis.chain_id.hex(),
        member=robot.key.public_key.hex(),
        key=robot.key.secret.hex(),
        epoch=status.get("epoch", 0),
        round=status.get("round", 1),
        head_id=genesis.block_id.hex(),
        name=node.name,
        keys=str(network.stolen_folder(node.name) / "keys"),
        own_port=node.p2p_port,
        api_ports={name: cluster.config(name).api_port for name in cluster.names},
        landmarks=scene.landmarks,
        p2p_ports=[cluster.config(name).p2p_port for name in cluster.names],
    )
    if options.identity == "node":
        return _Attacker((f'"peer": "{node.name}"', f"peer {node.name}", f"cut {node.name} off"), orders)
    own_names = () if options.identity == "stranger" else (f"session {robot.key.public_key.hex()}",)
    return _Attacker((f"loopback {address}", *own_names, f"member {robot.handle.hex()}"), orders)


async def _attack(orders: Orders) -> Sent:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "network.bench.flood.flood_attacker",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    try:
        output, _ = await process.communicate(msgspec.json.encode(orders))
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return msgspec.convert(read_json_text(output), Sent) if output else Sent()


class FloodGoals(Struct, frozen=True, kw_only=True):
    """Which goals were met."""

    finality: bool
    status: bool
    named: bool
    normal_after: bool


class Flood(Struct, frozen=True, kw_only=True):
    """What one kind of flood did to others."""

    kind: str
    quiet_p95_ms: float
    attack_p95_ms: float
    attack_max_ms: float
    ratio: float
    status_p95_ms: float
    status_max_ms: float
    after_p95_ms: float
    recovered_s: float | None
    named_in_log: bool
    named_by_doctor: bool
    sent: Sent
    goals: FloodGoals
    load: float


class FloodFigures(Struct, frozen=True, kw_only=True):
    """The worst of all floods, and the goals that were missed."""

    worst_ratio: float
    worst_status_ms: float
    missed: list[str]


class FloodResult(Result[FloodFigures], kw_only=True):
    """Also each flood."""

    floods: list[Flood]


@dataclass(frozen=True, slots=True)
class _Played:
    """One flood as it was seen. `quiet_ms`: of the calls before it."""

    kind: str
    calls: _Latencies
    quiet_ms: list[float]
    attack_s: tuple[float, float]
    status_ms: list[float]
    in_log: bool
    by_doctor: bool
    sent: Sent
    load: float

    def judge(self, quiet_ms: float) -> Flood:
        """`quiet_ms`: late calls' latency in quiet, of the whole run: a few seconds before a flood are noise."""
        (from_s, until_s), seen_until_s = self.attack_s, self.calls.until_s - UNDECIDED_S
        under = self.calls.between(from_s, until_s)
        after_ms = percentile(self.calls.between(until_s + REST_S, seen_until_s), 0.95)
        normal_ms = NORMAL_RATIO_GOAL * quiet_ms + NOISE_MS
        recovered_s = self.calls.recovered_s(until_s, seen_until_s, normal_ms)
        under_ms = percentile(under, 0.95)
        ratio, status_max_ms = round(under_ms / max(quiet_ms, 0.1), 2), round(max(self.status_ms, default=0.0), 1)
        return Flood(
            kind=self.kind,
            quiet_p95_ms=round(quiet_ms, 1),
            attack_p95_ms=round(under_ms, 1),
            attack_max_ms=round(max(under, default=0.0), 1),
            ratio=ratio,
            status_p95_ms=round(percentile(self.status_ms, 0.95), 1),
            status_max_ms=status_max_ms,
            after_p95_ms=round(after_ms, 1),
            recovered_s=None if recovered_s is None else round(recovered_s, 2),
            named_in_log=self.in_log,
            named_by_doctor=self.by_doctor,
            sent=self.sent,
            goals=FloodGoals(
                finality=ratio <= FINALITY_RATIO_GOAL,
                status=status_max_ms <= STATUS_GOAL_MS,
                named=(self.in_log and self.by_doctor) or (under_ms <= normal_ms and not self.sent.refused),
                normal_after=after_ms <= normal_ms,
            ),
            load=self.load,
        )


async def _play(scene: _Scene, options: FloodOptions, kind: str, own: int) -> _Played:
    network = scene.network
    async with _Watch(network, scene.watched) as watch:
        await asyncio.sleep(1.0)
        quiet_from_s = time.perf_counter()
        await asyncio.sleep(QUIET_S)
        attacker = await _describe(scene, options, kind, own)
        attack_from_s = time.perf_counter()
        sent = await _attack(attacker.orders)
        attack_until_s = time.perf_counter()
        await asyncio.sleep(REST_S + AFTER_S)
        watch.calls.until_s = time.perf_counter()
        findings = await asyncio.to_thread(examine_network, network.cluster.folder)
        logs = await asyncio.to_thread(_read_warnings, network)
        details = " ".join(finding.detail for finding in findings.findings)
        return _Played(
            kind=kind,
            calls=watch.calls,
            quiet_ms=watch.calls.between(quiet_from_s, attack_from_s),
            attack_s=(attack_from_s, attack_until_s),
            status_ms=watch.status_ms(attack_from_s, attack_until_s),
            in_log=any(name in logs for name in attacker.names),
            by_doctor=any(name in details for name in attacker.names),
            sent=sent,
            load=round(os.getloadavg()[0], 2),
        )


def _read_warnings(network: FreshNetwork) -> str:
    logs = (network.cluster.config(name).log_path.read_text() for name in network.cluster.names)
    return " ".join(line for log in logs for line in split_lines(log) if '"level": "warning"' in line)


def choose_kinds(options: FloodOptions) -> list[str]:
    """Raises REQUEST_INVALID for an unknown one."""
    known = kinds_of(options.identity)
    if options.kind == "all":
        return known
    chosen = [kind.strip() for kind in options.kind.split(",")]
    strange = [kind for kind in chosen if kind not in known]
    if strange:
        raise BlockRobotError("REQUEST_INVALID", f"A {options.identity} sends no {strange[0]!r}; --list shows what.")
    return chosen


async def run_flood_benchmark(options: FloodOptions, on_progress: Callable[[str], None]) -> FloodResult:
    """As a node, each kind uses another never started node's certificate."""
    kinds = choose_kinds(options)
    conditions = measure_conditions(nodes=NODES_COUNT, identity=options.identity, seconds=options.seconds)
    played: list[_Played] = []
    quiet_ms: list[float] = []
    for first in range(0, len(kinds), FLOODS_OF_NETWORK_COUNT):
        group = kinds[first : first + FLOODS_OF_NETWORK_COUNT]
        stolen = len(group) if group[0] in FRAMES and options.identity == "node" else 0
        async with FreshNetwork(NODES_COUNT, stolen=stolen) as network:
            watched, *others = await network.enrol_robots(1 + FILLING_COUNT + len(group))
            filling, attackers = others[:FILLING_COUNT], others[FILLING_COUNT:]
            scene = _Scene(network, watched, attackers, await fill_blocks(filling))
            for own, kind in enumerate(group):
                played.append(await _play(scene, options, kind, own))
                quiet_ms += played[-1].quiet_ms
                row = played[-1].judge(percentile(quiet_ms, 0.95))
                on_progress(f"{kind}: finality {row.ratio} times as late, /status {row.status_max_ms} ms at most")
    rows = [one.judge(percentile(quiet_ms, 0.95)) for one in played]
    met = [(row.kind, msgspec.structs.asdict(row.goals)) for row in rows]
    figures = FloodFigures(
        worst_ratio=max(row.ratio for row in rows),
        worst_status_ms=max(row.status_max_ms for row in rows),
        missed=sorted({f"{kind} {goal}" for kind, goals in met for goal, is_met in goals.items() if not is_met}),
    )
    return FloodResult(name="flood", ok=not figures.missed, figures=figures, conditions=conditions, floods=rows)

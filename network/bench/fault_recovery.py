"""Finality gaps of killed leaders, partitions and restarts, seen by a client."""

from __future__ import annotations

import asyncio
import statistics
import time
from dataclasses import dataclass, field

from msgspec import UNSET, Struct, UnsetType

from network.bench.conditions import Result, measure_conditions
from network.bench.finality_probe import FinalityProbe, longest_gap_s
from network.bench.fresh_network import FreshNetwork, LoadRobot
from network.demo.leader_kill import find_leader
from network.faults.actions import Heal, Partition
from network.faults.control import FaultControl

WARM_UP_S = 1.0
WATCH_S = 4.0
CUT_S = 3.0
HEAL_TIMEOUT_S = 30.0
CATCH_UP_TIMEOUT_S = 60.0
_POLL_S = 0.02


@dataclass(slots=True)
class _Seen:
    kill_gaps_s: list[float] = field(default_factory=list)
    restarts_s: list[float] = field(default_factory=list)
    heals_s: list[float] = field(default_factory=list)
    acknowledged_count: int = 0
    lost_count: int = 0
    not_in_time_count: int = 0
    errors: dict[str, int] = field(default_factory=dict)

    def note(self, values_s: list[float], value_s: float | None) -> None:
        if value_s is None:
            self.not_in_time_count += 1
        else:
            values_s.append(value_s)

    def add(self, probe: FinalityProbe, lost: int) -> None:
        self.acknowledged_count += probe.acknowledged_count
        self.lost_count += lost
        for code, count in probe.errors.items():
            self.errors[code] = self.errors.get(code, 0) + count


def _spread(name: str, values_s: list[float]) -> dict[str, float]:
    if not values_s:
        return {}
    return {f"{name}_s": round(statistics.median(values_s), 3), f"{name}_max_s": round(max(values_s), 3)}


async def _heights(network: FreshNetwork) -> dict[str, int]:
    reports = await network.cluster.status()
    return {report.name: int(report.status["finalized_height"]) for report in reports if report.status is not None}


async def _restart(network: FreshNetwork, name: str) -> float | None:
    goal = max((await _heights(network)).values())
    started_s = time.perf_counter()
    network.cluster.start(name)
    await network.cluster.wait_ready([name])
    while (await _heights(network)).get(name, 0) < goal:
        if time.perf_counter() > started_s + CATCH_UP_TIMEOUT_S:
            return None
        await asyncio.sleep(_POLL_S)
    return time.perf_counter() - started_s


async def watch_kill(
    network: FreshNetwork, victim: str, probe: FinalityProbe, warm_up_s: float, watch_s: float
) -> float:
    """Kill a node; return the longest time without finality in the seconds after it."""
    await asyncio.sleep(warm_up_s)
    killed_s = time.perf_counter()
    await asyncio.to_thread(network.cluster.kill, victim)
    await asyncio.sleep(watch_s)
    return longest_gap_s(probe.finals_s, killed_s, killed_s + watch_s)


async def _kill_leader(network: FreshNetwork, robots: dict[str, LoadRobot], seen: _Seen) -> None:
    victim = await find_leader(network.cluster)
    witness = next(node for node in network.genesis.nodes if node.name != victim)
    async with FinalityProbe(network.genesis, witness, robots[witness.name]) as probe:
        gap_s = await watch_kill(network, victim, probe, WARM_UP_S, WATCH_S)
        seen.note(seen.kill_gaps_s, gap_s if gap_s < WATCH_S else None)
        seen.note(seen.restarts_s, await _restart(network, victim))
        seen.add(probe, await probe.settle())


async def _cut_and_heal(network: FreshNetwork, robots: dict[str, LoadRobot], seen: _Seen) -> None:
    names = network.cluster.names
    half = len(names) // 2
    witness = network.genesis.nodes[0]
    control = FaultControl(network.cluster)
    async with FinalityProbe(network.genesis, witness, robots[witness.name]) as probe:
        await asyncio.sleep(WARM_UP_S)
        await control.carry_out(Partition((tuple(names[:half]), tuple(names[half:]))))
        await asyncio.sleep(CUT_S)
        await control.carry_out(Heal(()))
        healed_s = time.perf_counter()
        final_s = await probe.wait_final_after(healed_s, HEAL_TIMEOUT_S)
        seen.note(seen.heals_s, None if final_s is None else final_s - healed_s)
        seen.add(probe, await probe.settle())


class FaultFigures(Struct, frozen=True, kw_only=True):
    """Medians and maxima.

    `leader_kill_gap_s`: longest gap in the four seconds after SIGKILL of the leader; `restart_ready_s`: restart to
    caught up; `heal_gap_s`: partition end to first final call. What never came about in time is absent.
    """

    leader_kill_gap_s: float | UnsetType = UNSET
    leader_kill_gap_max_s: float | UnsetType = UNSET
    heal_gap_s: float | UnsetType = UNSET
    heal_gap_max_s: float | UnsetType = UNSET
    restart_ready_s: float | UnsetType = UNSET
    restart_ready_max_s: float | UnsetType = UNSET
    acknowledged_count: int
    lost_count: int
    not_in_time_count: int
    errors: int
    error_codes: dict[str, int]


async def run_faults_benchmark(*, repeats: int, nodes: int) -> Result[FaultFigures]:
    """`ok` is False after any loss, failure or timeout."""
    conditions = measure_conditions(nodes=nodes, clients=1, repeats=repeats, call="records.record")
    seen = _Seen()
    async with FreshNetwork(nodes, faults=True) as network:
        enrolled = await network.enrol_robots(nodes)
        robots = {node.name: robot for node, robot in zip(network.genesis.nodes, enrolled, strict=True)}
        for _ in range(repeats):
            await _kill_leader(network, robots, seen)
            await _cut_and_heal(network, robots, seen)
    figures = FaultFigures(
        **_spread("leader_kill_gap", seen.kill_gaps_s),
        **_spread("heal_gap", seen.heals_s),
        **_spread("restart_ready", seen.restarts_s),
        acknowledged_count=seen.acknowledged_count,
        lost_count=seen.lost_count,
        not_in_time_count=seen.not_in_time_count,
        errors=sum(seen.errors.values()),
        error_codes=dict(sorted(seen.errors.items())),
    )
    is_ok = not (seen.lost_count or seen.not_in_time_count or seen.errors)
    return Result(name="faults", ok=is_ok, figures=figures, conditions=conditions)

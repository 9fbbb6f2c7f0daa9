"""Plays many seeds on all cores."""

from __future__ import annotations

import hashlib
import time
import traceback
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass, field

import msgspec

from network.bench.cluster import check_seeds
from network.bench.conditions import count_cores
from network.bench.processes import worker_pool
from network.byzantine import BEHAVIOURS
from network.sim.checkers import Violation
from network.sim.history import Observation
from network.sim.plan import Plan, make_plan
from network.sim.run import RunResult, run_seed
from network.sim.shrink import shrink_plan

SEEDS_A_TASK_COUNT = 4
SHRUNK_MAX_COUNT = 3


class Failure(msgspec.Struct, frozen=True):
    """A failing plan, cut down, and what it broke."""

    seed: int
    plan: Plan
    shrunk: Plan
    violations: tuple[Violation, ...]


@dataclass
class SweepResult:
    """Totals over all seeds: CPU seconds, elapsed seconds, and each seed's trace hash."""

    seeds: int = 0
    rounds: int = 0
    blocks: int = 0
    frames: int = 0
    acknowledged: int = 0
    records: int = 0
    records_never_given: int = 0
    virtual_s: float = 0.0
    cpu_s: float = 0.0
    elapsed_s: float = 0.0
    traces: dict[int, str] = field(default_factory=dict)
    failed: list[RunResult] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)

    def add(self, result: RunResult) -> None:
        self.seeds += 1
        self.traces[result.seed] = result.trace
        self.rounds += result.rounds
        self.blocks += result.height
        self.frames += result.frames
        self.acknowledged += result.acknowledged
        self.records += result.records
        self.records_never_given += result.records_never_given
        self.virtual_s += result.virtual_ms / 1000
        self.cpu_s += result.cpu_s
        if not result.ok:
            self.failed.append(result)

    @property
    def trace(self) -> str:
        traces_text = " ".join(f"{seed}={trace}" for seed, trace in sorted(self.traces.items()))
        return hashlib.blake2b(traces_text.encode(), digest_size=16).hexdigest()

    @property
    def violations(self) -> int:
        return sum(len(result.violations) for result in self.failed)


def plan_of(seed: int, nodes: int, rounds: int, byzantine: int) -> Plan:
    return make_plan(seed, nodes=nodes, rounds=rounds, byzantine=byzantine, behaviours=tuple(sorted(BEHAVIOURS)))


def play(plan: Plan, listener: Callable[[Observation], None] | None = None) -> RunResult:
    try:
        return run_seed(plan, listener=listener)
    except Exception as error:  # noqa: BLE001 - reported with its seed
        place = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{error!r} at {place.name}, line {place.lineno} of {place.filename}"
        violation = Violation("simulator", 0.0, -1, text)
        return RunResult(plan.seed, "", (violation,), 0, 0, 0, 0, 0.0, 0.0)


def _play_all(plans: list[Plan]) -> list[RunResult]:
    return [play(plan) for plan in plans]


def sweep(
    plans: list[Plan],
    *,
    workers: int | None = None,
    on: str = "",
    on_progress: Callable[[SweepResult, int], None] | None = None,
    on_shrink: Callable[[int], None] | None = None,
) -> SweepResult:
    """Play all plans in `workers` processes (default: all cores) or on a cluster; shrink the first failing ones.

    Raises CLUSTER_RESULT_FOREIGN.
    """
    started_s = time.perf_counter()
    total = SweepResult()
    handfuls = [plans[start : start + SEEDS_A_TASK_COUNT] for start in range(0, len(plans), SEEDS_A_TASK_COUNT)]
    count = min(workers or count_cores(), len(handfuls))
    if count <= 1 and not on:
        for handful in handfuls:
            _take(total, _play_all(handful), handful, started_s)
            if on_progress is not None:
                on_progress(total, len(plans))
    else:
        with worker_pool(count, on) as pool:
            tasks = {pool.submit(_play_all, handful): handful for handful in handfuls}
            for task in as_completed(tasks):
                _take(total, task.result(), tasks[task], started_s)
                if on_progress is not None:
                    on_progress(total, len(plans))
    total.failed.sort(key=lambda result: result.seed)
    by_seed = {plan.seed: plan for plan in plans}
    for result in total.failed[:SHRUNK_MAX_COUNT]:
        if on_shrink is not None:
            on_shrink(result.seed)
        plan = by_seed[result.seed]
        shrunk, found = shrink_plan(plan, result, play)
        total.failures.append(Failure(result.seed, plan, shrunk, found.violations))
    return total


def _take(total: SweepResult, results: list[RunResult], plans: list[Plan], started_s: float) -> None:
    check_seeds([result.seed for result in results], [plan.seed for plan in plans])
    for result in results:
        total.add(result)
    total.elapsed_s = time.perf_counter() - started_s

"""Plays one plan and checks its history."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec

from network.sim.checkers import CHECKERS, Violation
from network.sim.history import ClipTaken, CodeFault, CustodyAudit, Ended, History, Observation
from network.sim.plan import Plan
from network.sim.world.sim_cluster import SimCluster, quiet_logs

Mutation = Callable[[SimCluster], None]


class RunResult(msgspec.Struct, frozen=True):
    """Result of one run; times are CPU seconds, `trace` hashes the history.

    `records_never_given`: on the chain, but no custodian got their clip.
    """

    seed: int
    trace: str
    violations: tuple[Violation, ...]
    rounds: int
    height: int
    frames: int
    acknowledged: int
    virtual_ms: float
    cpu_s: float
    records: int = 0
    records_never_given: int = 0

    @property
    def ok(self) -> bool:
        return not self.violations


def run_seed(
    plan: Plan, *, mutate: Mutation | None = None, listener: Callable[[Observation], None] | None = None
) -> RunResult:
    """`mutate` may change the cluster before it starts."""
    return run_with_history(plan, mutate=mutate, listener=listener)[0]


def run_with_history(
    plan: Plan, *, mutate: Mutation | None = None, listener: Callable[[Observation], None] | None = None
) -> tuple[RunResult, History]:
    started_s = time.process_time()
    history = History(listener)
    with quiet_logs() as logged, _no_collection():
        cluster = SimCluster(plan, history)
        if mutate is not None:
            mutate(cluster)
        cluster.run()
    for text in dict.fromkeys(logged):
        history.add(CodeFault(cluster.now, -1, text))
    violations = tuple(violation for check in CHECKERS.values() for violation in check(history))
    ended = history.of(Ended)[-1]
    recorded = {record_id for audit in history.of(CustodyAudit) for record_id in audit.chain_recorded}
    result = RunResult(
        seed=plan.seed,
        trace=history.trace_hash,
        violations=violations,
        rounds=cluster.rounds,
        height=max(ended.heights),
        frames=cluster.wires.frames_count,
        acknowledged=sum(client.acknowledged_count for client in cluster.clients),
        virtual_ms=ended.at_ms,
        cpu_s=time.process_time() - started_s,
        records=len(recorded),
        records_never_given=len(recorded - {taken.record_id for taken in history.of(ClipTaken)}),
    )
    return result, history


@contextmanager
def _no_collection() -> Iterator[None]:
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()

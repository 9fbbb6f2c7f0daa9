"""`python -m tests.benchmarks.cluster_rate [TURNS [SEEDS]]`: how many seeds a cluster's workers play beside processes.

By turns, the same seeds, both pools warm. Judge it on an idle machine, since Dask keeps house by
the clock, and with 16 seeds at least, of which each worker gets some to be warm.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

import dask
import psutil
from distributed import Client, Security

from network.bench.cluster import cluster_pool
from network.bench.processes import worker_pool
from network.sim.run import RunResult
from network.sim.sweep import SEEDS_A_TASK_COUNT, _play_all, plan_of
from tests.benchmarks.dask_processes import dask_processes, write_configuration

TURNS_COUNT = 4
WORKERS_COUNT = 2
SEEDS_A_TURN_COUNT, ROUNDS_COUNT = 16, 40


@dataclass
class Spent:
    """What all turns of one pool took: seconds, and CPU seconds of all its processes and of those within seeds."""

    elapsed_s: float = 0.0
    cpu_s: float = 0.0
    in_seeds_s: float = 0.0


def family_of(pids: Iterable[int]) -> set[int]:
    return {
        member.pid for pid in pids for member in (psutil.Process(pid), *psutil.Process(pid).children(recursive=True))
    }


def cpu_of(pids: Iterable[int]) -> float:
    return sum(sum(psutil.Process(pid).cpu_times()[:2]) for pid in pids)


def play_turn(pool: Executor, first: int, count: int) -> list[RunResult]:
    seeds = range(first, first + count)
    plans = [plan_of(seed, 4, ROUNDS_COUNT, 0) for seed in seeds]
    handfuls = [plans[at : at + SEEDS_A_TASK_COUNT] for at in range(0, len(plans), SEEDS_A_TASK_COUNT)]
    return [
        found for task in as_completed([pool.submit(_play_all, some) for some in handfuls]) for found in task.result()
    ]


def measure(folder: Path, turns: int, seeds: int) -> dict[str, object]:
    members = write_configuration(folder / "members")
    dask.config.refresh(paths=[str(members)])
    try:
        with dask_processes(folder / "dask", members) as cluster:
            worker = cluster.start_worker("--nworkers", str(WORKERS_COUNT))
            with Client(cluster.address, security=Security(require_encryption=True), set_as_default=False) as watcher:
                cluster.workers(watcher, WORKERS_COUNT)
            with worker_pool(WORKERS_COUNT) as here, cluster_pool(cluster.address) as there:
                pools = [(here, Spent()), (there, Spent())]
                for pool, _ in pools:
                    play_turn(pool, 0, seeds)
                of_cluster = family_of([cluster.scheduler.pid, worker.pid])
                of_processes = family_of([os.getpid()]) - of_cluster - {os.getpid()}
                for turn in range(turns):
                    for pool, spent in pools if turn % 2 else reversed(pools):
                        pids = {os.getpid(), *(of_processes if pool is here else of_cluster)}
                        cpu_s, started_s = cpu_of(pids), time.perf_counter()
                        played = play_turn(pool, 1000 + turn * seeds, seeds)
                        spent.elapsed_s += time.perf_counter() - started_s
                        spent.cpu_s += cpu_of(pids) - cpu_s
                        spent.in_seeds_s += sum(found.cpu_s for found in played)
    finally:
        dask.config.refresh()
    (_, processes), (_, workers) = pools
    return {
        "processes": asdict(processes),
        "workers": asdict(workers),
        "rate_share": round(processes.elapsed_s / workers.elapsed_s, 3),
        "cpu_share": round(processes.cpu_s / workers.cpu_s, 3),
        "cores_lost": round((workers.cpu_s - processes.cpu_s) / workers.elapsed_s, 4),
        "load": os.getloadavg()[0],
    }


def main() -> None:
    given = [int(word) for word in sys.argv[1:]]
    turns, seeds = (*given, *(TURNS_COUNT, SEEDS_A_TURN_COUNT)[len(given) :])
    with tempfile.TemporaryDirectory() as folder:
        sys.stdout.write(json.dumps(measure(Path(folder), turns, seeds), indent=2) + "\n")


if __name__ == "__main__":
    main()

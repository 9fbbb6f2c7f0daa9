"""Seeds on Dask's workers, over mutual TLS: the same results as at home, whatever becomes of the workers."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlsplit

import dask
import pytest
from distributed import Client, Security

from consensus.errors import BlockRobotError
from network.bench.cluster import cluster_pool
from network.bench.processes import worker_pool
from network.lab.privacy.attacks.attacks_on_all import attack_all_schemes
from network.lab.privacy.attacks.evidence import gather
from network.lab.privacy.attacks.learner import has_boosting
from network.lab.privacy.hospital.attacked_custodian import keep_last_day
from network.lab.privacy.hospital.attacked_days import play
from network.lab.privacy.hospital.population import draw_population
from network.lab.privacy.limits_table import limits_of
from network.sim.sweep import plan_of, sweep
from tests.benchmarks.dask_processes import ROOT, START_MAX_S, DaskProcesses, dask_processes, write_configuration
from tests.benchmarks.long_work import refuse, work_briefly

KILL_EVERY_S = 5.0
KILLED_MIN_COUNT = 3
SETTING = "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"
PACKAGES = ("consensus", "contracts", "node", "clients", "network", "pages")
OTHER_SEEDS = """
from network.sim import sweep
sweep.play = lambda plan: sweep.run_seed(sweep.plan_of(plan.seed + 1, 1, 10, 0))
"""
pytestmark = pytest.mark.timeout(900)


@pytest.fixture(scope="module")
def members(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The configuration of the cluster's machines; this process has it too."""
    folder = write_configuration(tmp_path_factory.mktemp("cluster") / "members")
    dask.config.refresh(paths=[str(folder)])
    yield folder
    dask.config.refresh()


@pytest.fixture
def cluster(tmp_path: Path, members: Path) -> Iterator[DaskProcesses]:
    with dask_processes(tmp_path / "dask", members) as started:
        yield started


@pytest.fixture
def watcher(cluster: DaskProcesses) -> Iterator[Client]:
    with Client(cluster.address, security=Security(require_encryption=True), set_as_default=False) as client:
        yield client


def run_seeds(cluster: DaskProcesses, *options: str, configuration: Path | None = None) -> subprocess.Popen[str]:
    environment = cluster.environment | ({"DASK_CONFIG": str(configuration)} if configuration else {})
    words = ["-m", "network.cli.main", "sim", "run", "--on", cluster.address, *options]
    return subprocess.Popen([sys.executable, *words], cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True)


def test_workers_that_are_killed_lose_nothing(tmp_path: Path, members: Path) -> None:
    """Dask gives up a task whose worker died; it is sent again."""
    plans = [plan_of(seed, 4, 10, seed % 2) for seed in range(200, 320)]
    killed, over = list[int](), threading.Event()
    with dask_processes(tmp_path / "dask", members, **{SETTING: "0"}) as cluster:
        cluster.start_worker("--nworkers", "2")
        with Client(cluster.address, security=Security(require_encryption=True), set_as_default=False) as watcher:
            cluster.workers(watcher, 2)

            def kill() -> None:
                while not over.wait(KILL_EVERY_S):
                    pids = sorted(set(watcher.run(os.getpid, on_error="ignore").values()) - set(killed))
                    if pids:
                        os.kill(pids[0], signal.SIGKILL)
                        killed.append(pids[0])

            killer = threading.Thread(target=kill)
            killer.start()
            try:
                on_workers = sweep(plans, on=cluster.address)
            finally:
                over.set()
                killer.join()
    assert len(killed) >= KILLED_MIN_COUNT
    here, in_processes = sweep(plans[:20], workers=1), sweep(plans, workers=2)
    assert on_workers.traces == in_processes.traces
    assert here.traces.items() <= on_workers.traces.items()
    assert on_workers.failed == []


def test_attacks_find_the_same_at_home_in_processes_and_on_workers(
    cluster: DaskProcesses, watcher: Client, tmp_path: Path
) -> None:
    """On what was played once: keys are drawn anew each time, and with them what a guess finds."""
    cluster.start_worker("--nworkers", "2")
    cluster.workers(watcher, 2)
    played = play(draw_population(3, people=10, days=3, serial_bits=10), tmp_path / "hospital", seed=3)
    evidence = gather(played, seed=3, boosting=has_boosting())
    custody = keep_last_day(played, tmp_path / "hospital" / "custodian")

    def attack(pool: Executor) -> object:
        wait = attack_all_schemes(evidence, pool, lambda _: None)
        limits = limits_of(evidence, custody, pool, lambda _: None)
        return wait()[0], limits

    with ThreadPoolExecutor(1) as here, worker_pool(2) as processes, cluster_pool(cluster.address) as workers:
        at_home, in_processes, on_workers = map(attack, (here, processes, workers))
    assert at_home == in_processes == on_workers


def test_a_worker_that_comes_late_gets_work(cluster: DaskProcesses, watcher: Client) -> None:
    cluster.start_worker()
    (first,) = cluster.workers(watcher, 1).values()
    with cluster_pool(cluster.address) as pool:
        work = [pool.submit(work_briefly, number) for number in range(100)]
        assert work[0].result() == first
        cluster.start_worker()
        both = set(cluster.workers(watcher, 2).values())
        assert {job.result() for job in work} == both


def test_what_a_call_raises_is_raised_here(cluster: DaskProcesses, watcher: Client) -> None:
    """However deep it was raised, and if it cannot be sent."""
    cluster.start_worker()
    cluster.workers(watcher, 1)
    with cluster_pool(cluster.address) as pool:
        with pytest.raises(ValueError, match="invalid literal"):
            pool.submit(int, "x").result(START_MAX_S)
        with pytest.raises(RecursionError):
            pool.submit(eval, "(lambda f: f(f))(lambda f: f(f))").result(START_MAX_S)
        with pytest.raises(TypeError, match="annot pickle"):
            pool.submit(eval, "(_ for _ in ())").result(START_MAX_S)
        with pytest.raises(BlockRobotError, match="NODE_GONE") as refusal:
            pool.submit(refuse, "CLUSTER_UNREACHABLE", "NODE_GONE").result(START_MAX_S)
        assert refusal.value.code == "CLUSTER_UNREACHABLE"
        assert pool.submit(abs, -3).result(START_MAX_S) == 3


def test_ctrl_c_leaves_nothing_running(cluster: DaskProcesses, watcher: Client) -> None:
    cluster.start_worker("--nworkers", "2")
    before = set(cluster.workers(watcher, 2).values())
    child = run_seeds(cluster, "--seeds", "1..400", "--rounds", "5000")
    try:
        cluster.wait_for(lambda: all(watcher.processing().values()))
        child.send_signal(signal.SIGINT)
        child.communicate(timeout=START_MAX_S)
        assert child.returncode not in {0, None}
    finally:
        child.kill()
    assert not any(watcher.processing().values())
    assert not before & set(cluster.workers(watcher, 2).values())
    assert sweep([plan_of(1, 4, 10, 0)], on=cluster.address).seeds == 1


def test_a_stranger_runs_nothing(cluster: DaskProcesses, watcher: Client, tmp_path: Path) -> None:
    cluster.start_worker()
    cluster.workers(watcher, 1)
    ((address, worker),) = watcher.scheduler_info(n_workers=-1)["workers"].items()
    for place in (cluster.address, address, worker["nanny"]):
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        url = urlsplit(place)
        secure = context.wrap_socket(socket.create_connection((url.hostname, url.port)))
        with secure, pytest.raises((ssl.SSLError, ConnectionError)):
            secure.recv(1)  # in TLS 1.3 the client is done before its certificate is missed
        with pytest.raises(OSError, match=r"(?i)connect"):
            Client(place.replace("tls:", "tcp:"), security=Security(require_encryption=False), timeout=5)
    child = run_seeds(cluster, "--seeds", "1", configuration=write_configuration(tmp_path / "strangers"))
    _, said = child.communicate(timeout=START_MAX_S)
    assert "CLUSTER_UNREACHABLE" in said
    assert child.returncode not in {0, None}
    assert watcher.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.transition_log)) == 0


def test_a_worker_with_more_threads_is_refused_before_the_first_task(cluster: DaskProcesses, watcher: Client) -> None:
    cluster.start_worker("--nthreads", "2")
    cluster.workers(watcher, 1)
    with pytest.raises(BlockRobotError, match="has threads 2, not 1") as refusal, cluster_pool(cluster.address):
        pytest.fail("work began")
    assert refusal.value.code == "WORKER_UNLIKE"


def test_a_worker_of_another_source_is_refused_when_it_comes(
    cluster: DaskProcesses, watcher: Client, tmp_path: Path
) -> None:
    for package in (*PACKAGES, "tests"):
        shutil.copytree(ROOT / package, tmp_path / "other" / package, ignore=shutil.ignore_patterns("__pycache__"))
    changed = tmp_path / "other" / "network" / "sim" / "plan.py"
    changed.write_text(changed.read_text().replace("PLAN_MS_PER_ROUND = 22", "PLAN_MS_PER_ROUND = 23"))
    cluster.start_worker()
    cluster.workers(watcher, 1)

    def work() -> None:
        with cluster_pool(cluster.address) as pool:
            cluster.start_worker(source=tmp_path / "other")
            list(pool.map(work_briefly, range(200)))

    with pytest.raises(BlockRobotError, match="has source") as refusal:
        work()
    assert refusal.value.code == "WORKER_UNLIKE"


def test_the_result_of_another_seed_is_noticed(cluster: DaskProcesses, watcher: Client, tmp_path: Path) -> None:
    (tmp_path / "other_seeds.py").write_text(OTHER_SEEDS)
    cluster.start_worker("--preload", str(tmp_path / "other_seeds.py"))
    cluster.workers(watcher, 1)
    with pytest.raises(BlockRobotError) as refusal:
        sweep([plan_of(7, 1, 10, 0)], on=cluster.address)
    assert refusal.value.code == "CLUSTER_RESULT_FOREIGN"

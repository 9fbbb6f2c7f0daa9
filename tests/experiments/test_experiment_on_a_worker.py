"""An experiment on a worker of a cluster: its folder comes back to where it would be at home, and nothing stays there.

Whether its checks hold follows from the machine, and is tested at home.
"""

from __future__ import annotations

import json
from pathlib import Path

import dask
import pytest

from network.cluster import Cluster
from network.demo.checks import Check
from network.experiments.definitions import Experiment
from network.experiments.out_folder import MARK, reserved_out
from tests.benchmarks.dask_processes import dask_processes, write_configuration
from tests.experiments.short_run import run_short

SECONDS = 4.0


@pytest.mark.asyncio
@pytest.mark.timeout(600)
async def test_a_run_on_a_worker_leaves_here_what_it_leaves_at_home(tmp_path: Path) -> None:
    members, home = write_configuration(tmp_path / "members"), tmp_path / "worker"
    dask.config.refresh(paths=[str(members)])
    shown: list[tuple[str, bool]] = []

    def show(_: Experiment, check: Check) -> None:
        shown.append((check.name, check.ok))

    try:
        with dask_processes(tmp_path / "dask", members, BLOCKROBOT_HOME=str(home)) as cluster:
            cluster.start_worker()
            result = await run_short(tmp_path, SECONDS, show, cluster.address)
            left = [path for path in (home / "on-worker").rglob("*") if path.is_file()]
            assert left == [home / "on-worker" / MARK]
    finally:
        dask.config.refresh()
    figures = result["figures"]["experiment-2"]
    assert shown
    assert figures["checks_failed"] == [name for name, ok in shown if not ok]
    assert figures["checks_held"] == sum(ok for _, ok in shown)
    folder = tmp_path / "out" / "experiment-2"
    assert json.loads((folder / "summary.json").read_text(encoding="utf-8")) == figures
    assert (folder / "report.html").is_file()
    assert (folder / "network" / "genesis.json").is_file()
    with reserved_out(tmp_path / "out"):  # it knows all that came as its own
        pass
    nodes = Cluster(folder / "network")
    assert [name for name in nodes.names if nodes.is_running(name)] == []

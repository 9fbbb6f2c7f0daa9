"""A network's folder and its nodes, none of which runs: what is said then."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.cli.main import main
from network.cluster import Cluster
from network.provisioning.network_layout import create_network
from node.faults import STATE_FILE_NAME

BASE_PORT = 45_670


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("network") / "n"
    create_network(folder, nodes=4, base_port=BASE_PORT)
    return folder


@pytest.fixture
def cluster(made: Path) -> Cluster:
    (made / "cluster.json").unlink(missing_ok=True)
    return Cluster(made)


def refusal_of(error: pytest.ExceptionInfo[BlockRobotError]) -> str:
    return error.value.code


def test_an_empty_folder_holds_no_network(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(BlockRobotError) as caught:
            Cluster(folder)
        assert refusal_of(caught) == "CLUSTER_NOT_RUNNING"


def test_of_a_network_that_runs_the_nodes_that_are_down_are_started_with_their_faults(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    running: set[str] = set()
    monkeypatch.setattr(cluster, "is_running", running.__contains__)
    monkeypatch.setattr(cluster, "start", running.add)
    faults = cluster.config("node-3").data_dir / STATE_FILE_NAME
    faults.write_text("{}")
    assert cluster.start_all() == cluster.names
    assert not faults.exists()
    with pytest.raises(BlockRobotError) as caught:
        cluster.start_all()
    assert refusal_of(caught) == "CLUSTER_ALREADY_RUNNING"
    running -= {"node-3", "node-4"}
    faults.write_text("{}")
    assert cluster.start_all() == ["node-3", "node-4"]
    assert running == set(cluster.names)
    assert faults.exists()
    faults.unlink()


async def test_a_cluster_knows_its_nodes_and_a_dead_one_has_no_status(cluster: Cluster) -> None:
    assert cluster.names == ["node-1", "node-2", "node-3", "node-4"]
    assert [cluster.config(name).p2p_port for name in cluster.names] == [BASE_PORT + 10 * i for i in range(4)]
    with pytest.raises(BlockRobotError) as caught:
        cluster.config("node-9")
    assert refusal_of(caught) == "NOT_FOUND"
    reports = await cluster.status()
    assert [(report.name, report.running, report.status) for report in reports] == [
        (name, False, None) for name in cluster.names
    ]
    cluster.stop("node-2")
    assert cluster.stop_all() == []
    assert cluster.latest_messages("node-3") == "it printed nothing."


@pytest.mark.parametrize("content", ["[]", "7", "{", "<html></html>"])
async def test_who_answers_at_a_nodes_port_in_another_form_is_not_the_node(cluster: Cluster, content: str) -> None:
    async def answer(_request: web.Request) -> web.Response:
        return web.Response(text=content, content_type="application/json")

    application = web.Application()
    application.router.add_get("/status", answer)
    async with TestServer(application, host="127.0.0.1") as server:
        cluster.configs["node-1"] = replace(cluster.config("node-1"), operator_port=server.port or 0)
        assert [report.status for report in await cluster.status()] == [None] * 4


def test_a_stranger_with_a_nodes_old_number_is_not_taken_for_the_node(cluster: Cluster) -> None:
    """Numbers of processes come round again: this test's own process must survive a `down`."""
    (cluster.folder / "cluster.json").write_text(json.dumps({"pids": {"node-1": os.getpid()}}), encoding="utf-8")
    assert not cluster.is_running("node-1")
    assert cluster.stop_all() == []
    cluster.kill("node-1")


def test_one_node_is_stopped_and_the_others_run_on(cluster: Cluster) -> None:
    sleeping = [sys.executable, "-c", "import time; time.sleep(60)"]
    nodes = {name: subprocess.Popen([*sleeping, str(cluster.config(name).data_dir)]) for name in ("node-1", "node-2")}
    pids = {name: process.pid for name, process in nodes.items()}
    (cluster.folder / "cluster.json").write_text(json.dumps({"pids": pids}), encoding="utf-8")
    for name, process in nodes.items():
        cluster._children[name] = process
    down = ["down", "--dir", str(cluster.folder), "--json"]
    try:
        assert CliRunner().invoke(main, [*down, "node-2", "node-9"]).exit_code == 3, "NOT_FOUND"
        assert nodes["node-2"].poll() is None, "all names are read first"
        assert cluster.stop_all(["node-2", "node-3"]) == ["node-2"]
        assert (nodes["node-1"].poll(), cluster.is_running("node-1")) == (None, True)
        assert cluster.stop_all() == ["node-1"]
    finally:
        for process in nodes.values():
            process.kill()
            process.wait()


@pytest.mark.parametrize("content", ["", "{", "[]", '{"pids": 7}', '{"pids": {"node-1": "x"}}'])
def test_a_damaged_list_of_processes_is_as_good_as_none(cluster: Cluster, content: str) -> None:
    (cluster.folder / "cluster.json").write_text(content, encoding="utf-8")
    assert not cluster.is_running("node-1")
    assert cluster.stop_all() == []


async def test_waiting_for_a_node_that_died_ends_at_once_with_its_last_words(cluster: Cluster) -> None:
    (cluster.config("node-1").data_dir / "output.log").write_text("first\nno disk\n", encoding="utf-8")
    with pytest.raises(BlockRobotError) as caught:
        await cluster.wait_ready(["node-1"])
    assert refusal_of(caught) == "CLUSTER_START_FAILED"
    assert "no disk" in caught.value.detail


async def test_a_node_that_takes_long_to_start_has_not_failed(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "is_running", lambda _name: True)
    with pytest.raises(BlockRobotError) as caught:
        await cluster.wait_answering("node-1", timeout_s=0)
    assert refusal_of(caught) == "NODE_STILL_STARTING"


def test_no_key_of_the_network_is_readable_by_others(made: Path) -> None:
    secret = [path for path in made.rglob("*") if path.name.endswith((".key", "key.pem"))]
    assert len(secret) >= 4 * 2 + 2 * 3
    assert {path.stat().st_mode & 0o777 for path in secret} == {0o600}


def test_a_network_is_the_same_however_its_folder_is_named(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / "link"
    link.symlink_to(cluster.folder, target_is_directory=True)
    monkeypatch.chdir(cluster.folder.parent)
    for named in (Path(cluster.folder.name), Path("nowhere/..") / cluster.folder.name, link):
        assert {name: each.data_dir for name, each in Cluster(named).configs.items()} == {
            name: each.data_dir for name, each in cluster.configs.items()
        }


_HOLDER = """
import fcntl, sys, time
file = open(sys.argv[2] + "/lock", "w")
fcntl.flock(file, fcntl.LOCK_EX)
memory = b"x" * (128 << 20)
print("held", flush=True)
time.sleep(60)
"""


def test_a_killed_process_counts_as_running_until_its_locks_are_free(cluster: Cluster) -> None:
    """The kernel frees a process's memory first: for a moment it has no command line, and still its files."""
    data_dir = cluster.config("node-1").data_dir
    command = [sys.executable, "-c", _HOLDER, "--data-dir", str(data_dir)]
    for _ in range(5):
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process, (data_dir / "lock").open("w") as file:
            assert process.stdout is not None
            assert process.stdout.readline() == b"held\n"
            (cluster.folder / "cluster.json").write_text(
                json.dumps({"pids": {"node-1": process.pid}}), encoding="utf-8"
            )
            assert cluster.is_running("node-1")
            process.kill()
            while cluster.is_running("node-1"):
                pass
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

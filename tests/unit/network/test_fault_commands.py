"""`blockrobot fault` on a network that is down: what can be said is said, what cannot be done is refused by code."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from consensus.errors import CATALOGUE, BlockRobotError
from network.byzantine.process import ByzantineNode
from network.byzantine.process import main as run_liar
from network.cli.main import main
from network.cluster import Cluster
from network.provisioning.network_layout import create_network
from node.config import load_config
from node.faults import STATE_FILE_NAME

PLAN = """
seed = 3
[[step]]
at = "1s"
do = "kill"
node = "node-1"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fault-commands") / "network"
    create_network(folder, nodes=2, organisations=1, base_port=46_910, faults=True)
    return folder


def _run(folder: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["fault", *arguments, "--dir", str(folder)])


def _problem(result: Result) -> dict[str, Any]:
    assert result.exit_code != 0
    problem: dict[str, Any] = json.loads(result.stdout)["error"]
    assert problem["next_step"] == CATALOGUE[problem["code"]].next_step
    return problem


def test_what_is_on_is_listed_also_for_nodes_that_are_down(folder: Path) -> None:
    answer = json.loads(_run(folder, "list", "--json").stdout)
    assert [(node["name"], node["running"], node["faults"]) for node in answer["nodes"]] == [
        ("node-1", False, ["down"]),
        ("node-2", False, ["down"]),
    ]
    assert "node-2" in _run(folder, "list").stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["kill", "node-1"],
        ["pause", "node-1"],
        ["resume", "node-1"],
        ["partition", "node-1"],
        ["heal"],
        ["link", "node-1", "node-2", "--profile", "wan"],
        ["link", "node-1<->node-2"],
        ["skew", "node-1", "-1h"],
        ["disk", "node-1", "full"],
        ["byzantine", "node-1", "equivocate"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_nothing_is_broken_while_no_node_runs(folder: Path, arguments: list[str]) -> None:
    assert _problem(_run(folder, *arguments, "--json"))["code"] == "CLUSTER_NOT_RUNNING"


@pytest.mark.parametrize("arguments", [["skew", "node-1", "+1h"], ["disk", "node-1", "full"]], ids=" ".join)
def test_a_killed_node_gets_no_wrong_clock_and_no_full_disk(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setattr(Cluster, "is_running", lambda _self, name: name == "node-2")
    problem = _problem(_run(folder, *arguments, "--json"))
    assert (problem["code"], problem["detail"]) == ("FAULT_TARGET_ABSENT", "node-1 is not running.")
    assert not (folder / "nodes" / "node-1" / STATE_FILE_NAME).exists()
    spoken = _run(folder, *arguments)
    assert spoken.stderr.splitlines()[0] == "node-1 is not running."


@pytest.mark.parametrize("arguments", [["skew", "node-1", "0"], ["disk", "node-1", "free"]], ids=" ".join)
def test_what_is_wrong_with_a_killed_node_ends_without_a_line_of_log(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setattr(Cluster, "is_running", lambda _self, name: name == "node-2")
    result = _run(folder, *arguments)
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.startswith("Done: ")


@pytest.mark.parametrize(
    "arguments",
    [
        ["link", "node-1", "node-2", "--cut", "--delay", "5"],
        ["link", "node-1", "node-2", "--cut", "--profile", "wan"],
        ["link", "node-1", "node-2", "--delay", "5", "--seed", "-1"],
        ["link", "node-1", "node-2", "--delay", "5", "--seed", "99999999999999999999"],
        ["link", "node-1", "node-2", "--delay", "nan"],
        ["link", "node-1", "node-2", "--jitter", "-5"],
        ["link", "node-1", "node-2", "--loss", "1"],
        ["link", "node-1", "node-2", "--bandwidth", "inf"],
        ["link", "node-1", "node-2", "--bandwidth", "1e300"],
        ["link", "node-1", "node-2", "--bandwidth", "1e-9"],
        ["skew", "node-1", "9" * 400 + "d"],
        ["byzantine", "node-1", "equivocate", "--seed", "-1"],
    ],
    ids=lambda arguments: " ".join(arguments)[:60],
)
def test_figures_that_make_no_sense_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setattr(Cluster, "is_running", lambda _self, _name: True)
    assert _problem(_run(folder, *arguments, "--json"))["code"] == "FAULT_INVALID"


def test_a_node_that_is_none_is_not_restarted_and_an_unknown_behaviour_is_no_honest_node(folder: Path) -> None:
    problem = _problem(_run(folder, "restart", "node-7", "--json"))
    assert problem["code"] == "FAULT_UNKNOWN"
    assert "node-1, node-2" in problem["detail"]
    with pytest.raises(BlockRobotError, match=r"^FAULT_UNKNOWN:"):
        ByzantineNode(load_config(folder / "nodes" / "node-1"), "polite", 0)


def test_a_plan_is_shown_step_by_step_and_a_wrong_line_refused_with_its_number(folder: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN, encoding="utf-8")
    answer = json.loads(_run(folder, "run", str(plan), "--dry-run", "--json").stdout)
    assert answer == {"ok": True, "seed": 3, "steps": [{"at_ms": 1000, "line": 3, "do": "kill node-1"}]}
    assert "kill node-1" in _run(folder, "run", str(plan), "--dry-run").stdout
    assert _problem(_run(folder, "run", str(plan), "--json"))["code"] == "CLUSTER_NOT_RUNNING"
    plan.write_text(PLAN.replace("kill", "explode"), encoding="utf-8")
    problem = _problem(_run(folder, "run", str(plan), "--dry-run", "--json"))
    assert problem["code"] == "FAULT_PLAN_INVALID"
    assert problem["detail"].startswith("line 5:")


@pytest.mark.parametrize("name", ["kill", "link", "skew", "run", "byzantine", "partition"])
def test_every_command_shows_examples(folder: Path, name: str) -> None:
    assert "Example" in CliRunner().invoke(main, ["fault", name, "--help"]).stdout


def test_a_liar_does_not_run_where_faults_are_barred(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    create_network(tmp_path, nodes=1, organisations=1, base_port=46_950)
    data_dir = tmp_path / "nodes" / "node-1"
    with pytest.raises(BlockRobotError, match=r"^FAULTS_DISABLED:"):
        ByzantineNode(load_config(data_dir), "equivocate", 0)
    child = subprocess.run(
        [sys.executable, "-m", "network.byzantine.process", "--data-dir", str(data_dir), "--behaviour", "garbage"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.returncode == 1
    assert child.stderr.startswith("FAULTS_DISABLED:")
    with pytest.raises(SystemExit):
        run_liar(["--data-dir", str(data_dir)])
    assert "--behaviour" in capsys.readouterr().err


def test_faults_are_gone_when_the_whole_network_starts_anew(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(folder)
    state = folder / "nodes" / "node-2" / STATE_FILE_NAME
    state.write_text("{}", encoding="utf-8")
    started: list[str] = []
    monkeypatch.setattr(cluster, "start", started.append)
    cluster.start_all()
    assert started == ["node-1", "node-2"]
    assert not state.exists()

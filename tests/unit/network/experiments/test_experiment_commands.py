"""`blockrobot experiment` on the command line: what it answers, and what it refuses before anything is started."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from network.bench import conditions
from network.cli.main import main
from network.experiments import run_all

LOG = '{"time_ms": 5, "activity": "IMAGE_RETRIEVE", "case": "frame-1"}\n'


def call(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["experiment", *arguments])


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "events.jsonl"
    path.write_text(LOG, encoding="utf-8")
    return path


def test_compare_prints_both_logs_tables(log: Path) -> None:
    result = call("compare", str(log), str(log))
    assert result.exit_code == 0
    assert result.stdout.count("IMAGE_RETRIEVE") == 2
    answer = json.loads(call("compare", str(log), "--json").stdout)
    assert (answer["ok"], answer["logs"][0]["figures"]["frames_received"]) == (True, 1)


def test_compare_writes_into_a_new_folder_only(log: Path, tmp_path: Path) -> None:
    assert call("compare", str(log), str(log), "--out", str(tmp_path / "new")).exit_code == 0
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"log-1", "log-2"}
    answer = json.loads(call("compare", str(log), "--out", str(tmp_path), "--json").stdout)
    assert answer["error"]["code"] == "FOLDER_NOT_EMPTY"


def test_a_bad_line_is_an_error_with_code_and_next_step(tmp_path: Path) -> None:
    (tmp_path / "log").write_text("10:00:00:1, IMAGE_RETRIEVE, 1\nnonsense\n", encoding="utf-8")
    result = call("compare", str(tmp_path / "log"))
    assert result.exit_code == 1
    assert "Line 2" in result.stderr
    assert "EVENT_LOG_INVALID" in result.stderr


def test_run_refuses_a_foreign_folder_before_anything_is_started(log: Path) -> None:
    answer = json.loads(call("run", "1", "--out", str(log.parent), "--json").stdout)
    assert answer["error"]["code"] == "FOLDER_NOT_EMPTY"
    assert [path.name for path in log.parent.iterdir()] == ["events.jsonl"]


@pytest.mark.parametrize(("number", "names"), [("3", [3]), ("all", [1, 2, 3, 4, 5])])
def test_run_takes_one_experiment_or_all_and_its_exit_code_is_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: str, names: list[int]
) -> None:
    asked: list[int] = []

    async def pretend(chosen: list[Any], options: run_all.RunOptions) -> tuple[conditions.Result[Any], list[Any]]:
        asked.extend(experiment.number for experiment, _ in chosen)
        return conditions.Result(name="experiments", ok=number == "3", figures={}, conditions={}), []

    monkeypatch.setattr(run_all, "run_experiments", pretend)
    result = call("run", number, "--out", str(tmp_path / "out"), "--json")
    assert asked == names
    assert result.exit_code == (0 if number == "3" else 1)
    assert json.loads(result.stdout)["name"] == "experiments"

"""An experiment with real processes, on the first seconds of its scenario: every check, every file, and no process left."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from network.cluster import Cluster
from network.demo.checks import Check
from network.experiments.comparison import read_and_work_out
from network.experiments.definitions import Experiment
from network.experiments.out_folder import taken
from tests.experiments.short_run import run_short

SECONDS = 7.0


@pytest.mark.timeout(280)
async def test_a_short_run_holds_and_leaves_log_map_tables_and_page(tmp_path: Path) -> None:
    """The second experiment is the first and more: recording, looking, and a byte changed behind the chain's back."""
    failed: list[str] = []

    def show(_: Experiment, check: Check) -> None:
        if not check.ok:
            failed.append(f"{check.name}: {check.detail}")

    result = await run_short(tmp_path, SECONDS, show)
    assert failed == []
    assert (result["name"], result["ok"], result["conditions"]["nodes"]) == ("experiments", True, 4)
    figures = result["figures"]["experiment-2"]
    assert (figures["frames"]["published"], figures["frames"]["lost"]) == (210, 0)
    assert figures["frames"]["kept"] > 0.7 * figures["frames"]["covered"] > 0
    folder = tmp_path / "out" / "experiment-2"
    written = {path.name for path in folder.iterdir()}
    assert written >= {"events.jsonl", "events.csv", "events.xes", "activities.csv", "pairs.csv", "process-map.dot"}
    assert written >= {"process-map.svg", "report.html", "summary.json"}
    assert json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8")) == result
    forms = [read_and_work_out(folder / f"events.{form}") for form in ("jsonl", "csv", "xes")]
    assert forms[0].graph == forms[1].graph == forms[2].graph
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert "corruption off-chain is detected, and the frame named" in report
    with taken(tmp_path / "out"):  # it knows all that it wrote as its own
        pass
    nodes = Cluster(folder / "network")
    assert [name for name in nodes.names if nodes.is_running(name)] == []

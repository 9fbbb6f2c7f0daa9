"""The first experiment with real processes, on the first seconds of its scenario: every check, and every file it leaves."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from network.bench.fresh_network import find_base_port
from network.cluster import Cluster
from network.demo.checks import Check
from network.experiments.comparison import read_and_work_out
from network.experiments.definitions import EXPERIMENTS, Experiment
from network.experiments.run_all import RunOptions, run_experiments

SECONDS = 7.0


@pytest.mark.timeout(240)
async def test_a_short_run_holds_and_leaves_log_map_tables_and_page(tmp_path: Path) -> None:
    """The second experiment is the first and more: recording, looking, and a byte changed behind the chain's back."""
    experiment = EXPERIMENTS[1]
    whole = experiment.load_scenario()
    people = tuple(
        replace(person, readings_s=tuple(t for t in person.readings_s if t < SECONDS)) for person in whole.people
    )
    short = replace(whole, name="short", duration_s=SECONDS, people=people, digest="0" * 64)
    failed: list[str] = []

    def show(_: Experiment, check: Check) -> None:
        if not check.ok:
            failed.append(f"{check.name}: {check.detail}")

    options = RunOptions(
        out=tmp_path / "out", cache=tmp_path / "cache", base_port=find_base_port(4), tell=lambda _: None, show=show
    )
    result, _ = await run_experiments([(experiment, short)], options)
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
    nodes = Cluster(folder / "network")
    assert [name for name in nodes.names if nodes.is_running(name)] == []

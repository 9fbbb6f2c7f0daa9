"""An experiment with real processes, on the first seconds of its scenario: every check, every file, and no process left."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from network.cluster import Cluster
from network.demo.checks import Check
from network.experiments.comparison import read_and_work_out
from network.experiments.definitions import Experiment
from network.experiments.out_folder import reserved_out
from tests.experiments.short_run import run_short
from tests.ui.reading_reports import look_all_ways, pictures_in, print_on_a4, watched_page

SECONDS = 7.0
RUN_TIMEOUT_S = 280
pytestmark = pytest.mark.asyncio(loop_scope="module")


@dataclass(frozen=True, slots=True)
class ShortRun:
    """A run that has ended: where it lies, its result, and the checks that did not hold."""

    out: Path
    result: dict[str, Any]
    failed: list[str]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def short_run(tmp_path_factory: pytest.TempPathFactory) -> ShortRun:
    """The second experiment on its first seconds, run once for all who look at what it leaves."""
    folder = tmp_path_factory.mktemp("experiments")
    failed: list[str] = []

    def show(_: Experiment, check: Check) -> None:
        if not check.ok:
            failed.append(f"{check.name}: {check.detail}")

    return ShortRun(folder / "out", await run_short(folder, SECONDS, show), failed)


@pytest.mark.timeout(RUN_TIMEOUT_S)
async def test_a_short_run_holds_and_leaves_log_map_tables_and_page(short_run: ShortRun) -> None:
    """The second experiment is the first and more: recording, looking, and a byte changed behind the chain's back."""
    out, result = short_run.out, short_run.result
    assert short_run.failed == []
    assert (result["name"], result["ok"], result["conditions"]["nodes"]) == ("experiments", True, 4)
    figures = result["figures"]["experiment-2"]
    assert (figures["frames"]["published"], figures["frames"]["lost"]) == (210, 0)
    assert figures["frames"]["kept"] > 0.7 * figures["frames"]["covered"] > 0
    folder = out / "experiment-2"
    written = {path.name for path in folder.iterdir()}
    assert written >= {"events.jsonl", "events.csv", "events.xes", "activities.csv", "pairs.csv", "process-map.dot"}
    assert written >= {"process-map.svg", "report.html", "summary.json"}
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == result
    forms = [read_and_work_out(folder / f"events.{form}") for form in ("jsonl", "csv", "xes")]
    assert forms[0].graph == forms[1].graph == forms[2].graph
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert "corruption off-chain is detected, and the frame named" in report
    with reserved_out(out):  # it knows all that it wrote as its own
        pass
    nodes = Cluster(folder / "network")
    assert [name for name in nodes.names if nodes.is_running(name)] == []


@pytest.mark.system_packages
@pytest.mark.timeout(RUN_TIMEOUT_S + 120)
async def test_the_pages_of_a_real_run_are_readable_by_everybody_and_printed_with_all_pictures(
    short_run: ShortRun,
) -> None:
    index, report = short_run.out / "report.html", short_run.out / "experiment-2" / "report.html"
    async with watched_page() as page:
        await look_all_ways(page, index, "report-of-real-experiments")
        assert await page.locator("main").get_by_text("Every claim held.").is_visible()
        await print_on_a4(page, index, "report-of-real-experiments")
    async with watched_page() as page:
        await page.goto(index.as_uri())
        await page.get_by_role("link", name=re.compile("^2: ")).click()
        assert page.url == report.as_uri()
        await look_all_ways(page, report, "report-of-a-real-experiment")
        assert await page.get_by_role("img", name=re.compile("^Process map: ")).is_visible()
        assert pictures_in(report), "people have pictures"
        assert await print_on_a4(page, report, "report-of-a-real-experiment") >= 3

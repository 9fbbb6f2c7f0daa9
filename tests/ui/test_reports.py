"""The reports of the demonstration and of experiments as a reader opens them from disk, and prints them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.async_api import Page

from clients.sdk.pictures.picture_names import name_picture
from consensus.errors import BlockRobotError
from network.demo.checks import CheckList
from network.demo.report import build_summary, write_report
from network.experiments.comparison import MAP_FILE, write_reading
from network.experiments.pages.experiment_page import build_index, build_page
from network.experiments.run_one import Outcome
from tests.ui.accessible import find_accessibility_faults
from tests.ui.reading_reports import look_all_ways, pictures_in, print_on_a4
from tests.ui.watched_page import NARROW
from tests.unit.network.experiments.test_experiment_runs import outcome
from tests.unit.network.test_demo_report import checks, happened, state

PAGE_MAX_BYTES = 150_000


def paint(folder: Path, count: int) -> list[Path]:
    """Make pictures of somebody in a corridor, as a wallet writes them."""
    made = []
    for number in range(count):
        picture = np.full((240, 320, 3), (60, 40, 30), np.uint8)
        cv2.ellipse(picture, (80 + 20 * number, 130), (28, 80), 0, 0, 360, (90, 180, 240), -1)
        made.append(folder / name_picture(number, number * 10, "png"))
        assert cv2.imwrite(str(made[-1]), picture)
    return made


def demo_report(folder: Path, *, held: bool = True) -> Path:
    known = state(folder)
    known.pictures = {"patient-a": paint(folder, 4), "patient-b": paint(folder, 3)}
    known.audit = [happened(height=3 + n, kind="recorded", record_id=f"{n:032x}") for n in range(40)]
    write_report(folder, build_summary(checks(True, held, True), known, nodes=4, store="sqlite", out=folder), known)
    return folder / "report.html"


def experiment_outcome(folder: Path, *, ok: bool = True) -> Outcome:
    made = outcome(folder, ok=ok)
    made.belongings["patient-a"].pictures[:] = paint(folder, 3)
    return replace(made, conditions={"nodes": 4, "cores": 2, "load": 1.5, "seed": None})


def experiment_report(folder: Path, *, drawn_by_graphviz: bool) -> Path:
    made = experiment_outcome(folder)
    assert made.reading is not None
    assert write_reading(made.reading, folder) is None
    drawn = (folder / f"{MAP_FILE}.svg").read_text(encoding="utf-8") if drawn_by_graphviz else None
    refusal = None if drawn_by_graphviz else BlockRobotError("DRAWING_UNAVAILABLE")
    (folder / "report.html").write_text(build_page(made, refusal, drawn), encoding="utf-8")
    return folder / "report.html"


@pytest.mark.smoke
async def test_the_demonstrations_report_opens_from_disk_and_is_readable_by_everybody(
    page: Page, tmp_path: Path
) -> None:
    report = demo_report(tmp_path)
    await look_all_ways(page, report, "report-demo")
    assert await page.get_by_role("heading", name="What each patient sees").is_visible()
    assert await page.get_by_role("img", name=re.compile("patient A, frame 0: their silhouette alone")).is_visible()
    assert await page.locator("main").get_by_text("Every check held.").is_visible()
    text = re.sub(r"data:image/png;base64,[^\"]*", "", report.read_text(encoding="utf-8"))
    assert len(text.encode()) < PAGE_MAX_BYTES


async def test_on_a_narrow_screen_no_words_of_a_check_are_cut_off(page: Page, tmp_path: Path) -> None:
    known = state(tmp_path)
    found = CheckList(listener=lambda check: None)
    found.add(
        "custodians refuse A's records to B", ok=True, detail=f"node-1: “{'refused ' * 20}” ({'NOT_PERMITTED' * 4})"
    )
    write_report(tmp_path, build_summary(found, known, nodes=4, store="sqlite", out=tmp_path), known)
    await page.set_viewport_size({"width": NARROW[0], "height": NARROW[1]})
    await page.goto((tmp_path / "report.html").as_uri())
    cell = page.locator("table.stacked tbody td").last
    box = await cell.bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= NARROW[0]
    assert (
        await page.evaluate(
            "() => [...document.querySelectorAll('.scroll')].filter((e) => e.scrollWidth > e.clientWidth).length"
        )
        == 0
    )


async def test_a_check_that_failed_is_seen_at_once(page: Page, tmp_path: Path) -> None:
    await page.goto(demo_report(tmp_path, held=False).as_uri())
    assert await page.get_by_text("Not every check held.").is_visible()
    assert await page.locator(".seal.bad").count() == 1
    assert await page.locator(".badge.bad").count() == 1
    assert await find_accessibility_faults(page) == []


@pytest.mark.parametrize("drawn_by_graphviz", [True, False])
async def test_an_experiments_page_has_its_map_as_a_picture_with_words(
    page: Page, tmp_path: Path, drawn_by_graphviz: bool
) -> None:
    report = experiment_report(tmp_path, drawn_by_graphviz=drawn_by_graphviz)
    await look_all_ways(page, report, "report-experiment" if drawn_by_graphviz else "report-experiment-own-map")
    process_map = page.get_by_role("img", name=re.compile("^Process map: 4 activities"))
    assert await process_map.is_visible()
    assert "IMAGE_PAIRED" in (await process_map.text_content() or "")
    assert (await page.get_by_text("Graphviz drew no map here").count() == 0) == drawn_by_graphviz


async def test_the_page_over_all_experiments_leads_to_each(page: Page, tmp_path: Path) -> None:
    made = experiment_outcome(tmp_path)
    (tmp_path / made.experiment.name).mkdir()
    (tmp_path / made.experiment.name / "report.html").write_text(build_page(made, None), encoding="utf-8")
    index = build_index([made], 5.0, {"nodes": 4})
    (tmp_path / "report.html").write_text(index, encoding="utf-8")
    await look_all_ways(page, tmp_path / "report.html", "report-experiments")
    await page.set_viewport_size({"width": NARROW[0], "height": NARROW[1]})
    shown = await page.locator("caption span").bounding_box()
    assert shown is not None
    assert shown["x"] + shown["width"] <= NARROW[0], "what the table shows is read without moving it sideways"
    await page.get_by_role("link", name=re.compile("^1: ")).click()
    assert (await page.title()).startswith("Experiment 1")


async def test_reports_print_on_a4_with_nothing_cut_off(page: Page, tmp_path: Path) -> None:
    report = experiment_report(tmp_path, drawn_by_graphviz=True)
    assert len(pictures_in(report)) == 3
    assert 3 <= await print_on_a4(page, report, "report-experiment") <= 8


async def test_pictures_that_are_not_printed_would_be_missed(page: Page, tmp_path: Path) -> None:
    report = demo_report(tmp_path)
    assert len(pictures_in(report)) == 4
    report.write_text(report.read_text(encoding="utf-8").replace("<img ", "<img hidden "), encoding="utf-8")
    with pytest.raises(AssertionError, match="every picture is on paper"):
        await print_on_a4(page, report, "report-unprinted")

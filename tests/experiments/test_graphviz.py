"""Graphviz draws the map where it is installed; where it is not, ours is there and the refusal says how to get it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import cv2
import pytest

from consensus.errors import BlockRobotError
from network.experiments.comparison import work_out, write_reading
from network.experiments.pages.event_table import EventTable, LoggedEvent

pytestmark = pytest.mark.smoke

ODD_NAME = 'A "NAME" -> OF\\nODD LETTERS'
SVG = "{http://www.w3.org/2000/svg}"


def draw(folder: Path) -> BlockRobotError | None:
    """Draw three frames: two that were paired, one of which went on to something with an odd name."""
    events = [LoggedEvent(at, activity, "frame-1") for at, activity in ((0, "IMAGE_RETRIEVE"), (13, "IMAGE_PAIRED"))]
    events.append(LoggedEvent(2_013, ODD_NAME, "frame-1"))
    events += [LoggedEvent(at, name, "frame-2") for at, name in ((40, "IMAGE_RETRIEVE"), (51, "IMAGE_PAIRED"))]
    events.append(LoggedEvent(80, "IMAGE_RETRIEVE", "frame-3"))
    return write_reading(work_out("ours", EventTable.of("by hand", events)), folder)


def texts_of(folder: Path) -> set[str]:
    root = ElementTree.fromstring((folder / "process-map.svg").read_bytes())
    assert root.tag == f"{SVG}svg"
    return {(item.text or "").strip() for item in root.iter(f"{SVG}text")}


@pytest.mark.system_packages
def test_graphviz_draws_every_activity_and_pair_with_its_figures(tmp_path: Path) -> None:
    assert draw(tmp_path) is None
    shown = texts_of(tmp_path)
    assert {"IMAGE_RETRIEVE", "3 in 3 cases", "IMAGE_PAIRED", "2 in 2 cases", ODD_NAME} <= shown
    assert {"2 × 12 ms", "1 × 2.00 s", "1 in 1 case"} <= shown
    picture = cv2.imread(str(tmp_path / "process-map.png"))
    assert picture is not None
    assert min(picture.shape[:2]) > 300, "sharp enough for paper"
    assert picture.min() < 60 < 200 < picture.max()


@pytest.mark.system_packages
def test_in_graphvizs_map_no_label_lies_upon_another(tmp_path: Path) -> None:
    assert draw(tmp_path) is None
    root = ElementTree.fromstring((tmp_path / "process-map.svg").read_bytes())
    places = [
        (float(item.attrib["x"]), float(item.attrib["y"]), len((item.text or "").strip()))
        for item in root.iter(f"{SVG}text")
    ]
    assert len(places) == len(set(places)) >= 8
    for i, (x, y, length) in enumerate(places):
        for other_x, other_y, other_length in places[i + 1 :]:
            beside = abs(x - other_x) >= 2.2 * (length + other_length)
            assert beside or abs(y - other_y) >= 8


def test_without_graphviz_our_own_picture_is_there_and_the_refusal_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    refusal = draw(tmp_path)
    assert refusal is not None
    assert "apt install graphviz" in refusal.next_step
    assert {"IMAGE_PAIRED", "2 × 12 ms"} <= texts_of(tmp_path)
    assert (tmp_path / "process-map.dot").is_file()
    assert not (tmp_path / "process-map.png").exists()
    assert "IMAGE_PAIRED" in (tmp_path / "process-map.dot").read_text(encoding="utf-8")

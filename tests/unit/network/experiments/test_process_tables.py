"""The graph, the tables, the figures and the map of hand-made logs, against answers worked out by hand."""

from __future__ import annotations

import csv
import shutil
import stat
from pathlib import Path
from xml.etree import ElementTree

import pytest

from consensus.errors import BlockRobotError
from network.experiments.comparison import show_readings, work_out, write_reading
from network.experiments.pages.event_table import EventTable, LoggedEvent
from network.experiments.pages.flow_graph import Durations, FlowGraph, build_flow_graph
from network.experiments.pages.map_picture import draw_svg, order_activities
from network.experiments.pages.process_map import build_dot, draw_with_graphviz, show_duration, write_dot
from network.experiments.pages.tables import HEADINGS, activity_rows, pair_rows, show_value
from network.experiments.run_figures import DurationFigures, work_out_figures


def frame(number: int, *steps: tuple[int, str, str]) -> list[LoggedEvent]:
    return [LoggedEvent(at, activity, f"frame-{number}", alias) for at, activity, alias in steps]


def two_people() -> EventTable:
    """Three frames of five numbers: one of nobody's, one of a's, one of both where b's is withheld; two readings."""
    events = [
        *frame(1, (0, "IMAGE_RETRIEVE", ""), (4, "IMAGE_NOT_PAIRED_NOT_EXIST_RFID", "")),
        *frame(
            3,
            (10_000, "IMAGE_RETRIEVE", ""),
            (10_100, "IMAGE_PAIRED", "a"),
            (10_300, "DATABASE_PERSISTANCE", "a"),
            (10_400, "BLOCKCHAIN_TRANSACTION", "a"),
        ),
        *frame(
            5,
            (11_000, "IMAGE_RETRIEVE", ""),
            (11_100, "IMAGE_PAIRED", "a"),
            (11_100, "IMAGE_PAIRED", "b"),
            (11_150, "IMAGE_WITHHELD", "b"),
            (11_500, "DATABASE_PERSISTANCE", "a"),
            (11_900, "BLOCKCHAIN_TRANSACTION", "a"),
        ),
        LoggedEvent(5_001, "RFID_RETRIEVE", "a", "a"),
        LoggedEvent(9_001, "RFID_RETRIEVE", "a", "a"),
    ]
    return EventTable.of("by hand", events)


def test_pairs_are_counted_by_case_with_their_durations() -> None:
    graph = build_flow_graph(two_people())
    seen = {pair: (tally.absolute, tally.cases, tally.max_repetition) for pair, tally in graph.pairs.items()}
    assert seen == {
        ("IMAGE_RETRIEVE", "IMAGE_NOT_PAIRED_NOT_EXIST_RFID"): (1, 1, 1),
        ("IMAGE_RETRIEVE", "IMAGE_PAIRED"): (3, 2, 2),
        ("IMAGE_PAIRED", "DATABASE_PERSISTANCE"): (2, 2, 1),
        ("IMAGE_PAIRED", "IMAGE_WITHHELD"): (1, 1, 1),
        ("DATABASE_PERSISTANCE", "BLOCKCHAIN_TRANSACTION"): (2, 2, 1),
        ("RFID_RETRIEVE", "RFID_RETRIEVE"): (1, 1, 1),
    }
    stored = graph.pairs["IMAGE_PAIRED", "DATABASE_PERSISTANCE"].durations
    assert stored == Durations(count=2, max_ms=400, mean_ms=300, median_ms=300, min_ms=200, total_ms=600)
    assert graph.starts == {"IMAGE_RETRIEVE": 3, "RFID_RETRIEVE": 1}
    assert graph.ends["BLOCKCHAIN_TRANSACTION"] == 2
    assert (graph.case_count, graph.event_count) == (4, 14)


def test_what_the_log_notes_of_the_run_itself_stands_in_no_process() -> None:
    notes = [
        LoggedEvent(1, "CLOCK_ESTIMATED", "clock-reader"),
        LoggedEvent(20_000, "CLOCK_ESTIMATED", "clock-reader"),
        LoggedEvent(2, "MESSAGE_REFUSED", "frame-time-turned-away"),
    ]
    assert build_flow_graph(EventTable.of("by hand", [*notes, *two_people().events])) == build_flow_graph(two_people())


def test_rows_have_the_layout_of_the_authors_tables() -> None:
    graph = build_flow_graph(two_people())
    rows = {row.name: row.values for row in (*activity_rows(graph), *pair_rows(graph))}
    assert len(HEADINGS) == 8
    assert rows["IMAGE_RETRIEVE"] == (3, 3, 1, None, None, None, None, None)
    assert rows["IMAGE_PAIRED"] == (3, 2, 2, 100.0, 100.0, 100.0, 100.0, 300.0)
    assert rows["DATABASE_PERSISTANCE → BLOCKCHAIN_TRANSACTION"] == (2, 2, 1, 400.0, 250.0, 250.0, 100.0, 500.0)
    assert [show_value(value) for value in (None, 3, 2597.3, 54_279.0)] == ["-", "3", "2,597.3", "54,279"]


def test_figures_say_what_was_paired_lost_and_how_long_it_took() -> None:
    figures = work_out_figures(two_people())
    assert (figures.frames_published, figures.frames_received) == (5, 3)
    assert (figures.frames_paired, figures.frames_recorded, figures.frames_withheld_only) == (2, 2, 0)
    assert (figures.readings, figures.tags, figures.length_s) == (2, 1, 11.9)
    assert figures.lost_share == pytest.approx(0.4)
    assert figures.stretches["received to on the chain"] == DurationFigures(2, 650.0, 900.0, 900.0)
    assert figures.recorded_per_s_busiest == 1
    assert figures.frames_published_while_pairing == 3


def test_a_frame_is_covered_to_the_end_of_the_window_and_the_busiest_second_may_begin_anywhere() -> None:
    """The readings are at 5,001 and 9,001 ms: frame 1 came 1 ms before the first one's window began."""
    assert work_out_figures(two_people()).frames_covered == 2
    times = [0, 900, 1_000, 1_899, 1_901]
    events = [LoggedEvent(at, "BLOCKCHAIN_TRANSACTION", f"frame-{at}") for at in times]
    figures = work_out_figures(EventTable.of("x", events))
    assert (figures.recorded_per_s_busiest, figures.recorded_per_s_mean) == (3, 2.6)
    figures = work_out_figures(EventTable.of("x", [LoggedEvent(1, "RFID_RETRIEVE", "a", "a")]))
    assert (figures.frames_published, figures.lost_share, figures.recorded_share) == (0, 0.0, 0.0)
    assert figures.stretches["received to paired"] == DurationFigures(0, 0.0, 0.0, 0.0)


def test_the_map_names_every_pair_and_takes_no_name_for_an_instruction() -> None:
    graph = build_flow_graph(EventTable.of("x", [*frame(1, (0, 'a"; b ->', ""), (1_500, "B\\", ""))]))
    text = build_dot(graph)
    assert '[label="a\\"; b ->\\n1 in 1 case"]' in text
    assert 'a0 -> a1 [label="  1 × 1.50 s  "' in text
    assert text.count("->") == 4  # the pair, the start, the end, and the one inside a name
    assert [show_duration(value) for value in (13, 2_683.1, 90_000)] == ["13 ms", "2.68 s", "1.5 min"]


def test_our_own_picture_shows_every_activity_and_pair_below_what_it_follows() -> None:
    graph = build_flow_graph(two_people())
    order = order_activities(graph)
    assert order[:3] == ["RFID_RETRIEVE", "IMAGE_RETRIEVE", "IMAGE_NOT_PAIRED_NOT_EXIST_RFID"]
    assert order[-2:] == ["DATABASE_PERSISTANCE", "BLOCKCHAIN_TRANSACTION"]
    root = ElementTree.fromstring(draw_svg(graph))
    texts = {item.text for item in root.iter("{http://www.w3.org/2000/svg}text")}
    assert set(graph.activities) <= texts
    assert "2 × 250 ms" in texts
    drawn = [path for path in root.iter("{http://www.w3.org/2000/svg}path") if path.get("marker-end")]
    assert len(drawn) == len(graph.pairs)


def test_a_circle_of_activities_is_drawn_too() -> None:
    steps = [(0, "A", ""), (1, "B", ""), (2, "C", ""), (3, "A", ""), (4, "B", "")]
    assert sorted(order_activities(build_flow_graph(EventTable.of("x", frame(1, *steps))))) == ["A", "B", "C"]
    assert draw_svg(FlowGraph()).endswith("</svg>")


def test_two_logs_stand_side_by_side() -> None:
    reading = work_out("ours", two_people())
    text = show_readings([reading, work_out("theirs", two_people())])
    assert text.splitlines()[0].split() == ["ours", "theirs"]
    assert text.count("IMAGE_PAIRED → IMAGE_WITHHELD") == 2


def install_dot(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Put a program called `dot` on the path, and nothing else but the shell's own folder."""
    program = folder / "dot"
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(folder))
    assert shutil.which("dot") == str(program)


def test_without_graphviz_the_refusal_says_the_next_step_and_all_files_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    refusal = write_reading(work_out("ours", two_people()), tmp_path / "out")
    assert refusal is not None
    assert refusal.code == "DRAWING_UNAVAILABLE"
    assert "dot -Tsvg" in refusal.next_step
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {
        "activities.csv", "pairs.csv", "events.csv", "events.xes", "process-map.dot", "process-map.svg"
    }  # fmt: skip
    with (tmp_path / "out" / "pairs.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["absolute frequency"] == "3"
    assert (rows[0]["activity"], rows[0]["following"]) == ("IMAGE_RETRIEVE", "IMAGE_PAIRED")


def test_graphviz_is_asked_for_both_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_dot(tmp_path, monkeypatch, 'echo "$1" > "$3"')
    write_dot("digraph {}", tmp_path / "map.dot")
    pictures = draw_with_graphviz(tmp_path / "map.dot")
    assert [picture.read_text() for picture in pictures] == ["-Tsvg\n", "-Tpng\n"]
    assert [picture.name for picture in pictures] == ["map.svg", "map.png"]


def test_a_graphviz_that_fails_is_a_refusal_and_leaves_no_half_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_dot(tmp_path, monkeypatch, 'echo half > "$3"; exit 1')
    write_dot("digraph {}", tmp_path / "map.dot")
    with pytest.raises(BlockRobotError, match=r"^DRAWING_UNAVAILABLE:"):
        draw_with_graphviz(tmp_path / "map.dot")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dot", "map.dot"]

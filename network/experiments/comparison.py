"""The same tables from one log or two: text, JSON, files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from clients.robot.recording.event_log import write_csv, write_xes
from consensus.errors import BlockRobotError
from network.experiments.log_files import read_log
from network.experiments.pages.event_table import EventTable
from network.experiments.pages.flow_graph import FlowGraph, build_flow_graph
from network.experiments.pages.map_picture import draw_svg
from network.experiments.pages.process_map import build_dot, draw_with_graphviz, write_dot
from network.experiments.pages.tables import (
    activity_rows,
    figure_rows,
    pair_rows,
    show_rows,
    show_table,
    show_value,
    write_table,
)
from network.experiments.run_figures import RunFigures, work_out_figures

MAP_FILE = "process-map"


@dataclass(frozen=True, slots=True)
class Reading:
    """One analysed log: display name, table, graph and figures."""

    name: str
    table: EventTable
    graph: FlowGraph
    figures: RunFigures

    def as_json(self) -> dict[str, object]:
        return {
            "log": self.name,
            "form": self.table.form,
            "events": self.graph.event_count,
            "cases": self.graph.case_count,
            "figures": self.figures.as_json(),
            "activities": [row.as_json() for row in activity_rows(self.graph)],
            "pairs": [row.as_json() for row in pair_rows(self.graph)],
        }


def read_and_work_out(path: Path) -> Reading:
    """Raises EVENT_LOG_INVALID, FILE_UNUSABLE."""
    return work_out(path.name, read_log(path))


def work_out(name: str, table: EventTable) -> Reading:
    return Reading(name, table, build_flow_graph(table), work_out_figures(table))


def prepare_new_folder(folder: Path) -> None:
    """Make the folder, or accept an empty one. Raises FOLDER_NOT_EMPTY."""
    if folder.exists() and any(folder.iterdir()):
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{folder} is not empty.")
    folder.mkdir(parents=True, exist_ok=True)


def show_readings(readings: list[Reading]) -> str:
    columns = [[show_value(value) for _, value in figure_rows(reading.figures)] for reading in readings]
    names = [name for name, _ in figure_rows(readings[0].figures)]
    rows = [[name, *cells] for name, *cells in zip(names, *columns, strict=True)]
    parts = [show_table(["", *(reading.name for reading in readings)], rows)]
    for reading in readings:
        parts.append(f"{reading.name}: activities ({reading.graph.event_count:,} events)")
        parts.append(show_rows(activity_rows(reading.graph)))
        parts.append(f"{reading.name}: pairs (the second directly after the first, in the same case)")
        parts.append(show_rows(pair_rows(reading.graph)))
    return "\n\n".join(parts)


def write_reading(reading: Reading, folder: Path) -> BlockRobotError | None:
    """Write tables (CSV), events (CSV, XES) and process map (DOT, SVG; PNG by Graphviz).

    Returns, not raises, DRAWING_UNAVAILABLE if Graphviz failed; the SVG is then our plainer one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_table(activity_rows(reading.graph), folder / "activities.csv")
    write_table(pair_rows(reading.graph), folder / "pairs.csv")
    write_csv(reading.table.events, folder / "events.csv")
    write_xes(reading.table.events, folder / "events.xes")
    dot_file = folder / f"{MAP_FILE}.dot"
    write_dot(build_dot(reading.graph), dot_file)
    try:
        draw_with_graphviz(dot_file)
    except BlockRobotError as refusal:
        (folder / f"{MAP_FILE}.svg").write_text(draw_svg(reading.graph), encoding="utf-8")
        return refusal
    return None

"""Statistics tables in the prototype authors' layout, one row per activity or pair."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from network.experiments.pages.flow_graph import FlowGraph, Tally
from network.experiments.run_figures import RunFigures

HEADINGS = (
    "absolute frequency",
    "case frequency",
    "max repetition",
    "max duration (ms)",
    "mean duration (ms)",
    "median duration (ms)",
    "min duration (ms)",
    "total duration (ms)",
)
_KEYS = ("absolute", "cases", "max_repetition", "max_ms", "mean_ms", "median_ms", "min_ms", "total_ms")


@dataclass(frozen=True, slots=True)
class Row:
    """One activity (`following` empty) or pair, with the values under `HEADINGS`."""

    activity: str
    following: str
    values: tuple[int | float | None, ...]

    @property
    def name(self) -> str:
        return f"{self.activity} → {self.following}" if self.following else self.activity

    def as_json(self) -> dict[str, str | float | None]:
        return {"activity": self.activity, "following": self.following, **dict(zip(_KEYS, self.values, strict=True))}


def _row(activity: str, following: str, tally: Tally) -> Row:
    times = tally.durations
    durations = (times.max_ms, times.mean_ms, times.median_ms, times.min_ms, times.total_ms)
    measured = durations if times.count else (None,) * len(durations)
    return Row(activity, following, (tally.absolute, tally.cases, tally.max_repetition, *measured))


def activity_rows(graph: FlowGraph) -> list[Row]:
    rows = [_row(name, "", tally) for name, tally in graph.activities.items()]
    return sorted(rows, key=lambda row: -(row.values[0] or 0))


def pair_rows(graph: FlowGraph) -> list[Row]:
    rows = [_row(first, second, tally) for (first, second), tally in graph.pairs.items()]
    return sorted(rows, key=lambda row: -(row.values[0] or 0))


def show_value(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,.1f}".removesuffix(".0") if isinstance(value, float) else f"{value:,}"


def show_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [list(headings), *[list(row) for row in rows]]
    widths = [max(len(line[place]) for line in lines) for place in range(len(headings))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def show_rows(rows: Sequence[Row]) -> str:
    short = [heading.replace(" frequency", "").replace(" duration (ms)", "") for heading in HEADINGS]
    return show_table(["", *short], [[row.name, *map(show_value, row.values)] for row in rows])


def write_table(rows: Sequence[Row], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["activity", "following", *HEADINGS])
        for row in rows:
            writer.writerow([row.activity, row.following, *("" if value is None else value for value in row.values)])


def figure_rows(figures: RunFigures) -> list[tuple[str, int | float]]:
    rows: list[tuple[str, int | float]] = [
        ("length (s)", figures.length_s),
        ("frames that the camera published", figures.frames_published),
        ("frames received", figures.frames_received),
        ("frames lost before they arrived (%)", round(100 * figures.lost_share, 1)),
        ("tag readings", figures.readings),
        ("tags", figures.tags),
        ("frames received within 5 s of a reading, by arrival", figures.frames_covered),
        ("frames paired", figures.frames_paired),
        ("frames withheld from all owners", figures.frames_withheld_only),
        ("frames on the chain", figures.frames_recorded),
        ("frames on the chain of those received (%)", round(100 * figures.recorded_share, 1)),
        ("frames published while it paired", figures.frames_published_while_pairing),
        ("frames recorded a second, mean", figures.recorded_per_s_mean),
        ("frames recorded in the busiest second", figures.recorded_per_s_busiest),
    ]
    for name, stretch in figures.stretches.items():
        rows += [(f"{name}, {kind} (ms)", getattr(stretch, f"{kind}_ms")) for kind in ("mean", "p95", "max")]
    return rows

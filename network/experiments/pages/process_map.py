"""The process map as DOT text, with frequencies and durations; Graphviz draws it, where `dot` is installed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from consensus.errors import BlockRobotError
from network.experiments.pages.flow_graph import FlowGraph, Tally

START, END = "start", "end"
_PEN_MAX = 4.0
_WEIGHT_MAX = 20
_INK = "#44546a"
_FONT = 'fontname="Helvetica,Arial,sans-serif"'
GRAPHVIZ_PROGRAM = "dot"
DRAWING_MAX_S = 60.0
PICTURE_FORMS: dict[str, tuple[str, ...]] = {"svg": (), "png": ("-Gdpi=160",)}  # a PNG is to be sharp on paper too


def show_duration(milliseconds: float) -> str:
    if abs(milliseconds) < 1_000:
        return f"{milliseconds:.0f} ms"
    if abs(milliseconds) < 60_000:
        return f"{milliseconds / 1_000:.2f} s"
    return f"{milliseconds / 60_000:.1f} min"


def edge_label(tally: Tally) -> str:
    return f"{tally.absolute:,} × {show_duration(tally.durations.mean_ms)}"


def tally_label(tally: Tally) -> str:
    return f"{tally.absolute:,} in {tally.cases:,} {'case' if tally.cases == 1 else 'cases'}"


def _quote(text: str) -> str:
    plain = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
    return f'"{plain}"'


def build_dot(graph: FlowGraph) -> str:
    """Nodes are numbered, which prevents injection by activity names."""
    names = {activity: f"a{number}" for number, activity in enumerate(graph.activities)}
    busiest = max((tally.absolute for tally in graph.pairs.values()), default=1)
    lines = [
        "digraph process_map {",
        f"  graph [rankdir=TB, nodesep=0.6, ranksep=0.55, pad=0.2, {_FONT}];",
        f'  node [shape=box, style="rounded,filled", fillcolor="#eef3fb", color="{_INK}", fontsize=11, '
        f'margin="0.18,0.09", {_FONT}];',
        f'  edge [fontsize=10, color="{_INK}", fontcolor="{_INK}", arrowsize=0.8, {_FONT}];',
        f'  {START} [shape=circle, label="", width=0.22, fillcolor="#1b6b3a"];',
        f'  {END} [shape=doublecircle, label="", width=0.16, fillcolor="#a3262a"];',
    ]
    for activity, tally in graph.activities.items():
        # The line break is DOT's own, behind the quoting.
        label = _quote(activity)[:-1] + f'\\n{tally_label(tally)}"'
        lines.append(f"  {names[activity]} [label={label}];")
    for (first, second), tally in graph.pairs.items():
        pen = round(1 + (_PEN_MAX - 1) * tally.absolute / busiest, 2)
        # What happens most is drawn straight, and a label keeps away from its arrow.
        weight = 1 + round(_WEIGHT_MAX * tally.absolute / busiest)
        label = _quote(f"  {edge_label(tally)}  ")
        lines.append(f"  {names[first]} -> {names[second]} [label={label}, penwidth={pen}, weight={weight}];")
    for activity, count in graph.starts.items():
        lines.append(f'  {START} -> {names[activity]} [label="  {count:,}  ", style=dashed];')
    for activity, count in graph.ends.items():
        lines.append(f'  {names[activity]} -> {END} [label="  {count:,}  ", style=dashed];')
    return "\n".join([*lines, "}"]) + "\n"


def write_dot(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")


def draw_with_graphviz(dot_file: Path) -> list[Path]:
    """As SVG and PNG beside it. Raises DRAWING_UNAVAILABLE without `dot` or if it fails; the DOT file stays."""
    program = shutil.which(GRAPHVIZ_PROGRAM)
    if program is None:
        raise BlockRobotError(
            "DRAWING_UNAVAILABLE", f"Graphviz's `{GRAPHVIZ_PROGRAM}` is not installed here; {dot_file.name} is written."
        )
    pictures = []
    for form, options in PICTURE_FORMS.items():
        picture = dot_file.with_suffix(f".{form}")
        command = [program, f"-T{form}", "-o", str(picture), *options, str(dot_file)]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=DRAWING_MAX_S)
        except (OSError, subprocess.SubprocessError) as error:
            picture.unlink(missing_ok=True)
            raise BlockRobotError(
                "DRAWING_UNAVAILABLE",
                f"`{GRAPHVIZ_PROGRAM} -T{form}` failed on {dot_file.name}: {type(error).__name__}.",
            ) from None
        pictures.append(picture)
    return pictures

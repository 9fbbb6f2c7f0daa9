"""The process map as DOT text, with frequencies and durations."""

from __future__ import annotations

from network.experiments.pages.flow_graph import FlowGraph, Tally

START, END = "start", "end"
_PEN_MAX = 4.0
_WEIGHT_MAX = 20
_INK = "#44546a"
_FONT = 'fontname="Helvetica,Arial,sans-serif"'


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
    """Return the map in DOT; nodes are numbered, which prevents injection by activity names."""
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

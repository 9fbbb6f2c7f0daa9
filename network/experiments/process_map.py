"""The process map as DOT text: what follows what, how often and how fast. Must never need Graphviz."""

from __future__ import annotations

from network.experiments.flow_graph import FlowGraph, Tally

START, END = "start", "end"
_PEN_MAX = 4.0


def show_duration(milliseconds: float) -> str:
    """Return a duration as a reader says it: `13 ms`, `2.68 s`, `1.5 min`."""
    if abs(milliseconds) < 1_000:
        return f"{milliseconds:.0f} ms"
    if abs(milliseconds) < 60_000:
        return f"{milliseconds / 1_000:.2f} s"
    return f"{milliseconds / 60_000:.1f} min"


def edge_label(tally: Tally) -> str:
    """Return what stands beside an arrow: how often, and how long on average."""
    return f"{tally.absolute:,} × {show_duration(tally.durations.mean_ms)}"


def _quote(text: str) -> str:
    plain = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
    return f'"{plain}"'


def build_dot(graph: FlowGraph) -> str:
    """Return the map in DOT. Nodes are named by number, so that no activity's name can be taken for an instruction."""
    names = {activity: f"a{number}" for number, activity in enumerate(graph.activities)}
    busiest = max((tally.absolute for tally in graph.pairs.values()), default=1)
    lines = [
        "digraph process_map {",
        '  graph [rankdir=TB, fontname="sans-serif"];',
        '  node [shape=box, style="rounded,filled", fillcolor="#eef3fb", fontname="sans-serif", fontsize=11];',
        '  edge [fontname="sans-serif", fontsize=10, color="#44546a"];',
        f'  {START} [shape=circle, label="", width=0.2, fillcolor="#2e7d32"];',
        f'  {END} [shape=doublecircle, label="", width=0.15, fillcolor="#b00020"];',
    ]
    for activity, tally in graph.activities.items():
        # The line break is DOT's own, behind the quoting.
        label = _quote(activity)[:-1] + f'\\n{tally.absolute:,} in {tally.cases:,} cases"'
        lines.append(f"  {names[activity]} [label={label}];")
    for (first, second), tally in graph.pairs.items():
        pen = round(1 + (_PEN_MAX - 1) * tally.absolute / busiest, 2)
        lines.append(f"  {names[first]} -> {names[second]} [label={_quote(edge_label(tally))}, penwidth={pen}];")
    for activity, count in graph.starts.items():
        lines.append(f'  {START} -> {names[activity]} [label="{count:,}", style=dashed];')
    for activity, count in graph.ends.items():
        lines.append(f'  {names[activity]} -> {END} [label="{count:,}", style=dashed];')
    return "\n".join([*lines, "}"]) + "\n"

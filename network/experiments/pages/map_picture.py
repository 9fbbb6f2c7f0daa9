"""Draws a process map as SVG without Graphviz: activities in a column, arrows in lanes."""

from __future__ import annotations

import html
from dataclasses import dataclass

from network.experiments.pages.flow_graph import FlowGraph, Pair
from network.experiments.pages.process_map import edge_label, tally_label

BOX_WIDTH, BOX_HEIGHT, GAP = 330, 64, 44
LEFT, TOP = 20, 20
LANE_WIDTH, LANE_FIRST = 104, 40
LABEL_CHAR_WIDTH = 6.4
_HEAD = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
    'font-family="system-ui, sans-serif" role="img" aria-label="process map">'
    '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerUnits="userSpaceOnUse" '
    'markerWidth="11" markerHeight="11" orient="auto">'
    '<path d="M0 0L8 4L0 8z" fill="#44546a"/></marker></defs>'
)


@dataclass(frozen=True, slots=True)
class _Arrow:
    """One pair on the page: exit, entry and lane."""

    pair: Pair
    from_y: float
    to_y: float
    lane: int


def order_activities(graph: FlowGraph) -> list[str]:
    names = list(graph.activities)
    rank = dict.fromkeys(names, 0)
    forward = [
        (first, second)
        for (first, second), tally in graph.pairs.items()
        if first != second
        and tally.absolute > (graph.pairs[second, first].absolute if (second, first) in graph.pairs else 0)
    ]
    for _ in names:  # a longer way than through all of them would be a circle
        for first, second in forward:
            rank[second] = min(max(rank[second], rank[first] + 1), len(names))
    met = {name for pair in graph.pairs if pair[0] != pair[1] for name in pair}
    going_on = {first for first, _ in forward}
    return sorted(names, key=lambda name: (name in met, rank[name], name in going_on, -graph.activities[name].absolute))


def draw_svg(graph: FlowGraph) -> str:
    order = order_activities(graph)
    arrows = _lay_out(graph, order)
    lanes = 1 + max((arrow.lane for arrow in arrows), default=0)
    longest = max((len(edge_label(tally)) for tally in graph.pairs.values()), default=0)
    width = round(LEFT + BOX_WIDTH + LANE_FIRST + lanes * LANE_WIDTH + longest * LABEL_CHAR_WIDTH + 20)
    height = TOP * 2 + len(order) * (BOX_HEIGHT + GAP) - GAP
    parts = [_HEAD.format(width=width, height=height), f'<rect width="{width}" height="{height}" fill="#fff"/>']
    parts += [_draw_box(graph, name, place) for place, name in enumerate(order)]
    busiest = max((tally.absolute for tally in graph.pairs.values()), default=1)
    parts += [_draw_arrow(arrow, 1 + 3 * graph.pairs[arrow.pair].absolute / busiest) for arrow in arrows]
    parts += [_draw_label(arrow, edge_label(graph.pairs[arrow.pair])) for arrow in arrows]
    return "".join([*parts, "</svg>"])


def _lay_out(graph: FlowGraph, order: list[str]) -> list[_Arrow]:
    ends: dict[str, list[tuple[int, Pair, bool]]] = {name: [] for name in order}
    place = {name: index for index, name in enumerate(order)}
    for first, second in graph.pairs:
        ends[first].append((place[second], (first, second), True))
        ends[second].append((place[first], (first, second), False))
    at: dict[tuple[Pair, bool], float] = {}
    for name, here in ends.items():
        top = TOP + place[name] * (BOX_HEIGHT + GAP)
        # Arrows from and to what is above meet the box above: so they cross less.
        for number, (_, pair, leaves) in enumerate(sorted(here, key=lambda end: (end[0], end[2])), 1):
            at[pair, leaves] = top + BOX_HEIGHT * number / (len(here) + 1)
    ways = sorted(graph.pairs, key=lambda pair: abs(at[pair, True] - at[pair, False]))
    taken: list[list[tuple[float, float]]] = []
    arrows = []
    for pair in ways:
        start, end = sorted((at[pair, True], at[pair, False]))
        lane = next((i for i, spans in enumerate(taken) if all(end < a or b < start for a, b in spans)), len(taken))
        if lane == len(taken):
            taken.append([])
        taken[lane].append((start - 12, end + 12))
        arrows.append(_Arrow(pair, at[pair, True], at[pair, False], lane))
    return arrows


def _draw_box(graph: FlowGraph, name: str, place: int) -> str:
    tally = graph.activities[name]
    y = TOP + place * (BOX_HEIGHT + GAP)
    marks = [tally_label(tally)]
    marks += [f"{graph.starts[name]:,} begin here"] if name in graph.starts else []
    marks += [f"{graph.ends[name]:,} end here"] if name in graph.ends else []
    middle = LEFT + BOX_WIDTH / 2
    return (
        f'<rect x="{LEFT}" y="{y}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="8" fill="#eef3fb" stroke="#44546a"/>'
        f'<text x="{middle}" y="{y + 27}" text-anchor="middle" font-size="12.5" font-weight="600">{html.escape(name)}'
        f'</text><text x="{middle}" y="{y + 47}" text-anchor="middle" font-size="12">{", ".join(marks)}</text>'
    )


def _lane_x(arrow: _Arrow) -> float:
    return LEFT + BOX_WIDTH + LANE_FIRST + arrow.lane * LANE_WIDTH


def _draw_arrow(arrow: _Arrow, pen: float) -> str:
    edge, lane = LEFT + BOX_WIDTH, _lane_x(arrow)
    return (
        f'<path d="M{edge} {arrow.from_y:.1f}H{lane}V{arrow.to_y:.1f}H{edge}" fill="none" stroke="#44546a" '
        f'stroke-width="{pen:.1f}" stroke-linejoin="round" marker-end="url(#tip)" opacity="0.85"/>'
    )


def _draw_label(arrow: _Arrow, text: str) -> str:
    return (
        f'<text x="{_lane_x(arrow) + 6}" y="{(arrow.from_y + arrow.to_y) / 2 + 4:.1f}" font-size="11.5" '
        f'stroke="#fff" stroke-width="4" paint-order="stroke">{html.escape(text)}</text>'
    )

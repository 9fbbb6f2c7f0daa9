"""Builds the picture of a network at one moment, for the page and recordings.

A moment is ready for JSON; times are ms since 1970 by the console's clock, a node's figures are absent where it does
not report them. A link is one direction, left out if up and quiet; its `sent`, `arrived`, `kinds` (frames) and `bytes`
are per second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from network.cluster_monitor import STUCK_AFTER_S, NodeObservation, NodeRow, Observer, Picture
from network.console.node_polling import Counts, NodePoll
from node.p2p.link_faults import LinkFault

CLOCK_STEP_MS = 100
ConsoleSnapshot = dict[str, Any]
_Rates = dict[str, tuple[float, float]]


class SnapshotBuilder:
    """Builds moments from polls, one after another."""

    def __init__(self, now_s: float) -> None:
        """`now_s` is of a monotonic clock, here and in `update`."""
        self._observer = Observer(now_s)
        self._counts: dict[str, tuple[float, Counts]] = {}

    def update(self, polls: Sequence[NodePoll], now_s: float, wall_ms: int) -> ConsoleSnapshot:
        looks = [NodeObservation(poll.name, poll.running, poll.paused, poll.status, poll.faults) for poll in polls]
        picture = self._observer.update(looks, now_s)
        rates = {poll.name: self._rates(poll, now_s) for poll in polls}
        return {
            "at_ms": wall_ms,
            "final": picture.finalized_height,
            "final_since_ms": _round(wall_ms - picture.finality_age_s * 1000),
            "stuck_since_ms": _stuck_since(picture, wall_ms),
            "nodes": [_node(poll, row, picture) for poll, row in zip(polls, picture.rows, strict=True)],
            "links": _links(polls, rates),
        }

    def _rates(self, poll: NodePoll, now_s: float) -> dict[tuple[str, str], _Rates]:
        before = self._counts.pop(poll.name, None)
        if poll.counts is None:
            return {}
        self._counts[poll.name] = (now_s, poll.counts)
        if before is None or now_s <= before[0]:
            return {}
        rates: dict[tuple[str, str], _Rates] = {}
        for (peer, direction, kind), (frames, size) in poll.counts.items():
            known_frames, known_size = before[1].get((peer, direction, kind), (0, 0))
            if frames < known_frames:  # the node was started anew meanwhile
                known_frames, known_size = 0, 0
            if frames > known_frames:
                elapsed_s = now_s - before[0]
                rates.setdefault((peer, direction), {})[kind] = (
                    (frames - known_frames) / elapsed_s,
                    (size - known_size) / elapsed_s,
                )
        return rates


def _round(time_ms: float) -> int:
    return round(time_ms / CLOCK_STEP_MS) * CLOCK_STEP_MS


def _stuck_since(picture: Picture, wall_ms: int) -> int | None:
    return None if picture.stuck_s < STUCK_AFTER_S else _round(wall_ms - picture.stuck_s * 1000)


def _node(poll: NodePoll, row: NodeRow, picture: Picture) -> dict[str, Any]:
    switched, status = poll.switched or {}, poll.status or {}
    lag = None if row.finalized_height is None else picture.finalized_height - row.finalized_height
    figures = {
        "height": row.height,
        "final": row.finalized_height,
        "lag": lag,
        "round": row.round,
        "epoch": row.epoch,
        "leader": row.leader,
        "peers": row.peers,
        "waiting": row.waiting,
        "suspended": status.get("suspended_height"),
        "accused": list(row.accused_by) or None,
        "clock_off_ms": None if poll.clock_off_ms is None else _round(poll.clock_off_ms),
        "clock_set_ms": switched.get("clock_offset_ms") or None,
        "disks": list(switched.get("disk", ())) or None,
        "behaviour": poll.behaviour or None,
        "faults": list(row.faults) or None,
    }
    reported = {key: value for key, value in figures.items() if value is not None}
    return {"name": row.name, "state": row.state, **reported}


def link_state(source: NodePoll, target: NodePoll, fault: LinkFault) -> str:
    """Down, cut, lossy, slow, narrow, still (an end paused) or up."""
    if not source.running or not target.running:
        return "down"
    if not fault.is_sound:
        ranked = (("cut", fault.cut), ("lossy", fault.loss), ("slow", fault.delay_ms or fault.jitter_ms))
        return next((word for word, is_so in ranked if is_so), "narrow")
    if source.paused or target.paused:
        return "still"
    is_unconnected = source.status is not None and target.name not in source.status.get("peers", ())
    return "down" if is_unconnected else "up"


def _links(polls: Sequence[NodePoll], rates: Mapping[str, Mapping[tuple[str, str], _Rates]]) -> list[dict[str, Any]]:
    links = []
    for source in polls:
        faults = (source.switched or {}).get("links", {})
        for target in polls:
            if target is source:
                continue
            fault = msgspec.convert(faults.get(target.name, {}), LinkFault)
            sent = rates[source.name].get((target.name, "sent"), {})
            arrived = rates[target.name].get((source.name, "received"), {})
            link: dict[str, Any] = {"from": source.name, "to": target.name}
            link["state"] = link_state(source, target, fault)
            if not fault.is_sound:
                link["words"] = fault.describe()
            if sent or arrived:
                link["sent"] = _sum(sent, 0)
                link["arrived"] = _sum(arrived, 0)
                link["bytes"] = round(_sum(arrived, 1))
                link["kinds"] = {kind: round(rate, 1) for kind, (rate, _) in sorted(arrived.items())}
            if len(link) > 3 or link["state"] != "up":
                links.append(link)
    return links


def _sum(rates: _Rates, place: int) -> float:
    return round(sum(rate[place] for rate in rates.values()), 1)

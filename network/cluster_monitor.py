"""Network watching over time: states, faults, time without finality.

Time without finality counts only while a transaction waits and no final height grows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pages.time_format import format_time

STUCK_AFTER_S = 2.0
_HELD = {
    "custodian": "; older ones than due, since its custodian has not followed them yet",
    "record": "; older ones than due, for a record that is kept for a claim",
}


@dataclass(frozen=True, slots=True)
class NodeObservation:
    """One look at a node: process, status (None without answer), active faults."""

    name: str
    running: bool
    paused: bool
    status: Mapping[str, Any] | None
    faults: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NodeRow:
    """One table line; figures are None where unreported."""

    name: str
    state: str
    height: int | None
    finalized_height: int | None
    round: int | None
    epoch: int | None
    leader: str | None
    peers: int | None
    waiting: int | None
    faults: tuple[str, ...]
    accused_by: tuple[str, ...] = ()
    """Other nodes that say they hold evidence that it contradicted itself, or that it is suspended."""


@dataclass(frozen=True, slots=True)
class Picture:
    """The network at one moment; `stuck_s` is waiting work without finality, `finality_age_s` the time since progress."""

    at_s: float
    rows: tuple[NodeRow, ...]
    finalized_height: int
    finality_age_s: float
    stuck_s: float
    longest_stuck_s: float


def state_of(look: NodeObservation) -> str:
    """Stopped, paused, no answer, a fault, locked out, removed, waiting, suspended or signing."""
    if not look.running:
        return "stopped"
    if look.paused:
        return "paused"
    status = look.status
    if status is None:
        return "no answer"
    if status.get("fault"):
        return f"fault: {status['fault']}"
    if status.get("lockout"):
        return f"locked out: {status['lockout'].get('reason', '')}"
    usual = "signing" if status.get("suspended_height") is None else "suspended"
    unready = "removed" if removal_of(look.name, status) else "waiting"
    return usual if status.get("ready") else unready


def accusers_of(name: str, statuses: Mapping[str, Mapping[str, Any] | None]) -> tuple[str, ...]:
    """Other nodes whose status reports that this one contradicted itself."""
    return tuple(
        other
        for other, status in statuses.items()
        if other != name and any(row["name"] == name for row in (status or {}).get("accused", ()))
    )


def removal_of(name: str, status: Mapping[str, Any]) -> str:
    """How a node knows that the network removed it: by its own ledger, or, if it was off then, by its peers, of whom none
    talks to it. Empty if it was not.
    """
    problem = status.get("problem") or {}
    if problem.get("code") == "NODE_REMOVED":
        return str(problem["detail"])
    saying = [str(row["peer"]) for row in status.get("refused_by", []) if row["code"] == "PEER_REMOVED"]
    if not saying or status.get("peers"):
        return ""
    return f"{', '.join(saying)} {'say' if len(saying) > 1 else 'says'} that {name} was removed."


def clock_words(error_s: float) -> str:
    word = "ahead" if error_s > 0 else "behind"
    return f"By the time of new final blocks, this machine's clock is about {abs(error_s):.0f} s {word}."


def refusals_of(name: str, status: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Peers that a node refuses, and its words with the next step; not who was removed or is cut off for a while."""
    return [
        (
            str(row["peer"]),
            f"{name} refuses {row['peer']}: {row['code']}. {row['detail']} {row.get('next_step', '')}".strip(),
        )
        for row in status.get("refused_peers", [])
        if row["code"] not in {"PEER_REMOVED", "PEER_CUT_OFF"}
    ]


class Observer:
    """Makes consecutive pictures from looks."""

    def __init__(self, now_s: float) -> None:
        self._started_s = now_s
        self._finalized_height = -1
        self._grown_s = now_s
        self._waiting_since_s: float | None = None
        self._longest_s = 0.0

    def update(self, looks: Sequence[NodeObservation], now_s: float) -> Picture:
        statuses = {look.name: look.status for look in looks}
        rows = tuple(_row(look, accusers_of(look.name, statuses)) for look in looks)
        height = max(
            [self._finalized_height, *(row.finalized_height for row in rows if row.finalized_height is not None)]
        )
        if height > self._finalized_height:
            self._finalized_height, self._grown_s, self._waiting_since_s = height, now_s, None
        if not any(row.waiting for row in rows):
            self._waiting_since_s = None
        elif self._waiting_since_s is None:
            self._waiting_since_s = now_s
        stuck_s = 0.0 if self._waiting_since_s is None else now_s - self._waiting_since_s
        self._longest_s = max(self._longest_s, stuck_s)
        return Picture(
            at_s=now_s - self._started_s,
            rows=rows,
            finalized_height=height,
            finality_age_s=now_s - self._grown_s,
            stuck_s=stuck_s,
            longest_stuck_s=self._longest_s,
        )


def _row(look: NodeObservation, accused_by: tuple[str, ...]) -> NodeRow:
    seen = look.status or {}
    return NodeRow(
        name=look.name,
        state=state_of(look),
        height=seen.get("height"),
        finalized_height=seen.get("finalized_height"),
        round=seen.get("round"),
        epoch=seen.get("epoch"),
        leader=seen.get("leader"),
        peers=len(seen["peers"]) if "peers" in seen else None,
        waiting=seen.get("mempool"),
        faults=look.faults,
        accused_by=accused_by,
    )


def changes(before: Picture | None, after: Picture) -> list[str]:
    """One line each; growing heights are none."""
    known = {} if before is None else {row.name: row for row in before.rows}
    lines = [line for row in after.rows for line in _changes_of(known.get(row.name), row)]
    was_stuck = before is not None and before.stuck_s >= STUCK_AFTER_S
    if after.stuck_s >= STUCK_AFTER_S and not was_stuck:
        lines.append(f"nothing has become final for {after.stuck_s:.1f} s, and work waits")
    if was_stuck and before is not None and after.stuck_s < STUCK_AFTER_S:
        lines.append(f"final again at height {after.finalized_height}, after {before.stuck_s:.1f} s")
    return lines


def _changes_of(before: NodeRow | None, after: NodeRow) -> list[str]:
    lines = []
    if before is None or before.state != after.state:
        place = "" if after.finalized_height is None else f", final height {after.finalized_height}"
        lines.append(f"{after.name} is {after.state}{place}")
    if (() if before is None else before.faults) != after.faults:
        lines.append(f"{after.name} faults: {'; '.join(after.faults) or 'none'}")
    if after.accused_by and (before is None or not before.accused_by):
        lines.append(f"{after.name} is accused of contradicting itself by {', '.join(after.accused_by)}")
    if before is None or None in (before.epoch, after.epoch, before.peers, after.peers):
        return lines
    if before.epoch != after.epoch:
        lines.append(f"{after.name} is in epoch {after.epoch}")
    if before.peers != after.peers:
        lines.append(f"{after.name} has {after.peers} peers")
    return lines


def kept_lines(statuses: Mapping[str, Mapping[str, Any] | None]) -> list[str]:
    groups: dict[str, list[str]] = {}
    for name, status in statuses.items():
        if status is None or "blocks_kept" not in status:
            continue
        kept = status["blocks_kept"]
        if not (status["earliest_height"] or kept["archive"] or kept["held_by"]):
            continue  # it has every block, as a young network's nodes do
        since = "" if kept["earliest_ms"] is None else f" ({format_time(kept['earliest_ms'])})"
        what = f"{status['earliest_height']}{since}{', as an archive' if kept['archive'] else ''}"
        groups.setdefault(what + _HELD.get(kept["held_by"], ""), []).append(name)
    return [f"{', '.join(names)}: the oldest block kept is {what}." for what, names in groups.items()]

"""Describes changes between two moments of a network, as JSON-ready events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from network.console.rounds import Round
from network.console.snapshots import ConsoleSnapshot

Event = dict[str, Any]
REPEATED_AFTER_MS = 10_000
GAVE_UP_AWAITED_MS = 5_000
"""How long after a round is over who gave it up is waited for: nodes are not all asked, nor answer, at one moment."""
ROUTINE_KINDS = frozenset({"leader", "link"})
_WELL = frozenset({"signing"})
_WAITING = frozenset({"waiting", "paused", "suspended", "removed"})


def make_event(at_ms: int, kind: str, text: str, tone: str = "", nodes: Sequence[str] = ()) -> Event:
    return {"at_ms": at_ms, "kind": kind, "tone": tone, "text": text, "nodes": list(nodes)}


class Timeline:
    """Remembers the last moment and the reported rounds."""

    def __init__(self) -> None:
        self._before: ConsoleSnapshot | None = None
        self._waiting: dict[tuple[int, int], Round] = {}
        self._newest: tuple[int, int] = (-1, -1)
        self._over_ms: dict[tuple[int, int], int] = {}
        self._told: tuple[int, int] = (-1, -1)
        self._lost: dict[str, _LostRounds] = {}

    def update(self, moment: ConsoleSnapshot, rounds: Sequence[Round]) -> list[Event]:
        events = self._of_rounds(moment["at_ms"], rounds)
        before, self._before = self._before, moment
        if before is None:
            states = ", ".join(f"{node['name']} {node['state']}" for node in moment["nodes"])
            return [make_event(moment["at_ms"], "node", f"The recording begins: {states}.")]
        known = {node["name"]: node for node in before["nodes"]}
        for node in moment["nodes"]:
            events += _of_node(known.get(node["name"], {}), node, moment["at_ms"])
        return events + _of_leader(before, moment) + _of_finality(before, moment)

    def _of_rounds(self, at_ms: int, rounds: Sequence[Round]) -> list[Event]:
        for entry in rounds:
            place = (entry.epoch, entry.number)
            if entry.gave_up and place > self._told:
                self._waiting[place] = entry
            self._newest = max(self._newest, place)
        reported = []
        for place in sorted(self._waiting):
            entry = self._waiting[place]
            if place < self._newest:
                self._over_ms.setdefault(place, at_ms)
            is_awaited = at_ms - self._over_ms.get(place, at_ms) < GAVE_UP_AWAITED_MS
            if len(entry.gave_up) >= entry.quorum or not is_awaited:
                del self._waiting[place]
                self._over_ms.pop(place, None)
                self._told = max(self._told, place)
                reported += self._tell_of_lost(entry, at_ms)
        for leader, lost in list(self._lost.items()):
            if at_ms - lost.told_ms >= REPEATED_AFTER_MS:
                reported += lost.summary(leader, at_ms)
                if lost.numbers:
                    self._lost[leader] = _LostRounds(at_ms)
                else:
                    del self._lost[leader]
        return reported

    def _tell_of_lost(self, entry: Round, at_ms: int) -> list[Event]:
        leader, who = entry.leader or "nobody known", sorted(entry.gave_up)
        lost = self._lost.get(leader)
        if lost is not None:
            lost.numbers.append(entry.number)
            return []
        self._lost[leader] = _LostRounds(at_ms)
        names = ", ".join(who)
        return [
            make_event(
                at_ms, "timeout", f"Round {entry.number} (leader {leader}) was given up by {names}.", "warn", who
            )
        ]


@dataclass(slots=True)
class _LostRounds:
    told_ms: int
    numbers: list[int] = field(default_factory=list)

    def summary(self, leader: str, at_ms: int) -> list[Event]:
        if not self.numbers:
            return []
        first, last = min(self.numbers), max(self.numbers)
        rounds = f"{first}" if len(self.numbers) == 1 else f"{first} to {last}"
        text = f"{len(self.numbers)} more of {leader}'s rounds were given up ({rounds})."
        return [make_event(at_ms, "timeout", text, "warn", [leader])]


def _said(state: str) -> str:
    if state == "no answer":
        return "does not answer"
    return f"has a {state}" if state.startswith("fault") else f"is {state}"


def _of_node(before: Mapping[str, Any], node: Mapping[str, Any], at_ms: int) -> list[Event]:
    name, state = node["name"], node["state"]
    events = []
    if before.get("state") != state:
        tone = "good" if state in _WELL else "warn" if state in _WAITING else "bad"
        place = f", final height {node['final']}" if "final" in node else ""
        events.append(make_event(at_ms, "node", f"{name} {_said(state).removesuffix('.')}{place}.", tone, [name]))
    gone = [fault for fault in before.get("faults", ()) if fault not in node.get("faults", ())]
    come = [fault for fault in node.get("faults", ()) if fault not in before.get("faults", ())]
    if come:
        events.append(make_event(at_ms, "fault", f"On at {name}: {'; '.join(come)}.", "warn", [name]))
    if gone:
        events.append(make_event(at_ms, "fault", f"Off at {name}: {'; '.join(gone)}.", "good", [name]))
    if before.get("suspended") != node.get("suspended") and "final" in node and "final" in before:
        is_new = "suspended" in node
        text = f"suspended since height {node['suspended']} and leads nothing" if is_new else "no longer suspended"
        events.append(make_event(at_ms, "suspension", f"{name} is {text}.", "bad" if is_new else "good", [name]))
    if node.get("accused") and not before.get("accused"):
        text = f"{name} contradicted itself, say {' and '.join(node['accused'])}."
        events.append(make_event(at_ms, "suspension", text, "bad", [name]))
    if "epoch" in before and "epoch" in node and before["epoch"] != node["epoch"]:
        events.append(make_event(at_ms, "epoch", f"{name} is in epoch {node['epoch']}.", "", [name]))
    if "peers" in before and "peers" in node and before["peers"] != node["peers"]:
        tone = "warn" if node["peers"] < before["peers"] else ""
        count = node["peers"]
        events.append(make_event(at_ms, "link", f"{name} is connected with {count} others.", tone, [name]))
    return events


def leader_of(moment: ConsoleSnapshot) -> tuple[str | None, int]:
    reported = [node for node in moment["nodes"] if node.get("leader") is not None and "round" in node]
    if not reported:
        return None, -1
    newest = max(reported, key=lambda node: (node.get("epoch", 0), node["round"]))
    return str(newest["leader"]), int(newest["round"])


def _of_leader(before: ConsoleSnapshot, moment: ConsoleSnapshot) -> list[Event]:
    (old, _), (new, number) = leader_of(before), leader_of(moment)
    if new is None or new == old:
        return []
    return [make_event(moment["at_ms"], "leader", f"{new} leads round {number}.", "", [new])]


def _of_finality(before: ConsoleSnapshot, moment: ConsoleSnapshot) -> list[Event]:
    at_ms, since_ms = moment["at_ms"], moment["stuck_since_ms"]
    if since_ms is not None and before["stuck_since_ms"] is None:
        seconds = (at_ms - since_ms) / 1000
        return [make_event(at_ms, "finality", f"Nothing became final for {seconds:.1f} s, and work waits.", "bad")]
    if since_ms is None and before["stuck_since_ms"] is not None:
        seconds = (at_ms - before["stuck_since_ms"]) / 1000
        is_final = moment["final"] > before["final"]
        if not is_final and not any("waiting" in node for node in moment["nodes"]):
            text = f"After {seconds:.1f} s without anything final no node answers: whether work waits, nobody says."
            return [make_event(at_ms, "finality", text, "bad")]
        text = f"Final again at height {moment['final']}" if is_final else "No work waits any more"
        return [make_event(at_ms, "finality", f"{text}, after {seconds:.1f} s.", "good")]
    return []

"""Leaders, votes and timeouts of each round, merged from all nodes' reports."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from msgspec import Struct

from network.console.node_polling import NodePoll

ROUNDS_KEPT_COUNT = 2_000
EPOCHS_KEPT_COUNT = 64
_WORDS = {"proposed": "proposed", "voted": "voted", "gave-up": "gave_up"}


class RoundRow(Struct, frozen=True):
    """A round as it is told."""

    epoch: int
    round: int
    at_ms: int
    leader: str | None
    proposed: list[str]
    voted: list[str]
    gave_up: list[str]
    outcome: str


@dataclass(slots=True)
class Round:
    """One round: first seen (console clock, ms), quorum, leader, and reporters."""

    epoch: int
    number: int
    at_ms: int
    quorum: int
    leader: str | None = None
    proposed: set[str] = field(default_factory=set)
    voted: set[str] = field(default_factory=set)
    gave_up: set[str] = field(default_factory=set)

    def outcome(self) -> str:
        if len(self.voted) >= self.quorum:
            return "won"
        return "lost" if len(self.gave_up) >= self.quorum else "open"

    def row(self) -> RoundRow:
        proposed, voted, gave_up = sorted(self.proposed), sorted(self.voted), sorted(self.gave_up)
        return RoundRow(self.epoch, self.number, self.at_ms, self.leader, proposed, voted, gave_up, self.outcome())


class RoundBook:
    """The last rounds, oldest first. `quorum` and `producers` are of the newest reported epoch."""

    def __init__(self, quorum: int, producers: Collection[str] = (), kept_count: int = ROUNDS_KEPT_COUNT) -> None:
        self.quorum = quorum
        self.producers = frozenset(producers)
        self.dropped_count = 0
        self._epoch = -1
        self._quorums: dict[int, int] = {}
        self._kept_count = kept_count
        self._rounds: OrderedDict[tuple[int, int], Round] = OrderedDict()
        self._floor = (-1, -1)

    def update(self, polls: Sequence[NodePoll], wall_ms: int) -> list[Round]:
        """Return those that changed, oldest first."""
        changed: dict[tuple[int, int], Round] = {}
        for poll in polls:
            self._note_epoch(poll.status or {})
        for poll in polls:
            for entry in (poll.status or {}).get("rounds", ()):
                place = (int(entry["epoch"]), int(entry["round"]))
                if place <= self._floor:
                    continue
                known = self._rounds.get(place)
                if known is None:
                    known = self._rounds[place] = changed[place] = Round(*place, wall_ms, self.quorum)
                known.quorum = self._quorums.get(known.epoch, known.quorum)
                known.leader = known.leader or entry.get("leader")
                for word, group in _WORDS.items():
                    names: set[str] = getattr(known, group)
                    if word in entry.get("messages", {}) and poll.name not in names:
                        names.add(poll.name)
                        changed[place] = known
        self._drop()
        return [changed[place] for place in sorted(changed)]

    def _note_epoch(self, status: Mapping[str, Any]) -> None:
        if "quorum" not in status:
            return
        epoch, quorum = int(status["epoch"]), int(status["quorum"])
        self._quorums[epoch] = quorum
        if epoch >= self._epoch:
            self._epoch, self.quorum, self.producers = epoch, quorum, frozenset(status["producers"])
        if len(self._quorums) > EPOCHS_KEPT_COUNT:
            del self._quorums[min(self._quorums)]

    def _drop(self) -> None:
        while len(self._rounds) > self._kept_count:
            oldest = min(self._rounds)
            self._floor = max(self._floor, oldest)
            del self._rounds[oldest]
            self.dropped_count += 1

    def last(self, count: int) -> list[RoundRow]:
        places = sorted(self._rounds)[-count:]
        return [self._rounds[place].row() for place in places]

"""The directly-follows graph of an event table, with frequencies and durations."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field

from clients.robot.recording.event_log import RUN_NOTES
from network.experiments.pages.event_table import EventTable, follow

Pair = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Durations:
    """Statistics of durations in ms; all zero if nothing was measured (`count` 0)."""

    count: int
    max_ms: float
    mean_ms: float
    median_ms: float
    min_ms: float
    total_ms: float

    @classmethod
    def of(cls, values_ms: list[int]) -> Durations:
        if not values_ms:
            return cls(0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return cls(
            count=len(values_ms),
            max_ms=float(max(values_ms)),
            mean_ms=round(statistics.fmean(values_ms), 1),
            median_ms=float(statistics.median(values_ms)),
            min_ms=float(min(values_ms)),
            total_ms=float(sum(values_ms)),
        )


@dataclass(slots=True)
class Tally:
    """Counts per case and all durations of one activity or pair."""

    by_case: dict[str, int] = field(default_factory=dict)
    durations_ms: list[int] = field(default_factory=list)

    def add(self, case: str, duration_ms: int | None) -> None:
        self.by_case[case] = self.by_case.get(case, 0) + 1
        if duration_ms is not None:
            self.durations_ms.append(duration_ms)

    @property
    def absolute(self) -> int:
        return sum(self.by_case.values())

    @property
    def cases(self) -> int:
        return len(self.by_case)

    @property
    def max_repetition(self) -> int:
        return max(self.by_case.values(), default=0)

    @property
    def durations(self) -> Durations:
        return Durations.of(self.durations_ms)


@dataclass(slots=True)
class FlowGraph:
    """Activities, directly-following pairs, and where cases begin and end.

    An activity's durations are since its predecessor; a case's first event has none.
    """

    activities: dict[str, Tally] = field(default_factory=dict)
    pairs: dict[Pair, Tally] = field(default_factory=dict)
    starts: dict[str, int] = field(default_factory=dict)
    ends: dict[str, int] = field(default_factory=dict)
    case_count: int = 0
    event_count: int = 0


def build_flow_graph(table: EventTable) -> FlowGraph:
    """In order of first occurrence; skips events about the run."""
    graph = FlowGraph()
    for case, events in table.cases().items():
        if events[0].activity in RUN_NOTES:
            continue
        graph.case_count += 1
        graph.event_count += len(events)
        for before, event in follow(events):
            duration = None if before is None else event.time_ms - before.time_ms
            graph.activities.setdefault(event.activity, Tally()).add(case, duration)
            if before is not None:
                graph.pairs.setdefault((before.activity, event.activity), Tally()).add(case, duration)
        first, last = events[0].activity, events[-1].activity
        graph.starts[first] = graph.starts.get(first, 0) + 1
        graph.ends[last] = graph.ends.get(last, 0) + 1
    return graph

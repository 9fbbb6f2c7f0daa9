"""A run's overall figures: share paired, durations, losses."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import asdict, dataclass

from clients.robot.recording.event_log import (
    BLOCKCHAIN_TRANSACTION,
    DATABASE_PERSISTANCE,
    IMAGE_PAIRED,
    IMAGE_RETRIEVE,
    IMAGE_WITHHELD,
    RFID_RETRIEVE,
)
from network.bench.conditions import percentile
from network.experiments.pages.event_table import EventTable, LoggedEvent

WINDOW_MS = 5_000


@dataclass(frozen=True, slots=True)
class DurationFigures:
    """Durations of one stretch in ms, over `count` (frame, owner) pairs."""

    count: int
    mean_ms: float
    p95_ms: float
    max_ms: float

    @classmethod
    def of(cls, values_ms: list[int]) -> DurationFigures:
        if not values_ms:
            return cls(0, 0.0, 0.0, 0.0)
        mean = round(sum(values_ms) / len(values_ms), 1)
        return cls(len(values_ms), mean, float(percentile(values_ms, 0.95)), float(max(values_ms)))


@dataclass(frozen=True, slots=True)
class RunFigures:
    """Figures of one run; each frame counts once, however many owners."""

    length_s: float
    frames_published: int
    frames_received: int
    frames_covered: int
    frames_paired: int
    frames_withheld_only: int
    frames_recorded: int
    readings: int
    tags: int
    frames_published_while_pairing: int
    recorded_per_s_mean: float
    recorded_per_s_busiest: int
    stretches: dict[str, DurationFigures]

    @property
    def lost_share(self) -> float:
        return 1 - self.frames_received / self.frames_published if self.frames_published else 0.0

    @property
    def recorded_share(self) -> float:
        return self.frames_recorded / self.frames_received if self.frames_received else 0.0

    def as_json(self) -> dict[str, object]:
        return {
            **asdict(self),
            "lost_share": round(self.lost_share, 4),
            "recorded_share": round(self.recorded_share, 4),
        }


STRETCHES = {
    "received to paired": (IMAGE_RETRIEVE, IMAGE_PAIRED),
    "paired to stored": (IMAGE_PAIRED, DATABASE_PERSISTANCE),
    "paired to on the chain": (IMAGE_PAIRED, BLOCKCHAIN_TRANSACTION),
    "received to on the chain": (IMAGE_RETRIEVE, BLOCKCHAIN_TRANSACTION),
}


def work_out_figures(table: EventTable) -> RunFigures:
    frames = _frames_by_activity(table)
    received = frames.get(IMAGE_RETRIEVE, {})
    paired, recorded = frames.get(IMAGE_PAIRED, {}), frames.get(BLOCKCHAIN_TRANSACTION, {})
    readings = list(table.of_activity(RFID_RETRIEVE))
    times = [event.time_ms for event in table.events]
    finals = [event.time_ms for event in table.of_activity(BLOCKCHAIN_TRANSACTION)]
    span_s = (finals[-1] - finals[0]) / 1000 if len(finals) > 1 else 0.0
    return RunFigures(
        length_s=round((times[-1] - times[0]) / 1000, 1) if times else 0.0,
        frames_published=_span(received),
        frames_received=len(received),
        frames_covered=_count_covered(received, [event.time_ms for event in readings]),
        frames_paired=len(paired),
        frames_withheld_only=len(frames.get(IMAGE_WITHHELD, {}).keys() - recorded.keys()),
        frames_recorded=len(recorded),
        readings=len(readings),
        tags=len({event.alias for event in readings}),
        frames_published_while_pairing=_span(paired),
        recorded_per_s_mean=round(len(finals) / span_s, 1) if span_s else 0.0,
        recorded_per_s_busiest=_busiest_second(finals),
        stretches=_stretches(table),
    )


def _frames_by_activity(table: EventTable) -> dict[str, dict[int, int]]:
    frames: dict[str, dict[int, int]] = {}
    for event in table.events:
        if event.sequence is not None:
            frames.setdefault(event.activity, {}).setdefault(event.sequence, event.time_ms)
    return frames


def _span(frames: dict[int, int]) -> int:
    return max(frames) - min(frames) + 1 if frames else 0


def _busiest_second(times_ms: list[int]) -> int:
    return max((bisect_left(times_ms, at + 1000) - place for place, at in enumerate(times_ms)), default=0)


def _count_covered(received: dict[int, int], readings_ms: list[int]) -> int:
    covered = 0
    for at in received.values():
        first = bisect_left(readings_ms, at - WINDOW_MS)
        covered += first < len(readings_ms) and readings_ms[first] <= at + WINDOW_MS
    return covered


def _stretches(table: EventTable) -> dict[str, DurationFigures]:
    found: dict[str, list[int]] = {name: [] for name in STRETCHES}
    for events in table.cases().values():
        for times in _ways(events):
            for name, (start, end) in STRETCHES.items():
                if start in times and end in times:
                    found[name].append(times[end] - times[start])
    return {name: DurationFigures.of(values) for name, values in found.items()}


def _ways(events: list[LoggedEvent]) -> list[dict[str, int]]:
    shared = {event.activity: event.time_ms for event in reversed(events) if not event.alias}
    aliases = dict.fromkeys(event.alias for event in events if event.alias)
    ways = []
    for alias in aliases or {"": None}:
        own = {event.activity: event.time_ms for event in reversed(events) if event.alias == alias}
        ways.append({**shared, **own})
    return ways

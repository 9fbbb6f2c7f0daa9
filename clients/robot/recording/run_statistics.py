"""Counts each frame's outcome and latency.

Per frame and owner: covered = kept + withheld + lost.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from clients.robot.hiding.withhold_reason import MERGED_HELP, MergedEvidence
from clients.robot.matching import match_evidence
from clients.robot.matching.match_evidence import MatchEvidence
from clients.robot.recording.frame_answers import (
    AmbiguousTag,
    DistancesOff,
    FrameCounts,
    Latency,
    MergedTag,
    RunLatencies,
    SenseCounts,
)
from clients.robot.recording.spool import Delivered
from clients.sdk.terminal.json_answers import extend

ARRIVALS_MAX_COUNT = 4_096
"""Of so many frames it is remembered when they came: more than two minutes of 30 a second, longer than any waits here."""

AMBIGUOUS_TAGS_MAX_COUNT = 16
"""So many tags at most are reported as ambiguous, and as many as merged."""

_EXACT_BELOW = 10_000


@dataclass(slots=True)
class Distribution:
    """Histogram of ms values, or of their `per_ms` parts, to four digits from ten thousand on."""

    counts: Counter[int] = field(default_factory=Counter)
    per_ms: int = 1

    def add(self, value_ms: float) -> None:
        value, step = round(self.per_ms * value_ms), 1
        while abs(value) >= _EXACT_BELOW * step:
            step *= 10
        self.counts[value // step * step] += 1

    def summarise(self) -> Latency:
        """Zeros if empty."""
        if not self.counts:
            return Latency(p50=0.0, p95=0.0, max=0.0)
        values = np.array(sorted(self.counts))
        ends = np.cumsum([self.counts[value] for value in values.tolist()])

        def at(share: float) -> float:
            place = share * float(ends[-1] - 1)
            low, high = (int(values[np.searchsorted(ends, int(rank), "right")]) for rank in (place, math.ceil(place)))
            return round((low + (high - low) * (place % 1)) / self.per_ms, 1)

        return Latency(p50=at(0.50), p95=at(0.95), max=float(values[-1]) / self.per_ms)


@dataclass(frozen=True, slots=True)
class SealedFrames:
    """A record's frames (sequence, captured_at_ms) and owner alias; unknown times None."""

    alias: str = ""
    frames: tuple[tuple[int, int], ...] = ()
    arrived_at_ms: tuple[int | None, ...] = ()
    decided_at_ms: tuple[int | None, ...] = ()


@dataclass(slots=True)
class Ambiguity:
    """A tag's ambiguous frames, and evidence nearest to a decision."""

    frames: int
    nearest: MatchEvidence

    def summarise(self, alias: str) -> AmbiguousTag:
        help_text = match_evidence.HELP[self.nearest.obstacle]
        return extend(AmbiguousTag, self.nearest.summarise(), alias=alias, frames=self.frames, help=help_text)


@dataclass(slots=True)
class MergedFrames:
    """A tag's merged frames, and the silhouette nearest to one person."""

    frames: int
    nearest: MergedEvidence

    def summarise(self, alias: str) -> MergedTag:
        help_text = MERGED_HELP[self.nearest.by]
        return extend(MergedTag, self.nearest.summarise(), alias=alias, frames=self.frames, help=help_text)


@dataclass(slots=True)
class RunStatistics:
    """Figures of one run, in bounded memory; wall clock in ms."""

    window_ms: int
    published: int = 0
    covered: int = 0
    kept_final: int = 0
    records_final: int = 0
    withheld: dict[str, int] = field(default_factory=dict)
    stored_bytes: int = 0
    arrivals_ms: dict[int, int] = field(default_factory=dict)
    sealed: dict[bytes, SealedFrames] = field(default_factory=dict)
    frame_to_final: Distribution = field(default_factory=Distribution)
    arrival_to_final: Distribution = field(default_factory=Distribution)
    decided_to_final: Distribution = field(default_factory=Distribution)
    submit_to_final: Distribution = field(default_factory=Distribution)
    hiding: Distribution = field(default_factory=lambda: Distribution(per_ms=10))
    final_gap_max_ms: int = 0
    """The longest time between two records that became final."""
    senses: dict[str, RunStatistics] = field(default_factory=dict)
    ambiguities: dict[str, Ambiguity] = field(default_factory=dict)
    merged: dict[str, MergedFrames] = field(default_factory=dict)
    distances_off: dict[str, tuple[int, MatchEvidence]] = field(default_factory=dict)
    dropped: int = 0
    """Of another sense: how many could not wait for a verdict, for lack of memory."""
    _decided: dict[tuple[str, int], int] = field(default_factory=dict)
    _last_final_ms: int | None = None

    def frame_arrived(self, sequence: int, arrived_at_ms: int) -> None:
        self.published += 1
        self.arrivals_ms[sequence] = arrived_at_ms
        if len(self.arrivals_ms) > ARRIVALS_MAX_COUNT:
            del self.arrivals_ms[next(iter(self.arrivals_ms))]

    def frame_decided(self, alias: str, sequence: int, decided_at_ms: int) -> None:
        """When a frame was settled as kept, independent of processing delay."""
        self._decided[alias, sequence] = decided_at_ms

    def forget_decided(self, alias: str, sequence: int) -> None:
        self._decided.pop((alias, sequence), None)

    def clip_sealed(self, record_id: bytes, frames: list[tuple[int, int]], alias: str = "") -> None:
        """`frames`: sequence, captured_at_ms."""
        decided = tuple(self._decided.pop((alias, sequence), None) for sequence, _ in frames)
        arrived = tuple(self.arrivals_ms.get(sequence) for sequence, _ in frames)
        self.sealed[record_id] = SealedFrames(alias, tuple(frames), arrived, decided)

    def clip_dropped(self, record_id: bytes, reason: str) -> SealedFrames:
        """Return its frames, none from earlier runs."""
        sealed = self.sealed.pop(record_id, SealedFrames())
        self.add_withheld(reason, len(sealed.frames))
        return sealed

    def add_withheld(self, reason: str, count: int = 1) -> None:
        if count:
            self.withheld[reason] = self.withheld.get(reason, 0) + count

    def add_ambiguous(self, alias: str, evidence: MatchEvidence) -> None:
        known = self.ambiguities.get(alias)
        if known is not None:
            known.frames += 1
            delay_ms = known.nearest.delay_ms if evidence.delay_ms is None else evidence.delay_ms
            nearest = evidence if evidence.nearness > known.nearest.nearness else known.nearest
            known.nearest = replace(nearest, delay_ms=delay_ms)
        elif len(self.ambiguities) < AMBIGUOUS_TAGS_MAX_COUNT:
            self.ambiguities[alias] = Ambiguity(1, evidence)

    def add_merged(self, alias: str, evidence: MergedEvidence) -> None:
        known = self.merged.get(alias)
        if known is not None:
            known.frames += 1
            if evidence.excess < known.nearest.excess:
                known.nearest = evidence
        elif len(self.merged) < AMBIGUOUS_TAGS_MAX_COUNT:
            self.merged[alias] = MergedFrames(1, evidence)

    def add_off(self, alias: str, evidence: MatchEvidence) -> None:
        """A frame was kept despite disagreeing distances; newest numbers stay."""
        if alias in self.distances_off or len(self.distances_off) < AMBIGUOUS_TAGS_MAX_COUNT:
            count, _ = self.distances_off.get(alias, (0, evidence))
            self.distances_off[alias] = count + 1, evidence

    def delivered(self, done: Delivered) -> SealedFrames:
        """Count a final record's frames as kept."""
        for sense in self.senses.values():
            if done.clip.upload.record_id in sense.sealed:
                sense.delivered(done)
        sealed = self.sealed.pop(done.clip.upload.record_id, SealedFrames())
        frames = sealed.frames
        self.records_final += 1
        self.kept_final += len(frames)
        self.stored_bytes += sum(len(text) for text in done.clip.upload.ciphertexts)
        self.submit_to_final.add(done.final_at_ms - done.submitted_at_ms)
        if self._last_final_ms is not None:
            self.final_gap_max_ms = max(self.final_gap_max_ms, done.final_at_ms - self._last_final_ms)
        self._last_final_ms = done.final_at_ms
        for _, captured_at_ms in frames:
            self.frame_to_final.add(done.final_at_ms - (captured_at_ms + self.window_ms))
        for times, distribution in (
            (sealed.arrived_at_ms, self.arrival_to_final),
            (sealed.decided_at_ms, self.decided_to_final),
        ):
            for at_ms in times:
                if at_ms is not None:
                    distribution.add(done.final_at_ms - at_ms)
        return sealed

    @property
    def withheld_count(self) -> int:
        return sum(self.withheld.values())

    def count_frames(self) -> FrameCounts:
        """`lost`: covered, neither final nor withheld."""
        return FrameCounts(
            published=self.published,
            covered=self.covered,
            kept=self.kept_final,
            withheld=self.withheld_count,
            withheld_reasons=dict(sorted(self.withheld.items())),
            lost=self.covered - self.kept_final - self.withheld_count,
        )

    def summarise_ambiguous(self) -> list[AmbiguousTag]:
        rows = sorted(self.ambiguities.items(), key=lambda row: (-row[1].frames, row[0]))
        return [ambiguity.summarise(alias) for alias, ambiguity in rows]

    def summarise_merged(self) -> list[MergedTag]:
        rows = sorted(self.merged.items(), key=lambda row: (-row[1].frames, row[0]))
        return [merged.summarise(alias) for alias, merged in rows]

    def summarise_distances_off(self) -> list[DistancesOff]:
        return [
            DistancesOff(
                alias=alias,
                frames=count,
                gap_m=round(evidence.gap_m, 2),
                spread_m=round(evidence.spread_m, 2),
                sigma_m=round(evidence.sigma_m, 2),
            )
            for alias, (count, evidence) in sorted(self.distances_off.items())
        ]

    def count_senses(self) -> dict[str, SenseCounts]:
        came = {sensor: sense for sensor, sense in self.senses.items() if sense.published}
        return {
            sensor: extend(SenseCounts, sense.count_frames(), dropped=sense.dropped) for sensor, sense in came.items()
        }

    def summarise_latencies(self) -> RunLatencies:
        """`frame_to_final` from pairing window's end, `decided_to_final` from hiding's."""
        return RunLatencies(
            frame_to_final=self.frame_to_final.summarise(),
            decided_to_final=self.decided_to_final.summarise(),
            arrival_to_final=self.arrival_to_final.summarise(),
            submit_to_final=self.submit_to_final.summarise(),
        )

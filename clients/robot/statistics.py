"""Counts what became of every frame and how long it took. Must never count a frame as kept before its record is final.

Frames are counted per frame and owner: covered = kept + withheld + lost.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clients.robot.delivery import Delivered


def summarise_ms(values: list[float]) -> dict[str, float]:
    """Return median, 95th percentile and maximum of a list of milliseconds, rounded; zeros for an empty list."""
    if not values:
        return {"p50": 0.0, "p95": 0.0, "max": 0.0}
    array = np.asarray(values)
    return {
        "p50": round(float(np.percentile(array, 50)), 1),
        "p95": round(float(np.percentile(array, 95)), 1),
        "max": round(float(array.max()), 1),
    }


@dataclass(frozen=True, slots=True)
class SealedFrames:
    """Which frames a record holds, as (sequence, captured_at_ms), and this run's alias of their owner.

    `decided_at_ms` says of each frame when it was settled that it is kept, None where that is not known.
    """

    alias: str = ""
    frames: tuple[tuple[int, int], ...] = ()
    decided_at_ms: tuple[int | None, ...] = ()


@dataclass(slots=True)
class RunStatistics:
    """The figures of one run. Times in milliseconds of the robot's wall clock."""

    window_ms: int
    published: int = 0
    covered: int = 0
    kept_final: int = 0
    records_final: int = 0
    withheld: dict[str, int] = field(default_factory=dict)
    stored_bytes: int = 0
    arrivals_ms: dict[int, int] = field(default_factory=dict)
    sealed: dict[bytes, SealedFrames] = field(default_factory=dict)
    frame_to_final_ms: list[float] = field(default_factory=list)
    arrival_to_final_ms: list[float] = field(default_factory=list)
    decided_to_final_ms: list[float] = field(default_factory=list)
    submit_to_final_ms: list[float] = field(default_factory=list)
    final_times_ms: list[int] = field(default_factory=list)
    senses: dict[str, RunStatistics] = field(default_factory=dict)
    let_go: int = 0
    """Of another sense: how many could not wait for a verdict, for lack of memory."""
    _decided: dict[tuple[str, int], int] = field(default_factory=dict)

    def frame_arrived(self, sequence: int, arrived_at_ms: int) -> None:
        """Note when a frame came in."""
        self.published += 1
        self.arrivals_ms[sequence] = arrived_at_ms

    def frame_decided(self, alias: str, sequence: int, decided_at_ms: int) -> None:
        """Note when it was settled that a frame is kept for an owner: when what settled it had come, busy or not."""
        self._decided[alias, sequence] = decided_at_ms

    def forget_decided(self, alias: str, sequence: int) -> None:
        """Note that a frame is not kept after all."""
        self._decided.pop((alias, sequence), None)

    def clip_sealed(self, record_id: bytes, frames: list[tuple[int, int]], alias: str = "") -> None:
        """Note which frames, as (sequence, captured_at_ms), a record holds, and by this run's alias whose they are."""
        decided = tuple(self._decided.pop((alias, sequence), None) for sequence, _ in frames)
        self.sealed[record_id] = SealedFrames(alias, tuple(frames), decided)

    def clip_dropped(self, record_id: bytes, reason: str) -> SealedFrames:
        """Note that a sealed clip will never be recorded. Returns its frames; none if an earlier run's."""
        sealed = self.sealed.pop(record_id, SealedFrames())
        self.add_withheld(reason, len(sealed.frames))
        return sealed

    def add_withheld(self, reason: str, count: int = 1) -> None:
        """Count covered frames that are not kept."""
        if count:
            self.withheld[reason] = self.withheld.get(reason, 0) + count

    def delivered(self, done: Delivered) -> SealedFrames:
        """Note that a record is final: only now its frames count as kept. Returns them; none if an earlier run's."""
        for sense in self.senses.values():
            if done.clip.upload.record_id in sense.sealed:
                sense.delivered(done)
        sealed = self.sealed.pop(done.clip.upload.record_id, SealedFrames())
        frames = sealed.frames
        self.records_final += 1
        self.kept_final += len(frames)
        self.stored_bytes += sum(len(text) for text in done.clip.upload.ciphertexts)
        self.submit_to_final_ms.append(done.final_at_ms - done.submitted_at_ms)
        self.final_times_ms.append(done.final_at_ms)
        for sequence, captured_at_ms in frames:
            self.frame_to_final_ms.append(done.final_at_ms - (captured_at_ms + self.window_ms))
            self.arrival_to_final_ms.append(done.final_at_ms - self.arrivals_ms[sequence])
        self.decided_to_final_ms.extend(done.final_at_ms - at_ms for at_ms in sealed.decided_at_ms if at_ms is not None)
        return sealed

    @property
    def withheld_count(self) -> int:
        """How many covered frames were withheld, all reasons together."""
        return sum(self.withheld.values())

    def frames_json(self) -> dict[str, Any]:
        """Return the counts of frames; `lost` is what is covered but neither final nor withheld."""
        return {
            "published": self.published,
            "covered": self.covered,
            "kept": self.kept_final,
            "withheld": self.withheld_count,
            "withheld_reasons": dict(sorted(self.withheld.items())),
            "lost": self.covered - self.kept_final - self.withheld_count,
        }

    def senses_json(self) -> dict[str, Any]:
        """Return the same counts of each other sense of which anything came."""
        came = {sensor: sense for sensor, sense in self.senses.items() if sense.published}
        return {sensor: {**sense.frames_json(), "let_go": sense.let_go} for sensor, sense in came.items()}

    def latency_json(self) -> dict[str, Any]:
        """Return the distributions of the latencies.

        `frame_to_final` counts from the end of the pairing window, `decided_to_final` from when hiding had settled the
        frame too.
        """
        return {
            "frame_to_final": summarise_ms(self.frame_to_final_ms),
            "decided_to_final": summarise_ms(self.decided_to_final_ms),
            "arrival_to_final": summarise_ms(self.arrival_to_final_ms),
            "submit_to_final": summarise_ms(self.submit_to_final_ms),
        }

"""Detects when exactly one registered person was present: one tag, one silhouette, theirs.

Sound, estimates and unregistered colour are kept only then. Knows aliases only.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

from clients.robot.hiding.frame_redactor import KeptFrame, Output, WithheldFrame
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.pairing.tag_pairing import WINDOW_DEFAULT_MS, Decision

APART_MAX_MS = 500
"""How far depth frames may be apart, and from what they vouch for."""

SKEW_MAX_MS = 20
"""How far a colour image may be from the depth frame whose silhouettes cut it out."""

MEMORY_MS = 30_000
STRANGERS_MAX_COUNT = 1_024


@dataclass(slots=True)
class _Seen:
    captured_at_ms: int
    owners: tuple[str, ...] | None = None
    verdicts: dict[str, KeptFrame | WithheldFrame] = field(default_factory=dict)

    @property
    def is_settled(self) -> bool:
        return self.owners is not None and len(self.verdicts) == len(self.owners)


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Who was present; `sole_owner` may keep it, others get `reason`."""

    owners: tuple[str, ...]
    sole_owner: str = ""
    reason: WithholdReason = WithholdReason.NOT_ALONE


class OccupancyMonitor:
    """Remembers the last half minute of frames and strangers; camera time in ms."""

    def __init__(self, window_ms: int = WINDOW_DEFAULT_MS) -> None:
        self._window_ms = window_ms
        self._frames: dict[int, _Seen] = {}
        self._strangers: deque[tuple[int, int]] = deque()
        self._newest_ms: int | None = None

    def add_frame(self, sequence: int, captured_at_ms: int) -> None:
        self._frames[sequence] = _Seen(captured_at_ms)
        self._newest_ms = max(captured_at_ms, self._newest_ms or captured_at_ms)
        oldest_ms = self._newest_ms - MEMORY_MS
        while self._frames:
            first = next(iter(self._frames))
            if self._frames[first].captured_at_ms >= oldest_ms:
                break
            del self._frames[first]
        while self._strangers and self._strangers[0][1] < oldest_ms:
            self._strangers.popleft()

    def note(self, output: Output) -> None:
        seen = self._frames.get(output.sequence)
        if seen is None:
            return
        if isinstance(output, Decision):
            seen.owners = output.owners
        else:
            seen.verdicts[output.alias] = output

    def note_stranger(self, first_ms: int, last_ms: int) -> None:
        start, end = first_ms - self._window_ms, last_ms + self._window_ms
        if self._strangers and self._strangers[-1][0] <= end and start <= self._strangers[-1][1]:
            before = self._strangers.pop()
            start, end = min(start, before[0]), max(end, before[1])
        elif len(self._strangers) >= STRANGERS_MAX_COUNT:  # so many apart: take the time between for theirs too
            start, end = min(start, self._strangers[0][0]), max(end, self._strangers[-1][1])
            self._strangers.clear()
        self._strangers.append((start, end))

    def find_occupancy(self, start_ms: int, end_ms: int, *, final: bool = False) -> Occupancy | None:
        """Was one person alone in the span? None: not settled."""
        frames = self._settled(start_ms - APART_MAX_MS, end_ms + APART_MAX_MS, final=final)
        if frames is None:
            return None
        owners = tuple(sorted({alias for seen in frames for alias in seen.owners or ()}))
        if len(owners) != 1 or self._has_stranger(start_ms, end_ms):
            return Occupancy(owners)
        times = sorted(seen.captured_at_ms for seen in frames)
        covered = times[0] <= start_ms and end_ms <= times[-1]
        if not covered or any(after - before > APART_MAX_MS for before, after in pairwise(times)):
            return Occupancy(owners, reason=WithholdReason.NOT_MATCHED)
        verdicts = [seen.verdicts.get(owners[0]) for seen in frames]
        if not all(isinstance(verdict, KeptFrame) for verdict in verdicts):
            return Occupancy(owners, reason=WithholdReason.NOT_MATCHED)
        alone = all(isinstance(verdict, KeptFrame) and verdict.alone for verdict in verdicts)
        return Occupancy(owners, sole_owner=owners[0] if alone else "")

    def silhouettes(self, at_ms: int, *, final: bool = False) -> list[KeptFrame | WithheldFrame] | None:
        """Return the verdicts of the one depth frame that belongs to a picture, or None if it is not settled yet."""
        frames = self._settled(at_ms - SKEW_MAX_MS, at_ms + SKEW_MAX_MS, final=final)
        if not frames:
            return None if frames is None else []
        nearest = min(frames, key=lambda seen: abs(seen.captured_at_ms - at_ms))
        return [nearest.verdicts[alias] for alias in nearest.owners or () if alias in nearest.verdicts]

    def _settled(self, from_ms: int, to_ms: int, *, final: bool) -> list[_Seen] | None:
        if not final and (self._newest_ms is None or self._newest_ms <= to_ms):
            return None
        frames = [seen for seen in self._frames.values() if from_ms <= seen.captured_at_ms <= to_ms]
        return frames if final or all(seen.is_settled for seen in frames) else None

    def _has_stranger(self, start_ms: int, end_ms: int) -> bool:
        return any(start <= end_ms and start_ms <= end for start, end in self._strangers)

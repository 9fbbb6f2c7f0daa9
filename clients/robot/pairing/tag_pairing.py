"""Decides which tags own a frame: sighting [a, b] covers [a - window, b + window].

Frames are decided once no possible sighting can change owners (`lateness_ms` after first reading). Rejects raise or count
in `refused`. Only aliases, never tag UIDs.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from consensus.errors import BlockRobotError

WINDOW_DEFAULT_MS = 5_000
LATENESS_DEFAULT_MS = 1_000
MEMORY_MS = 60_000  # how far behind the stream's time a frame or sighting still counts, and how far ahead of it
FORGET_EVERY_MS = 1_000
CONFIRM_COUNT = 3  # as many frames in a row far from the stream's time, all agreeing, and the camera's clock was set
FRAMES_WAITING_MAX_COUNT = 4_096
TAGS_MAX_COUNT = 4_096
INTERVALS_MAX_COUNT = 256  # of one tag; two that overlap are one
NOT_PAIRED_NO_TAG = "IMAGE_NOT_PAIRED_NOT_EXIST_RFID"
NOT_PAIRED_UNKNOWN_TAG = "IMAGE_NOT_PAIRED_WITH_UNKNOWN_RFID"
REFUSED_FRAME_TIME = "frame-time"
REFUSED_FRAMES_FULL = "frames-full"
REFUSED_SIGHTING_TIME = "sighting-time"
REFUSED_TAGS_FULL = "tags-full"
REFUSED_INTERVALS_FULL = "intervals-full"
REFUSED_AND_COUNTED = frozenset({"FRAME_TIME_WRONG", "PAIRING_FULL"})  # codes after which a run goes on


@dataclass(frozen=True, slots=True)
class Decision:
    """A frame's final owners; without any, `reason` says why."""

    sequence: int
    captured_at_ms: int
    owners: tuple[str, ...]
    reason: str


class _Intervals:
    """Sorted disjoint closed intervals."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []

    def __len__(self) -> int:
        return len(self._starts)

    def add(self, start: int, end: int) -> bool:
        """Return False, changing nothing, at the maximum number."""
        first = bisect_left(self._ends, start)
        last = bisect_right(self._starts, end)
        if first < last:
            start, end = min(start, self._starts[first]), max(end, self._ends[last - 1])
        elif len(self._starts) >= INTERVALS_MAX_COUNT:
            return False
        self._starts[first:last] = [start]
        self._ends[first:last] = [end]
        return True

    def covers(self, at: int) -> bool:
        place = bisect_right(self._starts, at) - 1
        return place >= 0 and at <= self._ends[place]

    def forget_before(self, at: int) -> bool:
        """Return whether none is left."""
        keep = bisect_left(self._ends, at)
        del self._starts[:keep]
        del self._ends[:keep]
        return not self._starts


class Pairing:
    """Pairs frames with sightings that may be late, early, duplicate or unordered. Stream time: newest frame, receipt or
    `advance`. Later than `lateness_ms` counts in `late_count`, covering undecided frames. A clock set back over `MEMORY_MS`
    starts a new timeline; single such stamps are rejected.
    """

    def __init__(self, window_ms: int = WINDOW_DEFAULT_MS, lateness_ms: int = LATENESS_DEFAULT_MS) -> None:
        self.window_ms = window_ms
        self.lateness_ms = lateness_ms
        self.late_count = 0
        self.timeline_count = 1
        self.refused: dict[str, int] = {}
        self.now_ms: int | None = None
        self._forgot_ms: int | None = None
        self._doubts: list[int] = []
        self._waiting: list[tuple[int, int]] = []
        self._known: dict[str, _Intervals] = {}
        self._strangers = _Intervals()

    @property
    def waiting_count(self) -> int:
        return len(self._waiting)

    def add_frame(self, sequence: int, captured_at_ms: int, *, vouched: bool = False) -> list[Decision]:
        """`vouched`: the stamp agrees with receipt. Raises FRAME_TIME_WRONG if unvouched and over `MEMORY_MS` off, until
        `CONFIRM_COUNT` in a row agree; PAIRING_FULL.
        """
        self._check_time(sequence, captured_at_ms, vouched=vouched)
        made: list[Decision] = []
        if self.now_ms is not None and captured_at_ms < self.now_ms - MEMORY_MS:
            made = self._begin_timeline()
        if len(self._waiting) >= FRAMES_WAITING_MAX_COUNT:
            self._refuse(REFUSED_FRAMES_FULL)
            raise BlockRobotError("PAIRING_FULL", f"Frame {sequence} came while {len(self._waiting)} others wait.")
        heapq.heappush(self._waiting, (captured_at_ms, sequence))
        return [*made, *self.advance(captured_at_ms)]

    def add_sighting(
        self,
        alias: str,
        first_seen_ms: int,
        last_seen_ms: int,
        *,
        known: bool = True,
        received_at_ms: int | None = None,
    ) -> list[Decision]:
        """`known`: on the roster; strangers' tags count as one. Too distant or without room: counted in `refused`."""
        now = self.now_ms if received_at_ms is None else max(received_at_ms, self.now_ms or received_at_ms)
        if now is not None:
            if first_seen_ms > now + MEMORY_MS or last_seen_ms < now - MEMORY_MS:
                self._refuse(REFUSED_SIGHTING_TIME)
                return []
            self.late_count += first_seen_ms + self.lateness_ms < now
        intervals = self._strangers
        if known:
            if alias not in self._known and len(self._known) >= TAGS_MAX_COUNT:
                self._refuse(REFUSED_TAGS_FULL)
                return []
            intervals = self._known.setdefault(alias, _Intervals())
        end_ms = max(first_seen_ms, last_seen_ms) + self.window_ms
        if not intervals.add(first_seen_ms - self.window_ms, end_ms):
            self._refuse(REFUSED_INTERVALS_FULL)
        return self.advance(now) if now is not None and now != self.now_ms else []

    def advance(self, now_ms: int) -> list[Decision]:
        """Never back; decisions in time order."""
        self.now_ms = now_ms if self.now_ms is None else max(self.now_ms, now_ms)
        made = []
        while self._waiting and self._waiting[0][0] + self.window_ms + self.lateness_ms < self.now_ms:
            made.append(self._decide(*heapq.heappop(self._waiting)))
        if self._forgot_ms is None or self.now_ms >= self._forgot_ms + FORGET_EVERY_MS:
            self._forgot_ms = self.now_ms
            horizon = self.now_ms - MEMORY_MS
            self._strangers.forget_before(horizon)
            for alias in [a for a, seen in self._known.items() if seen.forget_before(horizon)]:
                del self._known[alias]
        return made

    def flush(self) -> list[Decision]:
        made = []
        while self._waiting:
            made.append(self._decide(*heapq.heappop(self._waiting)))
        return made

    def owners_so_far(self, captured_at_ms: int) -> tuple[str, ...]:
        """Return the owners known until now; later sightings only add to them."""
        return tuple(sorted(alias for alias, seen in self._known.items() if seen.covers(captured_at_ms)))

    def _check_time(self, sequence: int, captured_at_ms: int, *, vouched: bool) -> None:
        if vouched or self.now_ms is None or abs(captured_at_ms - self.now_ms) <= MEMORY_MS:
            self._doubts.clear()
            return
        if self._doubts and abs(captured_at_ms - self._doubts[-1]) > MEMORY_MS:
            self._doubts.clear()
        self._doubts.append(captured_at_ms)
        if len(self._doubts) < CONFIRM_COUNT:
            self._refuse(REFUSED_FRAME_TIME)
            off_s = (captured_at_ms - self.now_ms) / 1000
            raise BlockRobotError("FRAME_TIME_WRONG", f"Frame {sequence} is {off_s:+.0f} s from the stream's time.")
        self._doubts.clear()

    def _begin_timeline(self) -> list[Decision]:
        made = self.flush()
        self.now_ms = self._forgot_ms = None
        self._known.clear()
        self._strangers = _Intervals()
        self.timeline_count += 1
        return made

    def _refuse(self, why: str) -> None:
        self.refused[why] = self.refused.get(why, 0) + 1

    def _decide(self, captured_at_ms: int, sequence: int) -> Decision:
        owners = self.owners_so_far(captured_at_ms)
        if owners:
            return Decision(sequence, captured_at_ms, owners, "")
        strangers = self._strangers.covers(captured_at_ms)
        return Decision(sequence, captured_at_ms, (), NOT_PAIRED_UNKNOWN_TAG if strangers else NOT_PAIRED_NO_TAG)

"""Decides which tags a frame belongs to: a sighting over [a, b] covers the frames of [a - window, b + window].

Pure and exact: a frame is decided once no sighting that may still arrive can change its owners, and never before.
It knows aliases only, and must never be given a tag's UID.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from consensus.errors import BlockRobotError

WINDOW_DEFAULT_MS = 5_000
LATENESS_DEFAULT_MS = 1_000
MEMORY_MS = 60_000
NOT_PAIRED_NO_TAG = "IMAGE_NOT_PAIRED_NOT_EXIST_RFID"
NOT_PAIRED_UNKNOWN_TAG = "IMAGE_NOT_PAIRED_WITH_UNKNOWN_RFID"


@dataclass(frozen=True, slots=True)
class Decision:
    """A frame's owners, for good. `reason` is empty when there are owners, else why there are none."""

    sequence: int
    captured_at_ms: int
    owners: tuple[str, ...]
    reason: str


class _Intervals:
    """A union of closed intervals, as sorted disjoint pairs."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []

    def add(self, start: int, end: int) -> None:
        first = bisect_left(self._ends, start)
        last = bisect_right(self._starts, end)
        if first < last:
            start, end = min(start, self._starts[first]), max(end, self._ends[last - 1])
        self._starts[first:last] = [start]
        self._ends[first:last] = [end]

    def covers(self, at: int) -> bool:
        place = bisect_right(self._starts, at) - 1
        return place >= 0 and at <= self._ends[place]

    def forget_before(self, at: int) -> bool:
        """Drop intervals that ended before `at`; return whether none is left."""
        keep = bisect_left(self._ends, at)
        del self._starts[:keep]
        del self._ends[:keep]
        return not self._starts


class Pairing:
    """Pairs a stream of frames with a stream of sightings, which may come late, early, twice or out of order.

    Time is the stream's: the newest frame or `advance`. A sighting is late when it comes more than `lateness_ms`
    after its first reading; it still covers frames that are not yet decided, and `late_count` counts it.
    """

    def __init__(self, window_ms: int = WINDOW_DEFAULT_MS, lateness_ms: int = LATENESS_DEFAULT_MS) -> None:
        self.window_ms = window_ms
        self.lateness_ms = lateness_ms
        self.late_count = 0
        self.now_ms: int | None = None
        self._waiting: list[tuple[int, int]] = []
        self._known: dict[str, _Intervals] = {}
        self._unknown: dict[str, _Intervals] = {}

    def add_frame(self, sequence: int, captured_at_ms: int) -> list[Decision]:
        """Take a frame and return what is now decided. Raises FRAME_INVALID for one older than `MEMORY_MS`."""
        if self.now_ms is not None and captured_at_ms < self.now_ms - MEMORY_MS:
            raise BlockRobotError("FRAME_INVALID", f"Frame {sequence} is older than pairing remembers.")
        heapq.heappush(self._waiting, (captured_at_ms, sequence))
        return self.advance(captured_at_ms)

    def add_sighting(self, alias: str, first_seen_ms: int, last_seen_ms: int, *, known: bool = True) -> None:
        """Take a sighting; `known` says whether the roster holds the tag. It decides nothing by itself."""
        if self.now_ms is not None and first_seen_ms + self.lateness_ms < self.now_ms:
            self.late_count += 1
        table = self._known if known else self._unknown
        intervals = table.setdefault(alias, _Intervals())
        intervals.add(first_seen_ms - self.window_ms, max(first_seen_ms, last_seen_ms) + self.window_ms)

    def advance(self, now_ms: int) -> list[Decision]:
        """Move the stream's time on (never back) and return what is now decided, in time order."""
        self.now_ms = now_ms if self.now_ms is None else max(self.now_ms, now_ms)
        made = []
        while self._waiting and self._waiting[0][0] + self.window_ms + self.lateness_ms < self.now_ms:
            made.append(self._decide(*heapq.heappop(self._waiting)))
        for table in (self._known, self._unknown):
            for alias in [a for a, seen in table.items() if seen.forget_before(self.now_ms - MEMORY_MS)]:
                del table[alias]
        return made

    def flush(self) -> list[Decision]:
        """Decide all that waits, since nothing more will arrive."""
        made = []
        while self._waiting:
            made.append(self._decide(*heapq.heappop(self._waiting)))
        return made

    def owners_so_far(self, captured_at_ms: int) -> tuple[str, ...]:
        """Return who owns a frame of that time by what has arrived; later sightings can only add owners."""
        return tuple(sorted(alias for alias, seen in self._known.items() if seen.covers(captured_at_ms)))

    def _decide(self, captured_at_ms: int, sequence: int) -> Decision:
        owners = self.owners_so_far(captured_at_ms)
        if owners:
            return Decision(sequence, captured_at_ms, owners, "")
        strangers = any(seen.covers(captured_at_ms) for seen in self._unknown.values())
        return Decision(sequence, captured_at_ms, (), NOT_PAIRED_UNKNOWN_TAG if strangers else NOT_PAIRED_NO_TAG)

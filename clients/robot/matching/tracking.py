"""Follows silhouettes between frames in plan view.

If two people may have been exchanged, both tracks end. A person lost beside another counts as hidden until equally many are
seen again.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

GATE_M = 0.55
GATE_PER_M = 0.04
LOST_AFTER_MS = 1_000
SWALLOWED_M = 0.55
SWALLOWED_WITHIN_MS = 400
SMOOTHING = 0.25
HISTORY_MS = 40_000
NEAREST_RANGE_MS = 150
# Who was unseen for longer than this may have turned or stopped: whoever they could have become ends both tracks.
UNSEEN_CERTAIN_MS = 300
STRAY_M_PER_S = 1.5
FAR = 1e6
# Who went together with another and is not seen again counts as hidden for so long after they were last together.
HIDDEN_MS = 30_000
# Where none of them is seen any more, they may come back together within that time.
GONE_MS = 5_000
TOGETHER_M, TOGETHER_MS = 1.2, 1_500
TOGETHER_COUNT = 2
UNSEEN_BESIDE_MS = 3_000


class Seen(Protocol):
    """A silhouette, as far as it is followed: its place in plan, its range and bearing from the camera."""

    @property
    def x_m(self) -> float: ...

    @property
    def z_m(self) -> float: ...

    @property
    def range_m(self) -> float: ...

    @property
    def ahead_m(self) -> float: ...

    @property
    def bearing_deg(self) -> float: ...

    @property
    def withhold_reason(self) -> str: ...


@dataclass(slots=True, eq=False)
class Track:
    """One silhouette: identity, follower, range (m) and bearing (degrees from the camera's axis) by time (ms)."""

    number: int
    began_ms: int
    seen_ms: int
    x_m: float
    z_m: float
    speed_x: float = 0.0
    speed_z: float = 0.0
    ended: bool = False
    since_ms: int = 0  # since when somebody is seen there: before `began_ms` where an earlier track ended in doubt
    times: list[int] = field(default_factory=list)
    ranges: list[float] = field(default_factory=list)
    bearings: list[float] = field(default_factory=list)

    def predicted(self, at_ms: int) -> tuple[float, float]:
        """Predict at most half a second unseen."""
        ahead = min(at_ms - self.seen_ms, 500) / 1000
        return self.x_m + self.speed_x * ahead, self.z_m + self.speed_z * ahead

    def place_at(self, at_ms: int) -> tuple[float, float] | None:
        """Return range and bearing; None if not seen within `NEAREST_RANGE_MS`."""
        place = bisect_left(self.times, at_ms)
        near = [i for i in (place - 1, place) if 0 <= i < len(self.times)]
        best = min(near, key=lambda i: abs(self.times[i] - at_ms), default=None)
        if best is None or abs(self.times[best] - at_ms) > NEAREST_RANGE_MS:
            return None
        return self.ranges[best], self.bearings[best]

    def overlaps(self, other: Track) -> bool:
        return self.began_ms <= other.seen_ms and other.began_ms <= self.seen_ms

    def observe(self, seen: Seen, at_ms: int) -> None:
        elapsed = (at_ms - self.seen_ms) / 1000
        if elapsed > 0:
            self.speed_x += SMOOTHING * ((seen.x_m - self.x_m) / elapsed - self.speed_x)
            self.speed_z += SMOOTHING * ((seen.z_m - self.z_m) / elapsed - self.speed_z)
        self.x_m, self.z_m, self.seen_ms = seen.x_m, seen.z_m, at_ms
        self.times.append(at_ms)
        self.ranges.append(seen.range_m)
        self.bearings.append(seen.bearing_deg)
        if self.times[0] < at_ms - 2 * HISTORY_MS:
            keep = bisect_left(self.times, at_ms - HISTORY_MS)
            del self.times[:keep], self.ranges[:keep], self.bearings[:keep]


@dataclass(slots=True, eq=False)
class _Together:
    """Where people were last together. `counted`: tracks ended in this step and already among the hidden."""

    x_m: float
    z_m: float
    seen_ms: int
    hidden_count: int
    apart: list[Track] = field(default_factory=list)
    counted: tuple[Track, ...] = ()

    def note_ended(self) -> None:
        for track in [track for track in self.apart if track.ended]:
            self.apart.remove(track)
            self.hidden_count += 1
            self.counted = (*self.counted, track)
            self.x_m, self.z_m, self.seen_ms = track.x_m, track.z_m, max(self.seen_ms, track.seen_ms)

    def is_open(self, at_ms: int) -> bool:
        """Until equally many are seen at once."""
        all_seen = self.hidden_count == 0 and len({track.seen_ms for track in self.apart}) <= 1
        return not all_seen and at_ms - self.seen_ms <= (HIDDEN_MS if self.apart else GONE_MS)

    def is_near(self, x_m: float, z_m: float, at_ms: int) -> bool:
        elapsed_ms = at_ms - self.seen_ms
        beside = [(track.x_m, track.z_m, TOGETHER_M) for track in self.apart]
        if elapsed_ms <= TOGETHER_MS or not self.apart:
            beside.append((self.x_m, self.z_m, TOGETHER_M + STRAY_M_PER_S * max(0, elapsed_ms) / 1000))
        return any(float(np.hypot(x_m - x, z_m - z)) <= reach_m for x, z, reach_m in beside)


class Tracker:
    """A camera's tracks; `step` once per frame, in order."""

    def __init__(self) -> None:
        self.live: list[Track] = []
        self._count = 0
        self._together: list[_Together] = []

    def successor(self) -> Tracker:
        """Return a tracker that follows nobody yet and gives no number again."""
        new = Tracker()
        new._count = self._count
        return new

    @property
    def hidden_ranges(self) -> list[float]:
        """Ranges (m) where somebody may be hidden."""
        return [track.ranges[-1] for group in self._together if group.hidden_count for track in group.apart]

    def may_hide_somebody(self, track: Track, at_ms: int) -> bool:
        """Whether somebody who was seen beside this person a moment ago is not seen now, and may show through."""
        since_ms = at_ms - UNSEEN_BESIDE_MS
        if any(group.hidden_count and group.seen_ms >= since_ms and track in group.apart for group in self._together):
            return True
        return any(
            since_ms <= other.seen_ms < at_ms
            and float(np.hypot(other.x_m - track.x_m, other.z_m - track.z_m)) <= TOGETHER_M
            for other in self.live
        )

    def step(self, silhouettes: Sequence[Seen], at_ms: int) -> list[Track | None]:
        """Return each silhouette's track, None if merged."""
        lost = [track for track in self.live if at_ms - track.seen_ms > LOST_AFTER_MS]
        for track in lost:
            track.ended = True
        self.live = [track for track in self.live if not track.ended]
        for track in lost:
            self._note_lost(track)
        for group in self._together:
            group.counted = ()
            group.note_ended()
        self._together = [group for group in self._together if group.is_open(at_ms)]
        chosen: list[Track | None] = [None] * len(silhouettes)
        single = [i for i, silhouette in enumerate(silhouettes) if silhouette.withhold_reason != "merged"]
        for i, track in self._assign([silhouettes[i] for i in single], at_ms):
            chosen[single[i]] = track
        self._end_doubtful(silhouettes, chosen, at_ms)
        for group in self._together:
            group.note_ended()
        for i in single:
            match = chosen[i]
            if match is None or match.ended:
                match = self._begin(silhouettes[i], match, at_ms)
                chosen[i] = match
            match.observe(silhouettes[i], at_ms)
        return chosen

    def _assign(self, silhouettes: Sequence[Seen], at_ms: int) -> list[tuple[int, Track]]:
        if not silhouettes or not self.live:
            return []
        shape = (len(silhouettes), len(self.live))
        cost, possible = np.full(shape, FAR), np.zeros(shape, dtype=bool)
        for column, track in enumerate(self.live):
            x, z = track.predicted(at_ms)
            stray = STRAY_M_PER_S * max(0, at_ms - track.seen_ms - UNSEEN_CERTAIN_MS) / 1000
            for row, seen in enumerate(silhouettes):
                distance = float(np.hypot(seen.x_m - x, seen.z_m - z))
                gate = GATE_M + GATE_PER_M * seen.ahead_m
                possible[row, column] = distance < gate + stray
                if distance < gate:
                    cost[row, column] = distance
        rows, columns = linear_sum_assignment(cost)
        matches = [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if cost[r, c] < FAR]
        self._end_exchangeable(matches, possible, silhouettes, at_ms)
        return [(row, self.live[column]) for row, column in matches]

    def _end_exchangeable(
        self,
        matches: list[tuple[int, int]],
        possible: npt.NDArray[np.bool_],
        silhouettes: Sequence[Seen],
        at_ms: int,
    ) -> None:
        unseen = [at_ms - track.seen_ms > UNSEEN_CERTAIN_MS for track in self.live]
        found = {column: row for row, column in matches}
        for row, column in matches:
            for rival, track in enumerate(self.live):
                if rival == column or not possible[row, rival] or not (unseen[column] or unseen[rival]):
                    continue
                # A rival that is found elsewhere could be here only if this one could be there.
                if rival not in found or possible[found[rival], column]:
                    self.live[column].ended = track.ended = True
                    if rival not in found:
                        self._note_swallowed(silhouettes[row], (self.live[column], track), at_ms)
            if unseen[column] and any(possible[r, column] for r in range(len(possible)) if r not in found.values()):
                self.live[column].ended = True

    def _end_doubtful(self, silhouettes: Sequence[Seen], chosen: list[Track | None], at_ms: int) -> None:
        taken = {track.number for track in chosen if track is not None}
        lost = [track for track in self.live if track.number not in taken]
        for seen, matched in zip(silhouettes, chosen, strict=True):
            inside = [track for track in lost if _could_be_in(track, seen, at_ms)]
            if seen.withhold_reason == "merged":
                for track in inside:
                    track.ended = True
                self._note_together(seen, tuple(inside), at_ms)
                continue
            inside = [track for track in inside if at_ms - track.seen_ms < SWALLOWED_WITHIN_MS]
            if matched is not None and inside:
                for track in (*inside, matched):
                    track.ended = True
                self._note_swallowed(seen, (*inside, matched), at_ms)

    def _note_swallowed(self, seen: Seen, ended: tuple[Track, ...], at_ms: int) -> None:
        near = [group for group in self._together if group.is_near(seen.x_m, seen.z_m, at_ms)]
        counted = {track.number for group in near for track in group.counted}
        self._note_together(seen, tuple(track for track in ended if track.number not in counted), at_ms)

    def _note_together(self, seen: Seen, ended: tuple[Track, ...], at_ms: int) -> None:
        near = [group for group in self._together if group.is_near(seen.x_m, seen.z_m, at_ms)]
        self._together = [group for group in self._together if group not in near]
        # Who has left the others counts as seen, though they still look like two; whose track has just ended does not.
        apart = [track for group in near for track in group.apart]
        gone = {track.number: track for track in (*ended, *(track for track in apart if track.ended))}
        apart = [track for track in apart if not track.ended]
        hidden = len(gone) + sum(group.hidden_count for group in near)
        least = max(1, TOGETHER_COUNT - len(apart))
        counted = (*(track for group in near for track in group.counted), *gone.values())
        self._together.append(_Together(seen.x_m, seen.z_m, at_ms, max(hidden, least), apart, counted))

    def _note_lost(self, lost: Track) -> None:
        if any(lost in group.apart for group in self._together):
            return
        for track in self.live:
            back_s = (track.seen_ms - lost.seen_ms) / 1000
            x, z = track.x_m - track.speed_x * back_s, track.z_m - track.speed_z * back_s
            if track.since_ms <= lost.seen_ms and float(np.hypot(lost.x_m - x, lost.z_m - z)) <= TOGETHER_M:
                self._together.append(_Together(lost.x_m, lost.z_m, lost.seen_ms, 1, [track]))
                return

    def _note_apart(self, track: Track, before: Track | None, at_ms: int) -> None:
        """Record that a possibly hidden person is seen alone; if `before` just ended in doubt and was not counted, the
        number hidden stays.
        """
        near = [g for g in self._together if g.hidden_count > 0 and g.is_near(track.x_m, track.z_m, at_ms)]
        if not near:
            return
        group = next((group for group in near if before in group.counted), near[0])
        if before is None or before in group.counted:
            group.hidden_count -= 1
        group.apart.append(track)

    def _begin(self, seen: Seen, before: Track | None, at_ms: int) -> Track:
        self._count += 1
        since_ms = at_ms if before is None else before.since_ms
        track = Track(self._count, at_ms, at_ms, seen.x_m, seen.z_m, since_ms=since_ms)
        self.live.append(track)
        self._note_apart(track, before, at_ms)
        return track


def _could_be_in(track: Track, seen: Seen, at_ms: int) -> bool:
    x, z = track.predicted(at_ms)
    return float(np.hypot(seen.x_m - x, seen.z_m - z)) <= SWALLOWED_M + GATE_PER_M * seen.ahead_m

"""Where the robot was, by its own odometry, at the time of a frame; and whether the camera agrees."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from clients.robot.sensing.sensor_events import Odometry

KEPT_MS = 60_000
SAMPLES_MAX_COUNT = 20_000
GAP_MAX_MS = 250  # between two samples, for a place between them to be known
AHEAD_MAX_MS = 200  # of the newest sample: so far its speed is taken to last
WRONG_AHEAD_MS = 10_000  # of a frame: no camera is so late
SPEED_MAX_MPS, TURN_MAX_RADPS = 2.5, math.radians(180)
STANDS_MPS, STANDS_RADPS = 0.02, math.radians(1.0)
STANDS_WITHIN_MS = 300
SPOT_M, SPOT_RAD = 0.05, math.radians(2.0)  # a camera so close looks at the same scene
FOLLOWED_M, FOLLOWED_RAD = 2 * SPOT_M, 2 * SPOT_RAD  # from where a spot began: what may be drift, not motion
AWAY_MAX_MS = 2_000  # less than a node takes to start again and a robot to be elsewhere by then
DOUBTS_MAX_COUNT = 1_000


@dataclass(frozen=True, slots=True, order=True)
class RobotPlace:
    """The robot in its odometry's frame: metres to the right and ahead of its start, radians to the right."""

    at_ms: int
    x_m: float = 0.0
    z_m: float = 0.0
    yaw: float = 0.0

    @classmethod
    def of_camera(cls, odometry: Odometry, ahead_m: float, left_m: float) -> RobotPlace:
        """Return where a camera is that is so far ahead and to the left of what the odometry speaks of."""
        cos, sin = math.cos(odometry.yaw), math.sin(odometry.yaw)
        return cls(
            odometry.at_ms,
            -(odometry.left_m + ahead_m * sin + left_m * cos),
            odometry.ahead_m + ahead_m * cos - left_m * sin,
            -odometry.yaw,
        )

    def is_same_spot(self, other: RobotPlace) -> bool:
        return self.is_within(other, SPOT_M, SPOT_RAD)

    def is_within(self, other: RobotPlace, reach_m: float, reach_rad: float) -> bool:
        return _away_m(self, other) <= reach_m and abs(_turned(self, other)) <= reach_rad

    def to_odometry(self, x_m: float, z_m: float) -> tuple[float, float]:
        """Return a place before the robot (right, ahead) in the odometry's frame."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x_m + x_m * cos + z_m * sin, self.z_m - x_m * sin + z_m * cos


class Spot:
    """A place that the robot was at, by odometry that drifts: it is followed while the robot stands there, but not far.

    Who creeps or turns slower than what counts as motion would take it along.
    """

    def __init__(self, place: RobotPlace) -> None:
        self._first = self._place = self._seen = place

    def has(self, place: RobotPlace) -> bool:
        return place.is_within(self._first, FOLLOWED_M, FOLLOWED_RAD) and place.is_same_spot(self._place)

    def holds(self, place: RobotPlace) -> bool:
        """Tell whether the robot is there, and follow it. In time order."""
        is_there, before, self._seen = self.has(place), self._seen, place
        if is_there and _stands(before, place):
            self._place = place
        return is_there


class Home:
    """Where the empty scene fits: the place at which it did first, until the odometry may have begun anew elsewhere.

    Odometry that begins anew says that the robot is where it first began, and mostly that is home.
    """

    def __init__(self) -> None:
        self.is_lost = False
        self._spot: Spot | None = None
        self._fitted_ms = 0

    def may_hold(self, place: RobotPlace) -> bool:
        return not self.is_lost and (self._spot is None or self._spot.holds(place))

    def fit(self, place: RobotPlace) -> None:
        if self._spot is None:
            self._spot = Spot(place)
        self._fitted_ms = place.at_ms

    def lose(self) -> None:
        """For good: the scene may seem to fit anywhere. Without effect as long as it never fitted."""
        self.is_lost = self._spot is not None

    def go_on_after_break(self, place: RobotPlace, motion: OwnMotion) -> None:
        """Only who was there a moment before, and is there again by odometry that nothing speaks against, still is."""
        is_moment = place.at_ms - self._fitted_ms <= AWAY_MAX_MS and not motion.is_doubted(self._fitted_ms, place.at_ms)
        if not is_moment or not self.may_hold(place):
            self.lose()


class OwnMotion:
    """The robot's places over the last minute of frames. A jump is a step that is faster than it can drive or turn."""

    def __init__(self) -> None:
        self.places_count = 0
        self.doubts_count = 0
        self.restart()

    def restart(self) -> None:
        """Samples that follow have another clock."""
        self._places: list[RobotPlace] = []
        self._broken_ms: list[int] = []
        self._doubts: deque[tuple[int, int]] = deque(maxlen=DOUBTS_MAX_COUNT)
        self._confirmed_ms = -math.inf

    def add(self, place: RobotPlace) -> None:
        """Samples may come in any order; a second one for the same time is dropped."""
        self.places_count += 1
        if not all(map(math.isfinite, (place.x_m, place.z_m, place.yaw))):
            return
        at = bisect_left(self._places, place.at_ms, key=lambda kept: kept.at_ms)
        if at < len(self._places) and self._places[at].at_ms == place.at_ms:
            return
        insort(self._places, place)
        for before, after in pairwise(self._places[max(0, at - 1) : at + 2]):
            if _is_jump(before, after):
                insort(self._broken_ms, after.at_ms)
        if len(self._places) > SAMPLES_MAX_COUNT:
            self._drop_before(self._places[len(self._places) // 2].at_ms)

    def keep_around(self, frame_ms: int) -> None:
        """Drop what is older than a minute, and what lies so far ahead of a frame that its stamp must be wrong."""
        last_ms = frame_ms + WRONG_AHEAD_MS
        del self._places[bisect_right(self._places, last_ms, key=lambda kept: kept.at_ms) :]
        del self._broken_ms[bisect_right(self._broken_ms, last_ms) :]
        self._drop_before(frame_ms - KEPT_MS)

    def _drop_before(self, first_ms: int) -> None:
        del self._places[: bisect_left(self._places, first_ms, key=lambda kept: kept.at_ms)]
        del self._broken_ms[: bisect_left(self._broken_ms, first_ms)]

    def confirm(self, at_ms: int) -> None:
        """The camera saw until then what it would see if the odometry is right."""
        self._confirmed_ms = at_ms

    def doubt(self, first_ms: int, last_ms: int) -> None:
        """The camera saw between that the odometry is wrong. Nobody is followed past the end."""
        self.doubts_count += 1
        self._doubts.append((first_ms, last_ms))
        insort(self._broken_ms, last_ms + 1)
        self._confirmed_ms = last_ms

    def is_doubted(self, first_ms: int, last_ms: int) -> bool:
        return any(first_ms <= end and begin <= last_ms for begin, end in self._doubts)

    @property
    def newest_ms(self) -> int | None:
        return self._places[-1].at_ms if self._places else None

    def place_at(self, at_ms: int) -> RobotPlace | None:
        """None where no samples lie close before and after; a moment past the newest the last speed is taken to last."""
        after = bisect_left(self._places, at_ms, key=lambda kept: kept.at_ms)
        if after < len(self._places) and self._places[after].at_ms == at_ms:
            return self._places[after]
        if after == len(self._places) >= 2 and at_ms - self._places[-1].at_ms <= AHEAD_MAX_MS:
            after -= 1
        if not 0 < after < len(self._places):
            return None
        one, two = self._places[after - 1], self._places[after]
        if two.at_ms - one.at_ms > GAP_MAX_MS or _is_jump(one, two):
            return None
        share = (at_ms - one.at_ms) / (two.at_ms - one.at_ms)
        x_m, z_m = one.x_m + share * (two.x_m - one.x_m), one.z_m + share * (two.z_m - one.z_m)
        return RobotPlace(at_ms, x_m, z_m, one.yaw + share * _turned(one, two))

    def is_continuous(self, first_ms: int, last_ms: int) -> bool:
        """Tell whether no jump and no gap of the samples lies between."""
        if bisect_left(self._broken_ms, first_ms + 1) != bisect_left(self._broken_ms, last_ms + 1):
            return False
        first = bisect_right(self._places, first_ms, key=lambda kept: kept.at_ms)
        if first == 0:
            return False  # what was before is forgotten, or was never known
        last = bisect_left(self._places, last_ms, key=lambda kept: kept.at_ms)
        around = self._places[first - 1 : last + 1]
        return all(after.at_ms - before.at_ms <= GAP_MAX_MS for before, after in pairwise(around))

    def keeps_to(self, spot: Spot, first_ms: int, last_ms: int) -> bool:
        """Tell whether the robot was nowhere else between."""
        first = bisect_left(self._places, first_ms, key=lambda kept: kept.at_ms)
        last = bisect_right(self._places, last_ms, key=lambda kept: kept.at_ms)
        return all(spot.has(place) for place in self._places[first:last])

    def stands(self, at_ms: int) -> bool | None:
        """Tell whether the robot stood for a while before and after; None where that is not known (yet)."""
        around = (at_ms - STANDS_WITHIN_MS, at_ms, at_ms + STANDS_WITHIN_MS)
        first, middle, last = map(self.place_at, around)
        if first is None or middle is None or last is None or not self.is_continuous(first.at_ms, last.at_ms):
            return None
        if self._confirmed_ms < last.at_ms:
            return None
        if self.is_doubted(first.at_ms, last.at_ms):
            return False
        return _stands(first, middle) and _stands(middle, last)  # who turns back is where they were, for a moment


def _away_m(one: RobotPlace, other: RobotPlace) -> float:
    return math.hypot(one.x_m - other.x_m, one.z_m - other.z_m)


def _turned(before: RobotPlace, after: RobotPlace) -> float:
    """Radians, the shorter way round: many a robot wraps its angle."""
    return math.remainder(after.yaw - before.yaw, 2 * math.pi)


def _stands(before: RobotPlace, after: RobotPlace) -> bool:
    seconds = max(after.at_ms - before.at_ms, 1) / 1000
    moved = _away_m(before, after) / seconds
    return moved <= STANDS_MPS and abs(_turned(before, after)) / seconds <= STANDS_RADPS


def _is_jump(before: RobotPlace, after: RobotPlace) -> bool:
    seconds = max(after.at_ms - before.at_ms, 20) / 1000
    moved = _away_m(before, after)
    return moved > SPEED_MAX_MPS * seconds or abs(_turned(before, after)) > TURN_MAX_RADPS * seconds

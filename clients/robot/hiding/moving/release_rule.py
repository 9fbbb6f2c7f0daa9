"""When a body may be shown: what was seen of it before and after counts, not one frame."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from scipy.optimize import linear_sum_assignment

POOL_MS = 700.0  # a frame so far away weighs 1/e
POOL_MIN_LOG_ODDS = 1.0  # weighted over the buffer
NEAR_MS = 1_000
NEAR_MIN_LOG_ODDS = 0.0  # of each frame within NEAR_MS, that it is one person and nothing else
TRACK_MIN_LOG_ODDS = -2.0  # of each frame of the buffer, of both kinds
LOG_ODDS_LIMIT = 8.0  # so that one frame does not outweigh all others
FRAMES_MIN_COUNT = 4
FOLLOWED_MIN_MS = 600
SAME_M = 0.45  # between two frames
SAME_PER_M = 0.04  # more, for each metre away
LOST_AFTER_MS = 1_000
SPLIT_M = 0.7  # whoever appears so close may have been hidden in the other's silhouette
UNSEEN_MS = 2_000  # so long somebody who went out of sight may still be close by
BESIDE_M = 0.7  # two at that distance may be one silhouette
STRAYS_MPS = 0.3  # from where their last speed would have taken them
WALKS_MAX_MPS = 1.5
SOMEBODY_MIN_LOG_ODDS = -3.0  # a body below that all the time is a thing
SPEED_MS = 600  # measured over
KEPT_MS = 60_000
FORGET_EVERY_MS = 5_000
_FAR = 1e6


class Doubt(StrEnum):
    """Why a body is not shown though nothing speaks against it in its frame."""

    BRIEF = "brief"  # followed too briefly, or not seen then
    IN_BUFFER = "doubt-in-buffer"  # a frame of the whole buffer speaks clearly against one person
    NEARBY = "doubt-within-a-second"
    POOLED = "weak-evidence"
    HIDDEN = "somebody-hidden"  # who was seen close by, before or after


@dataclass(frozen=True, slots=True)
class Sighted:
    """A body in the odometry's frame (metres), how far ahead it is, and natural log-odds: that it is one person and
    nothing else, and that it is one rather than two.
    """

    x_m: float
    z_m: float
    ahead_m: float
    person: float
    alone: float


@dataclass(slots=True, eq=False)
class _Followed:
    x_m: float
    z_m: float
    began_ms: int  # what is older was taken over: it was not they who were seen then
    times: list[int] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)
    person: list[float] = field(default_factory=list)
    alone: list[float] = field(default_factory=list)


class ReleaseRule:
    """Follows bodies by nearest place and judges them by all frames within a buffer, before and after.

    A body that appears beside another takes over what was seen of that one: they may have been one silhouette.
    """

    def __init__(self) -> None:
        self._followed: dict[int, _Followed] = {}
        self._count = 0
        self._forgot_ms = 0

    def step(self, bodies: Sequence[Sighted], at_ms: int) -> list[int]:
        """Return the number under which each body is followed. In time order."""
        self._forget(at_ms)
        live = {n: one for n, one in self._followed.items() if at_ms - one.times[-1] <= LOST_AFTER_MS}
        chosen = _nearest(bodies, live)
        numbers = []
        for place, body in enumerate(bodies):
            number = chosen.get(place)
            if number is None:
                self._count += 1
                number = self._count
                self._followed[number] = self._begin(body, live, at_ms)
            numbers.append(number)
        for number, body in zip(numbers, bodies, strict=True):
            one = self._followed[number]
            one.x_m, one.z_m = body.x_m, body.z_m
            one.times.append(at_ms)
            one.places.append((body.x_m, body.z_m))
            one.person.append(max(-LOG_ODDS_LIMIT, min(LOG_ODDS_LIMIT, body.person)))
            one.alone.append(max(-LOG_ODDS_LIMIT, min(LOG_ODDS_LIMIT, body.alone)))
        return numbers

    def speaks_for_two(self, number: int, at_ms: int, buffer_ms: int) -> bool:
        """Tell whether the frames around that time, weighted over the buffer, do not speak for one person."""
        one = self._followed.get(number)
        if one is None:
            return True
        first, end = bisect_left(one.times, at_ms - buffer_ms), bisect_right(one.times, at_ms + buffer_ms)
        weights = np.exp(-np.abs(np.array(one.times[first:end], dtype=np.float64) - at_ms) / POOL_MS)
        return float(weights @ np.array(one.alone[first:end])) <= POOL_MIN_LOG_ODDS * float(weights.sum())

    def why_not(self, number: int, at_ms: int, buffer_ms: int) -> Doubt | None:
        """Return why a body may not be shown at that time; None: it may."""
        one = self._followed.get(number)
        if one is None:
            return Doubt.BRIEF
        first, end = bisect_left(one.times, at_ms - buffer_ms), bisect_right(one.times, at_ms + buffer_ms)
        times = np.array(one.times[first:end], dtype=np.float64)
        if len(times) < FRAMES_MIN_COUNT or times[-1] - times[0] < FOLLOWED_MIN_MS or at_ms not in times:
            return Doubt.BRIEF
        away = np.abs(times - at_ms)
        weights = np.exp(-away / POOL_MS)
        person, alone = np.array(one.person[first:end]), np.array(one.alone[first:end])
        now = int(away.argmin())
        if np.minimum(person, alone).min() <= TRACK_MIN_LOG_ODDS:
            return Doubt.IN_BUFFER
        if person[away <= NEAR_MS].min() <= NEAR_MIN_LOG_ODDS:
            return Doubt.NEARBY
        if any(float(weights @ odds) <= POOL_MIN_LOG_ODDS * float(weights.sum()) for odds in (person, alone)):
            return Doubt.POOLED
        return Doubt.HIDDEN if self._may_hide_another(number, one.places[first + now], at_ms) else None

    def _may_hide_another(self, number: int, place: tuple[float, float], at_ms: int) -> bool:
        """Tell whether anybody who is not seen at that time was, or will be, seen close by."""
        for other, one in self._followed.items():
            if other == number:
                continue
            own = bisect_left(one.times, one.began_ms)
            after = max(own, bisect_left(one.times, at_ms))
            if after < len(one.times) and one.times[after] == at_ms:
                continue
            for near in (after - 1, after):
                if not own <= near < len(one.times) or abs(one.times[near] - at_ms) > UNSEEN_MS:
                    continue
                likely = max(one.person[max(own, near - 2) : near + 3]) > SOMEBODY_MIN_LOG_ODDS
                if likely and _could_be_near(one, near, place, at_ms):
                    return True
        return False

    def _forget(self, at_ms: int) -> None:
        if at_ms - self._forgot_ms < FORGET_EVERY_MS:
            return
        self._forgot_ms = at_ms
        for number, one in list(self._followed.items()):
            gone = bisect_left(one.times, at_ms - KEPT_MS)
            del one.times[:gone], one.places[:gone], one.person[:gone], one.alone[:gone]
            if not one.times:
                del self._followed[number]

    def _begin(self, body: Sighted, live: dict[int, _Followed], at_ms: int) -> _Followed:
        near = [one for one in live.values() if np.hypot(one.x_m - body.x_m, one.z_m - body.z_m) <= SPLIT_M]
        new = _Followed(body.x_m, body.z_m, at_ms)
        if near:
            worst = min(near, key=lambda one: min(*one.person, *one.alone))
            new.times, new.places = list(worst.times), list(worst.places)
            new.person, new.alone = list(worst.person), list(worst.alone)
        return new


def _could_be_near(one: _Followed, seen: int, place: tuple[float, float], at_ms: int) -> bool:
    """Tell whether a body, as it moved when it was seen, could be close to a place at another time."""
    span_ms = -SPEED_MS if one.times[seen] < at_ms else SPEED_MS
    other = min(bisect_left(one.times, max(one.began_ms, one.times[seen] + span_ms)), len(one.times) - 1)
    (x_m, z_m), (x0_m, z0_m) = one.places[seen], one.places[other]
    away_s = (at_ms - one.times[seen]) / 1000
    share = (at_ms - one.times[seen]) / (one.times[seen] - one.times[other]) if other != seen else 0.0
    moved = np.array([x_m - x0_m, z_m - z0_m]) * share
    length = float(np.hypot(*moved))
    moved *= min(1.0, WALKS_MAX_MPS * abs(away_s) / max(length, 1e-9))
    rest = float(np.hypot(x_m + moved[0] - place[0], z_m + moved[1] - place[1]))
    return min(rest, float(np.hypot(x_m - place[0], z_m - place[1]))) <= BESIDE_M + STRAYS_MPS * abs(away_s)


def _nearest(bodies: Sequence[Sighted], live: dict[int, _Followed]) -> dict[int, int]:
    if not bodies or not live:
        return {}
    numbers = list(live)
    away = np.array([[np.hypot(live[n].x_m - b.x_m, live[n].z_m - b.z_m) for n in numbers] for b in bodies])
    gate = np.array([SAME_M + SAME_PER_M * body.ahead_m for body in bodies])[:, None]
    rows, columns = linear_sum_assignment(np.where(away <= gate, away, _FAR))
    return {int(r): numbers[c] for r, c in zip(rows, columns, strict=True) if away[r, c] <= gate[r, 0]}

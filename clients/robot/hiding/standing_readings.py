"""Which readings tell whose tag it is, of a robot that drives: those from while it stood, of one place at a time."""

from __future__ import annotations

from bisect import insort
from typing import NamedTuple

from clients.robot.hiding.own_motion import OwnMotion, RobotPlace, Spot
from clients.robot.matching.matcher import Matcher
from clients.robot.sensing.sensor_events import Sighting

WAITING_MAX_COUNT = 4_096
# Of frames after a reading: so long the odometry may take to tell whether the robot stood, and readings to come late.
UNKNOWN_MAX_MS = 2_000


class _Waiting(NamedTuple):
    at_ms: int
    number: int  # no two are alike, so nothing after it is compared
    alias: str
    sighting: Sighting
    known: bool


class StandingReadings:
    """Readings wait until `motion` tells whether the robot stood. Its own motion would bind fast, and wrongly.

    One stop is weighed after the other, so that what comes late (by `UNKNOWN_MAX_MS`) ends as what comes in time.
    """

    def __init__(self, motion: OwnMotion) -> None:
        self._motion = motion
        self.unplaced_count = 0
        self.restart()

    def restart(self) -> None:
        """Readings that follow have another clock."""
        self._pushed_count = 0
        self._of_roster: list[_Waiting] = []  # in order of time
        self._of_strangers: list[_Waiting] = []
        self._listened_at: Spot | None = None  # where the robot stood when a reading last counted
        self._began_ms = self._listened_ms = 0  # the first and the last that counted there

    @property
    def waiting_count(self) -> int:
        return len(self._of_roster) + len(self._of_strangers)

    def push(self, alias: str, sighting: Sighting, *, known: bool = True) -> None:
        """If too many wait, one is dropped: rather a stranger's, and of these the latest, whose turn may never come."""
        self._pushed_count += 1
        waiting = self._of_roster if known else self._of_strangers
        insort(waiting, _Waiting(sighting.middle_ms, self._pushed_count, alias, sighting, known))
        if self.waiting_count > WAITING_MAX_COUNT:
            (self._of_strangers or self._of_roster).pop()
            self.unplaced_count += 1

    def weigh(self, matcher: Matcher, newest_ms: int) -> None:
        """Give a matcher what counts; `newest_ms`: of the newest frame."""
        while self.waiting_count:
            waiting = min(filter(None, (self._of_roster, self._of_strangers)))
            first = waiting[0]
            stood = self._motion.stands(first.at_ms)
            place = self._motion.place_at(first.at_ms) if stood else None
            is_settled = stood is False or (place is not None and self._is_same_stop(first.at_ms, place))
            if not is_settled and newest_ms < first.at_ms + UNKNOWN_MAX_MS:
                return
            del waiting[0]
            self.unplaced_count += stood is None
            if place is not None and self._counts(matcher, first.at_ms, place):
                matcher.add_sighting(first.alias, first.sighting, known=first.known)

    def _is_same_stop(self, at_ms: int, place: RobotPlace) -> bool:
        """Of another stop, readings may come late that are to be weighed before this one."""
        spot = self._listened_at
        if spot is None or at_ms <= self._listened_ms:
            return spot is not None
        return spot.has(place) and self._motion.keeps_to(spot, self._listened_ms, at_ms)

    def _counts(self, matcher: Matcher, at_ms: int, place: RobotPlace) -> bool:
        """From one place to the next, distances change by the robot's own motion: that tells nothing of who wears a tag.

        What comes later than others of another place is dropped: it cannot be weighed with those of its own any more.
        """
        spot = self._listened_at
        if spot is not None and at_ms <= self._listened_ms:
            return at_ms >= self._began_ms and spot.has(place)
        if spot is None or not spot.holds(place):
            if spot is not None:
                matcher.advance(self._listened_ms)  # what was heard there may have come in a heap with this one
                matcher.forget_evidence()
            self._listened_at, self._began_ms = Spot(place), at_ms
        self._listened_ms = at_ms
        return True

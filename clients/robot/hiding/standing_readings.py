"""Which readings tell whose tag it is, of a robot that drives: those from while it stood, of one place at a time."""

from __future__ import annotations

from collections import deque

from clients.robot.hiding.own_motion import OwnMotion, RobotPlace, Spot
from clients.robot.matching.matcher import Matcher
from clients.robot.sensing.sensor_events import Sighting

WAITING_MAX_COUNT = 4_096
UNKNOWN_MAX_MS = 2_000  # of frames after a reading: so long the odometry may take to tell whether the robot stood


class StandingReadings:
    """Readings wait until `motion` tells whether the robot stood. Its own motion would bind fast, and wrongly."""

    def __init__(self, motion: OwnMotion) -> None:
        self._motion = motion
        self.unplaced_count = 0
        self.restart()

    def restart(self) -> None:
        """Readings that follow have another clock."""
        self._waiting: deque[tuple[str, Sighting, bool]] = deque(maxlen=WAITING_MAX_COUNT)
        self._listened_at: Spot | None = None  # where the robot stood when a reading last counted

    @property
    def waiting_count(self) -> int:
        return len(self._waiting)

    def push(self, alias: str, sighting: Sighting, *, known: bool = True) -> None:
        self._waiting.append((alias, sighting, known))

    def weigh(self, matcher: Matcher, newest_ms: int) -> None:
        """Give a matcher what counts; `newest_ms`: of the newest frame."""
        for _ in range(len(self._waiting)):
            alias, sighting, known = self._waiting.popleft()
            stood = self._motion.stands(sighting.middle_ms)
            if stood:
                self._begin_anew_elsewhere(matcher, self._motion.place_at(sighting.middle_ms))
                matcher.add_sighting(alias, sighting, known=known)
            elif stood is None and newest_ms < sighting.middle_ms + UNKNOWN_MAX_MS:
                self._waiting.append((alias, sighting, known))
            else:
                self.unplaced_count += stood is None

    def _begin_anew_elsewhere(self, matcher: Matcher, place: RobotPlace | None) -> None:
        """From one place to the next, distances change by the robot's own motion: that tells nothing of who wears a tag."""
        if place is None:
            return
        if self._listened_at is None:
            self._listened_at = Spot(place)
        elif not self._listened_at.holds(place):
            matcher.forget_evidence()
            self._listened_at = Spot(place)

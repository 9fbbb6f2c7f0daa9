"""Puts input on one timeline and rate-limits readings.

Pairing gets every reading; matching, log and aliases a thinned stream, roster and strangers limited apart.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter
from dataclasses import dataclass, field
from typing import Annotated

from clients.robot.pairing.rosters import UnknownTagCounts, UnknownTags
from clients.robot.pairing.tag_pairing import Pairing
from clients.robot.sensing.sensor_clocks import DeviceClock, RunClocks
from clients.robot.sensing.sensor_events import Sighting
from clients.sdk.terminal.json_answers import Answer, Count, doc

APART_MS = 50  # readings of one tag by one antenna that are closer tell matching nothing new
KNOWN_MAX_PER_S = 200
STRANGERS_MAX_PER_S = 50
READINGS_MAX_COUNT = 256  # remembered of one tag and antenna
TAGS_MAX_COUNT = 4_096  # remembered, tags times antennas
FORGET_EVERY_MS = 10_000
MEMORY_MS = 30_000
TELL_EVERY_MS = 10_000


class PipelineIntake(Answer, frozen=True, kw_only=True):
    """What the pipeline found of its input."""

    clocks: Annotated[dict[str, DeviceClock], doc("What was found of each device's clock")]
    turned_away: Annotated[dict[str, Count], doc("How much was rejected for its time, by reason")]
    sightings_late: Annotated[Count, doc("Tag readings that came too late")]
    sightings_shortened: Annotated[Count, doc("Tag readings whose uncertain end was cut")]
    sightings_only_paired: Annotated[Count, doc("Tag readings that were thinned out")]
    timelines: Annotated[Count, doc("How many timelines the timestamps made")]
    unknown_tags: Annotated[UnknownTagCounts, doc("Tags that are not on the roster")]


@dataclass(slots=True)
class _Gate:
    """Limits readings per second, and spacing per tag and antenna."""

    limit: int
    _second: int = 0
    _passed: int = 0
    _readings: dict[tuple[str, int], list[int]] = field(default_factory=dict)
    _forgot_ms: int = 0

    def takes(self, sighting: Sighting) -> bool:
        at_ms = sighting.last_seen_ms if sighting.received_at_ms is None else sighting.received_at_ms
        second = at_ms // 1000
        if second > self._second or second < self._second - MEMORY_MS // 1000:  # older by less: out of order
            self._second, self._passed = second, 0
        if self._passed >= self.limit or not self._is_apart(sighting):
            return False
        self._passed += 1
        return True

    def _is_apart(self, sighting: Sighting) -> bool:
        at, key = sighting.middle_ms, (sighting.uid, sighting.antenna)
        if abs(at - self._forgot_ms) > FORGET_EVERY_MS:
            self._forget(at)
        times = self._readings.get(key)
        if times is None:
            if len(self._readings) >= TAGS_MAX_COUNT:
                return False
            self._readings[key] = [at]
            return True
        place = bisect_left(times, at - APART_MS + 1)
        if place < len(times) and times[place] < at + APART_MS:
            return False
        if len(times) >= READINGS_MAX_COUNT:
            if at < times[0]:
                return False
            del times[0]
        insort(times, at)
        return True

    def _forget(self, at_ms: int) -> None:
        self._forgot_ms = at_ms
        self._readings = {key: times for key, times in self._readings.items() if abs(at_ms - times[-1]) <= MEMORY_MS}


@dataclass(slots=True)
class InputThrottle:
    """Throttle before the pipeline; `only_paired_count` readings went to pairing alone."""

    clocks: RunClocks = field(default_factory=RunClocks)
    only_paired_count: int = 0
    _known: _Gate = field(default_factory=lambda: _Gate(KNOWN_MAX_PER_S))
    _strangers: _Gate = field(default_factory=lambda: _Gate(STRANGERS_MAX_PER_S))
    _told_ms: int | None = None
    _told_turned_away: Counter[str] = field(default_factory=Counter)

    def weighs(self, sighting: Sighting, *, known: bool) -> bool:
        """Return whether a sighting also goes to matching and log."""
        passes = (self._known if known else self._strangers).takes(sighting)
        self.only_paired_count += not passes
        return passes

    def is_time_to_tell(self) -> bool:
        now = self.clocks.newest_ms
        if now is None or (self._told_ms is not None and abs(now - self._told_ms) < TELL_EVERY_MS):
            return False
        self._told_ms = now
        return True

    def newly_turned_away(self, pairing: Pairing) -> list[tuple[str, int]]:
        """Return (reason, count) of rejections since the last call."""
        now = self._turned_away(pairing)
        new = now - self._told_turned_away
        self._told_turned_away = now
        return sorted(new.items())

    def summarise(self, pairing: Pairing, unknown_tags: UnknownTags) -> PipelineIntake:
        return PipelineIntake(
            clocks={name: estimate.summarise() for name, estimate in self.clocks.estimates().items()},
            turned_away=dict(sorted(self._turned_away(pairing).items())),
            sightings_late=pairing.late_count,
            sightings_shortened=self.clocks.shortened_count,
            sightings_only_paired=self.only_paired_count,
            timelines=pairing.timeline_count,
            unknown_tags=unknown_tags.summarise(),
        )

    def _turned_away(self, pairing: Pairing) -> Counter[str]:
        return Counter(self.clocks.refused) + Counter(pairing.refused)

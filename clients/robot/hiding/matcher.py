"""Binds tags to tracks by likelihood over the whole track, against every rival and against an absent bearer. Pure.

A binding needs log-odds of 9.2 and ends below 0. Readings without distance bind nothing, since from them one person
in the picture cannot be told from another, nor from someone outside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from clients.robot.events import Facing, Sighting
from clients.robot.hiding.likelihood import RangeReading, log_absent, log_antenna, log_sum, log_visible
from clients.robot.hiding.tracking import Track

PRIOR_ABSENT = 0.3
BIND_LOG_ODDS = 9.2
UNBIND_LOG_ODDS = 0.0
EVIDENCE_MS = 30_000
READINGS_MIN_COUNT = 4
READINGS_MAX_COUNT = 128


@dataclass(slots=True)
class _Tag:
    """What is known of one tag: readings in time order, and the tracks it is bound to with their log-odds."""

    readings: list[Sighting] = field(default_factory=list)
    bound: dict[int, Track] = field(default_factory=dict)
    odds: dict[int, float] = field(default_factory=dict)


class Matcher:
    """Holds the readings of each tag (by alias) and decides which track, if any, is its bearer."""

    def __init__(self) -> None:
        self._tags: dict[str, _Tag] = {}
        self._tracks: dict[int, Track] = {}

    def add_track(self, track: Track) -> None:
        """Take notice of a track; asking again does nothing."""
        self._tracks[track.number] = track

    def add_sighting(self, alias: str, sighting: Sighting) -> None:
        """Take a reading, which may be out of order; an exact duplicate counts once."""
        tag = self._tags.setdefault(alias, _Tag())
        if sighting in tag.readings:
            return
        tag.readings.append(sighting)
        tag.readings.sort(key=lambda reading: reading.middle_ms)
        del tag.readings[:-READINGS_MAX_COUNT]

    def evaluate(self, alias: str) -> None:
        """Weigh one tag anew: bind at 9.2, unbind below 0."""
        tag = self._tags.get(alias)
        if tag is None:
            return
        tracks = list(self._tracks.values())
        ratios = {track.number: self._ratio(tag.readings, track) for track in tracks}
        for track in tracks:
            ratio = ratios[track.number]
            if ratio is None:
                continue
            rivals = [o for o in tracks if o.number != track.number and o.overlaps(track)]
            rival_ratios = [r for r in (ratios[rival.number] for rival in rivals) if r is not None]
            odds = _log_odds(ratio, rival_ratios)
            tag.odds[track.number] = odds
            if odds >= BIND_LOG_ODDS:
                tag.bound[track.number] = track
            elif odds < UNBIND_LOG_ODDS:
                tag.bound.pop(track.number, None)

    def bound_track(self, alias: str, present: Sequence[int]) -> int | None:
        """Return the one track of `present` that the tag is bound to; None if none, several, or another tag's too."""
        tag = self._tags.get(alias)
        if tag is None:
            return None
        mine = [number for number in present if number in tag.bound]
        if len(mine) != 1:
            return None
        shared = any(mine[0] in other.bound for name, other in self._tags.items() if name != alias)
        return None if shared else mine[0]

    def is_elsewhere(self, alias: str, at_ms: int) -> bool:
        """Whether the tag's bearer is known but not followed at that time, so that nobody then seen is the bearer."""
        tag = self._tags.get(alias)
        return (
            tag is not None
            and bool(tag.bound)
            and not any(track.began_ms <= at_ms <= track.seen_ms for track in tag.bound.values())
        )

    def has_distance(self, alias: str) -> bool:
        """Whether any reading of the tag came with a distance."""
        tag = self._tags.get(alias)
        return tag is not None and any(reading.distance_m is not None for reading in tag.readings)

    def log_odds(self, alias: str) -> dict[int, float]:
        """Return the newest log-odds of each track for a tag, for explanation and tests."""
        tag = self._tags.get(alias)
        return dict(tag.odds) if tag is not None else {}

    def forget_before(self, at_ms: int) -> None:
        """Drop ended tracks and readings that can no longer matter."""
        horizon = at_ms - EVIDENCE_MS
        gone = [n for n, track in self._tracks.items() if track.seen_ms < horizon]
        for number in gone:
            del self._tracks[number]
        for alias, tag in list(self._tags.items()):
            for number in gone:
                tag.bound.pop(number, None)
                tag.odds.pop(number, None)
            tag.readings = [reading for reading in tag.readings if reading.middle_ms >= horizon]
            if not tag.readings and not tag.bound:
                del self._tags[alias]

    @staticmethod
    def _ratio(sightings: Sequence[Sighting], track: Track) -> float | None:
        """Return log(likelihood if this track wears the tag / if its bearer is absent); None with too few readings."""
        compared: list[RangeReading] = []
        front = back = 0
        for sighting in sightings:
            person_m = track.range_at(sighting.middle_ms)
            if person_m is None:
                continue
            front += sighting.facing is Facing.FRONT
            back += sighting.facing is Facing.BACK
            if sighting.distance_m is not None and sighting.sigma_m is not None:
                compared.append(RangeReading(sighting.middle_ms, sighting.distance_m, sighting.sigma_m, person_m))
        if len(compared) < READINGS_MIN_COUNT:
            return None
        return log_visible(compared) - log_absent(compared) + log_antenna(front, back)


def _log_odds(ratio: float, rivals: Sequence[float]) -> float:
    """Return the posterior log-odds of one track against absence and all rivals."""
    share = math.log((1 - PRIOR_ABSENT) / (1 + len(rivals)))
    against = [math.log(PRIOR_ABSENT), *(share + rival for rival in rivals)]
    return share + ratio - log_sum(against)

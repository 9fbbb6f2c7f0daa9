"""Readings of drawn people's tags, by a reader with one antenna ahead and one behind, or with antennas that look to sides.

Backscatter passes an antenna's beam twice. What a tag and its bearer's body do is the same for all antennas at a time; what
reflections do is not, and changes over some decimetres, and in part from one reading to the next as the reader changes its
channel. The figures are assumptions of the scenes, not measurements of a reader.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clients.robot.sensing.sensor_events import Facing
from clients.robot.synthetic.scenario import Antenna, Person, Reader, Scenario

RSSI_AT_1M_DBM = -48.0
BEAM_DEG = 65.0  # where a patch antenna's beam has lost 3 dB
BEHIND_DB = 18.0  # what it has lost elsewhere, at most
BODY_SIGMA_DB = 4.0
FADING_SIGMA_DB = 5.0
FADING_STAYS_SHARE = 0.6
FADING_M = 0.15
SWAY_M_PER_S = 0.05  # nobody stands quite still
HEARD_MIN_DBM = -84.0
SWITCHED_S = 0.04  # from one antenna to the next
ROUND_S = 0.2  # all antennas in turn; a distance is told no more often than by a reader without such antennas

SeenFrom = Callable[[Person, float], tuple[float, float, float] | None]


@dataclass(slots=True, eq=False)
class Reading:
    """One reading: when it was made and arrives (s), whose tag, and what was measured."""

    alias: str
    at_s: float
    arrives_s: float
    antenna: int
    facing: Facing
    rssi_dbm: float
    distance_m: float | None
    sigma_m: float | None


def readings(scenario: Scenario, seen: SeenFrom | None = None) -> list[Reading]:
    """Return received readings in arrival order, without absent people's; `seen`: where a tag is from the reader."""
    seen = scenario.seen_from_robot if seen is None else seen
    made: list[Reading] = []
    for number, person in enumerate(scenario.people):
        if person.alias in scenario.absent:
            continue
        rng = np.random.default_rng([scenario.seed, 2, number])
        fate = np.random.default_rng([scenario.seed, 3, number])
        fading = _Fading(scenario.reader.antennas, np.random.default_rng([scenario.seed, 4, number]))
        for at_s in _times_s(person, scenario.reader):
            place = seen(person, at_s)
            missed, late_s = fate.random() < scenario.reader.missed, fate.random() * scenario.reader.late_s
            if place is None:
                continue
            if scenario.reader.antennas:
                made += fading.hear(person, at_s, late_s, place, scenario.reader)
                continue
            reading = _by_facing(person.alias, at_s, place, scenario.reader, rng)
            reading.arrives_s += late_s
            if not missed:
                made.append(reading)
    return sorted(made, key=lambda reading: reading.arrives_s)


def _times_s(person: Person, reader: Reader) -> Sequence[float]:
    if reader.antennas and person.also_every_s:
        return replace(person, also_every_s=min(ROUND_S, person.also_every_s)).reading_times_s()
    return person.reading_times_s()


def _by_facing(
    alias: str, at_s: float, place: tuple[float, float, float], reader: Reader, rng: np.random.Generator
) -> Reading:
    right, up, ahead = place
    distance_m = math.hypot(right, ahead, up)
    measured_m = max(0.1, distance_m + float(rng.normal(0, reader.distance_sigma_m)))
    front = bool(rng.random() >= reader.front_misread) != (ahead < 0)
    rssi_dbm = RSSI_AT_1M_DBM - 20 * float(np.log10(distance_m)) + float(rng.normal(0, 1.5))
    antenna, facing = (reader.antenna_front, Facing.FRONT) if front else (reader.antenna_back, Facing.BACK)
    return Reading(alias, at_s, at_s, antenna, facing, rssi_dbm, measured_m, reader.distance_sigma_m)


def beam_loss_db(off_deg: float) -> float:
    """Return what an antenna's beam has lost so far from its axis, once: 3 dB at half of `BEAM_DEG`."""
    off_deg = abs((off_deg + 180) % 360 - 180)
    return min(12 * (off_deg / BEAM_DEG) ** 2, BEHIND_DB)


class _Fading:
    """What each antenna's signal of one tag loses by reflections."""

    def __init__(self, antennas: tuple[Antenna, ...], rng: np.random.Generator) -> None:
        self._rng = rng
        self._stays = rng.normal(size=len(antennas))
        self._before: tuple[float, float, tuple[float, float, float]] | None = None  # walked (m), at (s), place
        self._measured_s = -math.inf

    def hear(
        self, person: Person, at_s: float, late_s: float, place: tuple[float, float, float], reader: Reader
    ) -> list[Reading]:
        right, up, ahead = place
        distance_m = math.hypot(right, ahead, up)
        bearing_deg = math.degrees(math.atan2(right, ahead))
        walked_m = person.walked_m(at_s)
        if self._before is not None:
            walked_before_m, before_s, place_before = self._before
            moved_m = max(abs(walked_m - walked_before_m), math.dist(place, place_before))  # the robot may move, too
            moved_m += SWAY_M_PER_S * (at_s - before_s)
            kept = math.exp(-moved_m / FADING_M)
            self._stays = kept * self._stays + math.sqrt(1 - kept**2) * self._rng.normal(size=self._stays.size)
        self._before = walked_m, at_s, place
        fresh = self._rng.normal(size=self._stays.size)
        fading = FADING_SIGMA_DB * (
            math.sqrt(FADING_STAYS_SHARE) * self._stays + math.sqrt(1 - FADING_STAYS_SHARE) * fresh
        )
        level_dbm = RSSI_AT_1M_DBM - 40 * math.log10(distance_m) + float(self._rng.normal(0, BODY_SIGMA_DB))
        measured_m = max(0.1, distance_m + float(self._rng.normal(0, reader.distance_sigma_m)))
        heard: list[Reading] = []
        for turn, (antenna, faded_db) in enumerate(zip(reader.antennas, fading.tolist(), strict=True)):
            rssi_dbm = level_dbm - 2 * beam_loss_db(bearing_deg - antenna.looks_deg) + faded_db
            missed = self._rng.random() < reader.missed
            if rssi_dbm < HEARD_MIN_DBM or missed:
                continue
            facing = Facing.FRONT if abs(antenna.looks_deg) < 90 else Facing.BACK
            when_s = at_s + turn * SWITCHED_S
            heard.append(
                Reading(person.alias, when_s, when_s + late_s, antenna.number, facing, round(rssi_dbm), None, None)
            )
        if heard and at_s >= self._measured_s + person.also_every_s - 1e-6:  # by the antenna that hears best
            self._measured_s = at_s
            best = max(heard, key=lambda reading: reading.rssi_dbm)
            best.distance_m, best.sigma_m = measured_m, reader.distance_sigma_m
        return heard

"""The judge's scenes by seed and stratum, disjoint for training and judging; and an attacker's view of one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from clients.robot.sensing.antenna_calibration import calibrate
from clients.robot.sensing.antenna_pairs import AntennaPair
from clients.robot.sensing.sensor_events import Depth, Mask, Sighting
from clients.robot.synthetic.scenario import Antenna, Scenario, without
from clients.robot.synthetic.scenes import PAIR_STRATA, draw_scene
from clients.robot.synthetic.tag_readings import Reading, readings

LEARNING, JUDGING = 1, 2
DURATION_S = 12.0
# Readers of the judge by their number of antennas: where each looks, in degrees to the right of the camera's axis.
ANTENNAS = {
    1: (Antenna(1, 0.0),),
    2: (Antenna(1, -35.0), Antenna(2, 35.0)),
    4: (Antenna(1, -35.0), Antenna(2, 35.0), Antenna(3, 145.0), Antenna(4, -145.0)),
}
CALIBRATION_S, CROSSING_S, CAMERA_SIGMA_DEG = 180.0, 4.0, 0.5
BLUR_PX = 51  # the Gaussian of the paper's prototype


@dataclass(frozen=True, slots=True)
class Scene:
    """One drawn scene: seed, number, stratum, scenario."""

    seed: int
    number: int
    stratum: str
    scenario: Scenario
    antenna_pairs: tuple[AntennaPair, ...] = ()

    @property
    def owners(self) -> dict[str, int]:
        return {person.alias: n for n, person in enumerate(self.scenario.people, start=1) if person.tagged}

    def alone(self, alias: str) -> Scenario:
        return without(self.scenario, *(person.alias for person in self.scenario.people if person.alias != alias))


def draw_scenes(
    seed: int, count: int, purpose: int, *, duration_s: float = DURATION_S, antennas: int = 0
) -> list[Scene]:
    """Two or three people, cycling through the strata. No scene of one purpose is drawn for another.

    `antennas` (`ANTENNAS`): of a reader whose readings follow their beams; 0: one that tells front and back.
    """
    scenes = []
    pairs = walk_calibration(antennas, seed) if antennas > 1 else ()
    for number in range(count):
        stratum = PAIR_STRATA[number % len(PAIR_STRATA)]
        entropy = int(np.random.SeedSequence([seed, purpose, number]).generate_state(1)[0])
        scenario = draw_scene(entropy, stratum, duration_s=duration_s)
        if antennas:
            scenario = with_antennas(scenario, antennas)
        scenes.append(Scene(seed, number, stratum, scenario, pairs))
    return scenes


def with_antennas(scenario: Scenario, antennas: int) -> Scenario:
    return replace(scenario, reader=replace(scenario.reader, antennas=ANTENNAS[antennas]))


def walk_calibration(antennas: int, seed: int) -> tuple[AntennaPair, ...]:
    """Return what the robot measures of its antennas while one person walks before it."""
    drawn = draw_scene(seed, "single", duration_s=CALIBRATION_S)
    way = ((-1.0, 2.0), (1.0, 2.0), (1.6, 3.5), (-1.6, 3.5))
    times_s = np.arange(0.0, CALIBRATION_S + CROSSING_S, CROSSING_S).tolist()
    path = tuple((at_s, *way[turn % len(way)]) for turn, at_s in enumerate(times_s))
    people = (replace(drawn.people[0], path=path, facing=()),)
    scenario = with_antennas(replace(drawn, people=people), antennas)
    rng = np.random.default_rng([seed, antennas])
    seen = []
    for at_ms in range(0, round(1000 * CALIBRATION_S), 100):
        place = scenario.seen_from_robot(scenario.people[0], at_ms / 1000)
        if place is not None:
            bearing_deg = math.degrees(math.atan2(place[0], place[2]))
            seen.append((at_ms, bearing_deg + float(rng.normal(0, CAMERA_SIGMA_DEG))))
    return calibrate(seen, [sighting for _, _, sighting in sightings(readings(scenario))]).pairs


def sightings(read: Iterable[Reading]) -> list[tuple[int, str, Sighting]]:
    """(arrival in ms, alias, sighting), by arrival."""
    made = []
    for one in read:
        at_ms = round(one.at_s * 1000)
        measured = (one.antenna, one.facing, one.rssi_dbm, one.distance_m, one.sigma_m)
        made.append((round(one.arrives_s * 1000), one.alias, Sighting(at_ms, at_ms, "", *measured)))
    return made


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A half-resolution picture: depth in mm, median empty frame, owner's pixels.

    Every attacker gets the owner's outline, as a thief may know the owner.
    """

    picture: Depth
    empty: Depth
    owner: Mask


def half_view(picture: Depth, empty: Depth, owner: Mask) -> View:
    return View(
        np.ascontiguousarray(picture[::2, ::2]),
        np.ascontiguousarray(empty[::2, ::2]),
        np.ascontiguousarray(owner[::2, ::2]),
    )


def show_owner_only(kept: Depth, recorded_empty: Depth) -> Depth:
    """Our rendition as displayed: the owner's non-zero pixels on a recorded empty frame."""
    return np.where(kept > 0, kept, recorded_empty)


def blur_others(picture: Depth, others: Mask) -> Depth:
    blurred = cv2.GaussianBlur(picture.astype(np.float32), (BLUR_PX, BLUR_PX), 0)
    return np.where(others, np.rint(blurred), picture).astype(np.uint16)

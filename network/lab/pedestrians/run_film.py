"""Plays the film through the robot's redactor with drawn tags."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.frame_redactor import FrameRedactor, KeptFrame, Output, WithheldFrame
from clients.robot.hiding.segmentation import segment
from clients.robot.matching.tracking import Tracker
from clients.robot.sensing.sensor_events import Depth, Facing, Frame, Sighting
from network.lab.pedestrians.film import FOCAL_PX, FRAME_MS, Film, background_of, depth_of

READ_EVERY_FRAMES = 5
SIGMA_M = 0.3
FOLLOWED_MIN_FRAMES = 40
_CUT_MARGIN_PX = 4  # a cut's box begins so far before its silhouette's


@dataclass(slots=True)
class Followed:
    """A followed person: frames, distances (m), cut's box origin (x, y) in each."""

    number: int
    ranges_m: dict[int, float] = field(default_factory=dict)
    corners: dict[int, tuple[int, int]] = field(default_factory=dict)


@dataclass(slots=True)
class Seen:
    """The first pass's followed people, and silhouettes by trouble."""

    followed: dict[int, Followed] = field(default_factory=dict)
    withhold_reasons: Counter[str] = field(default_factory=Counter)


@dataclass(slots=True)
class Played:
    """Each tag bearer's renditions, and what in them is not the bearer.

    `whole`: frames with only the bearer in view, which colour, being uncut, may keep.
    """

    kept: dict[str, list[KeptFrame]] = field(default_factory=dict)
    withheld: dict[str, Counter[str]] = field(default_factory=dict)
    of_others: Counter[str] = field(default_factory=Counter)
    whole: Counter[str] = field(default_factory=Counter)


def work_out_depths(film: Film) -> list[Depth]:
    return [depth_of(film, frame) for frame in film.frames]


def follow_everybody(film: Film, depths: list[Depth]) -> Seen:
    background, companions, tracker, seen = background_of(film), CompanionWatch(), Tracker(), Seen()
    for index, depth in enumerate(depths):
        at_ms = index * FRAME_MS
        silhouettes = companions.step(segment(depth, background, FOCAL_PX).silhouettes, at_ms)
        for silhouette, track in zip(silhouettes, tracker.step(silhouettes, at_ms), strict=True):
            seen.withhold_reasons[silhouette.withhold_reason or "clear"] += 1
            if track is not None:
                one = seen.followed.setdefault(track.number, Followed(track.number))
                one.ranges_m[index] = silhouette.range_m
                left, top = silhouette.box[:2]
                one.corners[index] = (max(0, 2 * left - _CUT_MARGIN_PX), max(0, 2 * top - _CUT_MARGIN_PX))
    return seen


def choose_bearers(seen: Seen, count: int) -> dict[str, Followed]:
    longest = sorted(seen.followed.values(), key=lambda one: (-len(one.ranges_m), one.number))[:count]
    bearers = sorted((one for one in longest if len(one.ranges_m) >= FOLLOWED_MIN_FRAMES), key=lambda one: one.number)
    return {f"person-{place}": one for place, one in enumerate(bearers, 1)}


def draw_readings(bearers: dict[str, Followed], seed: int) -> dict[int, list[tuple[str, Sighting]]]:
    random = np.random.default_rng(seed)
    readings: dict[int, list[tuple[str, Sighting]]] = {}
    for alias, one in bearers.items():
        for index in list(one.ranges_m)[::READ_EVERY_FRAMES]:
            distance_m = max(0.1, one.ranges_m[index] + float(random.normal(0.0, SIGMA_M)))
            at_ms = index * FRAME_MS
            sighting = Sighting(at_ms, at_ms, "", 1, Facing.FRONT, -50.0, distance_m, SIGMA_M)
            readings.setdefault(index, []).append((alias, sighting))
    return readings


def play(film: Film, depths: list[Depth], bearers: dict[str, Followed], seed: int) -> Played:
    redactor, readings = FrameRedactor(background_of(film), focal_px=FOCAL_PX), draw_readings(bearers, seed)
    played = Played({alias: [] for alias in bearers}, {alias: Counter() for alias in bearers})
    for index, depth in enumerate(depths):
        for alias, sighting in readings.get(index, []):
            _take(played, bearers, redactor.push_sighting(alias, sighting))
        _take(played, bearers, redactor.push_frame(Frame(index * FRAME_MS, index, depth)))
    _take(played, bearers, redactor.flush())
    return played


def _take(played: Played, bearers: dict[str, Followed], outputs: list[Output]) -> None:
    for output in outputs:
        if isinstance(output, WithheldFrame):
            played.withheld[output.alias][output.reason.value] += 1
        elif isinstance(output, KeptFrame):
            played.kept[output.alias].append(output)
            played.whole[output.alias] += output.alone
            corner = bearers[output.alias].corners.get(output.sequence)
            played.of_others[output.alias] += corner != (output.cutout.x, output.cutout.y)

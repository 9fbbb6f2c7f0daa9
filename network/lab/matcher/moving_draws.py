"""Draws half a minute of a robot that drives, of people in plan, and of one tag's readings, with truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from clients.robot.hiding.own_motion import RobotPlace
from clients.robot.sensing.sensor_events import Sighting
from clients.robot.synthetic.driving.odometry import measure_odometry
from clients.robot.synthetic.driving.robot_motion import EASING_S, Knot, drive_along
from network.lab.matcher.matcher_draws import (
    BEARINGS_DEG,
    FARTHEST_M,
    NEAREST_M,
    STANDING_SHARE,
    TIMES_S,
    TRACK_MS,
    VIEW_MAX_DEG,
    WALK_M_PER_S,
    Array,
    Setting,
    add_bearings,
    as_measured,
    draw_readings,
    front_shares,
    wander,
)

Story = Literal["stands", "straight", "past", "to-and-fro", "turn", "second-stop", "greet"]
STORIES: tuple[Story, ...] = get_args(Story)
GREETING_S = 12.0
STANDING_MPS, STANDING_RADPS = 0.01, 0.01

BODY_M = 0.25  # half as wide as a person
HIDDEN_SHARE = 0.65  # of a body's width that is behind others: it is not found
TOUCHING_M = 0.55  # between two people's axes: one silhouette
CLOSEST_M = 0.5  # to the robot
HEARD_MAX_M = 8.0
ODOMETRY_EVERY = 3  # of thirty samples a second
AT_START_SHARE = 0.5  # of people who are at their place when it begins; others come there later
ALONG_SHARE, TOGETHER_SHARE = 0.15, 0.15  # go along with the robot; go with the first person
AS_FAR_SHARE, AS_FAR_M = 0.5, (0.1, 1.5)  # are nearly as far away as the first person
ALONG_WANDER_MPS = 0.15
# An antenna that looks ahead hears to the sides; between front and back its share falls softly.
FRONT_UNTIL_DEG, FRONT_SOFT_DEG = 75.0, 8.0
# Where a bearer is who is not in view at that moment: degrees to either side, metres.
BESIDE_DEG = {"absent": (FRONT_UNTIL_DEG, 180.0), "behind": BEARINGS_DEG["behind"], "aside": BEARINGS_DEG["aside"]}
BESIDE_M = {"absent": (1.2, 10.0), "behind": (1.2, 5.0), "aside": (1.2, 5.0)}
IN_VIEW_M = (1.2, 5.0)

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class MovingDraw:
    """`ranges`, `bearings`: of each person (row) from the robot, by `TIMES_S`; `measured`: ranges as the camera has them.

    `in_view`: whom the camera can see; `touching`: of pairs, who are one silhouette; `driving`: whether the robot moves;
    `places`: its odometry, (when it arrives, place) in order of arrival; `bearer`: the row of who wears the tag.
    """

    setting: Setting
    story: Story
    ranges: Array
    bearings: Array
    measured: Array
    in_view: Flags
    touching: Flags
    driving: Flags
    places: tuple[tuple[int, RobotPlace], ...]
    readings: tuple[Sighting, ...]
    bearer: int


def draw_moving(setting: Setting, story: Story, seed: int, number: int) -> MovingDraw:
    rng = np.random.default_rng([seed, number, 2])
    track = drive_along(draw_knots(rng, story), TRACK_MS / 1000)
    table = np.array(track)
    way = np.stack([np.interp(TIMES_S, table[:, 0], table[:, column]) for column in (1, 2, 3)])
    people, bearer = _draw_people(rng, setting, story, way)
    ranges, bearings = locate(people, way)
    measured = np.stack([as_measured(rng, one) for one in ranges]) if setting.ranges_off else ranges
    front, back = (float(rng.beta(*front_shares(setting)[where])) for where in ("present", "behind"))
    readings = draw_readings(rng, setting, ranges[bearer], back + (front - back) * front_weight(bearings[bearer]))
    heard = [r for r in readings if np.interp(r.middle_ms / 1000, TIMES_S, ranges[bearer]) <= HEARD_MAX_M]
    readings = tuple(heard)
    if setting.bearing_sigma_deg is not None:
        worn = np.unwrap(bearings[bearer], period=360)
        readings = add_bearings(np.random.default_rng([seed, number, 3]), setting, readings, worn)
    samples = measure_odometry(track, int(rng.integers(2**31)))
    samples = samples[::ODOMETRY_EVERY]
    places = [(round(1000 * s.arrives_s), RobotPlace(round(1000 * s.at_s), s.x_m, s.z_m, s.yaw)) for s in samples]
    places.sort()
    in_view, touching = see(ranges, bearings)
    return MovingDraw(
        setting,
        story,
        ranges,
        bearings,
        measured,
        in_view,
        touching,
        is_driving(way),
        tuple(places),
        readings,
        bearer,
    )


def draw_knots(rng: np.random.Generator, story: Story) -> tuple[Knot, ...]:
    """Of legs of even speed, each at least as long as it takes to get to that speed."""
    speed, side = float(rng.uniform(0.2, 0.8)), float(rng.choice([-1.0, 1.0]))
    turn = side * np.radians(float(rng.uniform(10, 40)))

    def seconds(least: float, most: float) -> float:
        return float(rng.uniform(least, most))

    legs: list[tuple[float, float, float]] = [(seconds(4, 12), 0.0, 0.0)]
    if story == "straight":
        legs += [(TRACK_MS / 1000, speed, 0.0)]
    elif story == "past":
        legs = [(seconds(2, 6), 0.0, 0.0), (TRACK_MS / 1000, speed + 0.2, 0.0)]
    elif story == "to-and-fro":
        for way in (1, -1, 1, -1, 1, -1):
            legs += [(seconds(2, 5), way * speed * 0.75, 0.0)]
            legs += [(seconds(2, 5), 0.0, 0.0)] if rng.random() < 0.5 else []
    elif story == "turn":
        for _ in range(5):
            turn *= float(rng.choice([-1.0, 1.0]))
            legs += [(seconds(2, 5), 0.0, turn), (seconds(2, 6), 0.0, 0.0)]
    elif story == "second-stop":
        drives_s = seconds(2.5, 6)
        legs += [(drives_s, speed, turn / 2 if rng.random() < 0.4 else 0.0), (TRACK_MS / 1000, 0.0, 0.0)]
    elif story == "greet":
        legs = [
            (GREETING_S, 0.0, 0.0),
            (seconds(4, 9), speed, 0.0),
            (TRACK_MS / 1000, speed, rng.choice([0, 0.3]) * turn),
        ]
    knots: list[Knot] = []
    at_s = 0.0
    for lasts_s, ahead, turned in legs:
        knots += [(at_s + (EASING_S if knots else 0.0), ahead, float(turned)), (at_s + lasts_s, ahead, float(turned))]
        at_s += lasts_s
    return tuple(knots)


def is_driving(way: Array) -> Flags:
    x, z, yaw = (np.gradient(part, TIMES_S) for part in way)
    return np.asarray((np.hypot(x, z) > STANDING_MPS) | (np.abs(yaw) > STANDING_RADPS))


def locate(people: Sequence[Array], way: Array) -> tuple[Array, Array]:
    """Return ranges and bearings of people's paths (x, z by time) from the robot; nobody walks through it."""
    x, z, yaw = way
    ranges, bearings = [], []
    for path in people:
        east, north = path[0] - x, path[1] - z
        right, ahead = east * np.cos(yaw) - north * np.sin(yaw), east * np.sin(yaw) + north * np.cos(yaw)
        ranges.append(np.maximum(CLOSEST_M, np.hypot(right, ahead)))
        bearings.append(np.degrees(np.arctan2(right, ahead)))
    return np.stack(ranges), np.stack(bearings)


def see(ranges: Array, bearings: Array) -> tuple[Flags, Flags]:
    """Return who is in the camera's cone and range and not hidden by others; and which two of them touch."""
    half = np.degrees(np.arctan(BODY_M / ranges))
    covered = np.zeros(ranges.shape)
    touching = np.zeros((len(ranges), *ranges.shape), dtype=bool)
    right, ahead = ranges * np.sin(np.radians(bearings)), ranges * np.cos(np.radians(bearings))
    for one in range(len(ranges)):
        for other in range(len(ranges)):
            if one == other:
                continue
            apart = np.abs((bearings[one] - bearings[other] + 180) % 360 - 180)
            within = np.clip(half[one] + half[other] - apart, 0.0, 2 * half[one])
            covered[one] += np.where(ranges[other] < ranges[one], within / (2 * half[one]), 0.0)
            touching[one, other] = np.hypot(right[one] - right[other], ahead[one] - ahead[other]) < TOUCHING_M
    in_picture = (np.abs(bearings) <= VIEW_MAX_DEG) & (ranges >= NEAREST_M) & (ranges <= FARTHEST_M)
    in_view = in_picture & (covered <= HIDDEN_SHARE)
    return in_view, touching & in_picture[:, None] & in_picture


def front_weight(bearing_deg: Array) -> Array:
    """Return 1 for a tag that the antenna ahead faces, 0 for one that it looks away from."""
    return np.asarray(1 / (1 + np.exp((np.abs(bearing_deg) - FRONT_UNTIL_DEG) / FRONT_SOFT_DEG)))


def _draw_people(rng: np.random.Generator, setting: Setting, story: Story, way: Array) -> tuple[list[Array], int]:
    """Return the paths of all; of one who wears the tag and is not in view, the last."""
    first, as_far_m = _draw_person(rng, story, way, None)
    people = [first, *(_draw_person(rng, story, way, (first, as_far_m))[0] for _ in range(setting.people - 1))]
    if setting.bearer == "present":
        return people, int(rng.integers(setting.people))
    where = (BESIDE_DEG[setting.bearer], BESIDE_M[setting.bearer])
    beside = (first, as_far_m) if setting.bearer == "aside" else None
    return [*people, _draw_person(rng, story, way, beside, where)[0]], setting.people


def _draw_person(
    rng: np.random.Generator,
    story: Story,
    way: Array,
    first: tuple[Array, float] | None,
    where: tuple[tuple[float, float], tuple[float, float]] = ((0.0, VIEW_MAX_DEG - 3), IN_VIEW_M),
) -> tuple[Array, float]:
    """Return a path that is at some time `where` it is to be, and the range there; the first person's as `first`."""
    at = 0 if rng.random() < AT_START_SHARE or (first is None and story == "greet") else int(rng.integers(TIMES_S.size))
    (least_deg, most_deg), (least_m, most_m) = where
    bearing = np.radians(float(rng.choice([-1, 1]) * rng.uniform(least_deg, most_deg)))
    range_m = float(rng.uniform(least_m, most_m))
    if first is not None and rng.random() < AS_FAR_SHARE:
        range_m = float(np.clip(first[1] + rng.choice([-1, 1]) * rng.uniform(*AS_FAR_M), NEAREST_M, FARTHEST_M))
    x, z, yaw = way[:, at]
    place = np.array([x + range_m * np.sin(yaw + bearing), z + range_m * np.cos(yaw + bearing)])
    strays = np.stack([wander(rng, WALK_M_PER_S), wander(rng, WALK_M_PER_S)])
    kind = rng.random()
    if first is None and story == "greet":
        strays = way[:2] + strays * (ALONG_WANDER_MPS / WALK_M_PER_S)
    elif kind < STANDING_SHARE:
        strays = np.zeros_like(strays)
    elif kind < STANDING_SHARE + ALONG_SHARE:
        strays = way[:2] + strays * (ALONG_WANDER_MPS / WALK_M_PER_S)
    elif first is not None and kind < STANDING_SHARE + ALONG_SHARE + TOGETHER_SHARE:
        strays = first[0] + strays * (ALONG_WANDER_MPS / WALK_M_PER_S)
    sway = 0.03 * np.sin(TIMES_S * rng.uniform(0.5, 1.5) + rng.uniform(0, 6, (2, 1)))
    return place[:, None] + strays - strays[:, at : at + 1] + sway, range_m

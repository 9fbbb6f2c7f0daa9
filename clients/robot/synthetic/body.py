"""A person as capsules: build, gait and heading turned into line segments with a radius. Pure; knows no camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clients.robot.scenario import Person

STRIDE_M = 1.35
WALKING_MPS = 0.15
HEADING_STEP_S = 0.35
CHEST_HEIGHT_SHARE = 0.74

Points = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Capsules:
    """Segments from `start` to `end` (shape (n, 3): right, up from the floor, ahead; metres) with `radius` (n,)."""

    start: Points
    end: Points
    radius: Points


def chest_distance_m(person: Person, at_s: float, camera_height_m: float) -> float | None:
    """Return the distance from the camera to the tag on the person's chest, or None while not there."""
    place = person.place(at_s)
    if place is None:
        return None
    return math.hypot(place[0], place[1], CHEST_HEIGHT_SHARE * person.height_m - camera_height_m)


def heading_of(person: Person, at_s: float) -> tuple[float, float]:
    """Return (heading in radians, 0 = towards the robot; speed in m/s), from the path just before and after."""
    before = person.place(max(at_s - HEADING_STEP_S, person.path[0][0]))
    after = person.place(min(at_s + HEADING_STEP_S, person.path[-1][0]))
    if before is None or after is None:
        return 0.0, 0.0
    dx, dz = after[0] - before[0], after[1] - before[1]
    speed = math.hypot(dx, dz) / (2 * HEADING_STEP_S)
    if speed < WALKING_MPS:
        return 0.0, speed
    return math.atan2(dx, -dz), speed


def pose(person: Person, at_s: float) -> Capsules | None:
    """Return the person's body at a time, or None while not there."""
    place = person.place(at_s)
    if place is None:
        return None
    heading, speed = heading_of(person, at_s)
    phase = 2 * math.pi * person.walked_m(at_s) / STRIDE_M
    swing = min(speed / 1.0, 1.0) * 0.5
    sway = 0.01 * math.sin(2 * math.pi * 0.3 * person.cadence * at_s)
    rows = _limbs(person, phase, swing, sway)
    local = np.array([row[:6] for row in rows], dtype=np.float32).reshape(-1, 2, 3)
    cos, sin = math.cos(heading), math.sin(heading)
    right, up, ahead = local[..., 0], local[..., 1], local[..., 2]
    world = np.stack([place[0] + right * cos + ahead * sin, up, place[1] + right * sin - ahead * cos], axis=-1)
    radius = np.array([row[6] for row in rows], dtype=np.float32)
    return Capsules(start=world[:, 0].astype(np.float32), end=world[:, 1].astype(np.float32), radius=radius)


Row = tuple[float, float, float, float, float, float, float]


def _limbs(person: Person, phase: float, swing: float, sway: float) -> list[Row]:
    """Return capsule rows (right, up, ahead of both ends, radius) in the person's own frame."""
    h, g = person.height_m, person.girth
    hip, shoulder = 0.52 * h, 0.80 * h
    bob = 0.015 * swing * math.cos(2 * phase)
    hip, shoulder = hip + bob, shoulder + bob
    rows: list[Row] = [
        (sway, 0.925 * h + bob, 0.015, sway, 0.945 * h + bob, 0.015, 0.058 * h),
        (sway, shoulder, 0.0, sway, 0.90 * h + bob, 0.01, 0.036 * h),
        (-0.09 * h * g + sway, shoulder, 0, 0.09 * h * g + sway, shoulder, 0, 0.042 * h),
        (-0.055 * h * g + sway, 0.60 * h + bob, 0, -0.065 * h * g + sway, 0.755 * h + bob, 0, 0.068 * h * g),
        (0.055 * h * g + sway, 0.60 * h + bob, 0, 0.065 * h * g + sway, 0.755 * h + bob, 0, 0.068 * h * g),
        (sway, 0.60 * h + bob, 0, sway, 0.75 * h + bob, 0, 0.075 * h * g),
        (-0.045 * h * g, hip, 0, 0.045 * h * g, hip, 0, 0.070 * h * g),
    ]
    for side in (-1.0, 1.0):
        rows += _leg(h, g, side, hip, swing * math.sin(phase + (math.pi if side > 0 else 0.0)))
        rows += _arm(h, g, side, shoulder, sway, -swing * math.sin(phase + (math.pi if side > 0 else 0.0)))
    return rows


def _leg(h: float, g: float, side: float, hip: float, angle: float) -> list[Row]:
    x = side * 0.052 * h * g
    thigh, shin = 0.245 * h, 0.235 * h
    knee_bend = 0.35 * max(0.0, -angle) + 0.05
    knee = (x, hip - thigh * math.cos(angle), thigh * math.sin(angle))
    below = angle - knee_bend
    ankle = (x, max(knee[1] - shin * math.cos(below), 0.05), knee[2] + shin * math.sin(below))
    toe = (x + side * 0.02, max(ankle[1] - 0.02, 0.04), ankle[2] + 0.13 * h / 1.7)
    return [
        (x, hip, 0.0, *knee, 0.048 * h * g),
        (*knee, *ankle, 0.034 * h * g),
        (*ankle, *toe, 0.024 * h),
    ]


def _arm(h: float, g: float, side: float, shoulder: float, sway: float, angle: float) -> list[Row]:
    x = side * 0.125 * h * g + sway
    upper, fore = 0.175 * h, 0.20 * h
    elbow = (x + side * 0.02, shoulder - upper * math.cos(angle), upper * math.sin(angle))
    bent = angle + 0.35
    hand = (elbow[0], elbow[1] - fore * math.cos(bent), elbow[2] + fore * math.sin(bent))
    return [(x, shoulder - 0.01, 0.0, *elbow, 0.028 * h * g), (*elbow, *hand, 0.022 * h * g)]

"""People as capsules: build, gait, posture and heading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clients.robot.synthetic.props import LYING_M, SEAT_M, Row, aid_rows
from clients.robot.synthetic.scenario import Person

STRIDE_M = 1.35
TORSO_ROWS_COUNT = 7
ADULT_HEAD_SHARE, CHILD_HEAD_SHARE = 0.058, 0.078

Points = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Capsules:
    """Segments `start` to `end` (shape (n, 3): right, up, ahead; metres) with `radius` (n,). The last `props` belong to
    the aid.
    """

    start: Points
    end: Points
    radius: Points
    props: int = 0


def pose(person: Person, at_s: float) -> Capsules | None:
    """None while absent."""
    place = person.place(at_s)
    if place is None:
        return None
    heading, speed = person.heading(at_s)
    phase = 2 * math.pi * person.walked_m(at_s) / STRIDE_M
    swing = min(speed / 1.0, 1.0) * 0.5
    sway = 0.01 * math.sin(2 * math.pi * 0.3 * person.cadence * at_s)
    props = aid_rows(person)
    return place_rows([*_body(person, phase, swing, sway), *props], *place, heading, len(props))


def place_rows(rows: Sequence[Row], x: float, z: float, heading: float, props: int = 0) -> Capsules:
    """Return rows of a person or thing that stands at a place and looks along `heading` (0: against z)."""
    local = np.array([row[:6] for row in rows], dtype=np.float32).reshape(-1, 2, 3)
    cos, sin = math.cos(heading), math.sin(heading)
    right, up, ahead = local[..., 0], local[..., 1], local[..., 2]
    world = np.stack([x + right * cos + ahead * sin, up, z + right * sin - ahead * cos], axis=-1)
    radius = np.array([row[6] for row in rows], dtype=np.float32)
    return Capsules(world[:, 0].astype(np.float32), world[:, 1].astype(np.float32), radius, props)


def _body(person: Person, phase: float, swing: float, sway: float) -> list[Row]:
    if person.aid == "wheelchair":
        return _seated(person, sway)
    if person.aid == "bed":
        return _lying(person, sway)
    return _upright(person, phase, swing, sway)


def _upright(person: Person, phase: float, swing: float, sway: float) -> list[Row]:
    """Rows (right, up, ahead of both ends, radius) in the person's frame."""
    h, g = person.height_m, person.girth
    hip, shoulder = 0.52 * h, 0.80 * h
    bob = 0.015 * swing * math.cos(2 * phase) - 0.03 * person.limp * swing * math.cos(phase)
    hip, shoulder = hip + bob, shoulder + bob
    upper = _torso(person, hip, shoulder, bob, sway)
    rows: list[Row] = []
    for side in (-1.0, 1.0):
        turn = math.pi if side > 0 else 0.0
        stiff = 1.0 - 0.6 * person.limp if side > 0 else 1.0
        rows += _leg(h, g, side, hip, stiff * swing * math.sin(phase + turn))
        arm = _arm(person, side, shoulder, sway, -swing * math.sin(phase + turn))
        rows += _leant(arm, hip, person.stoop)
    return _leant(upper, hip, person.stoop) + rows


def _torso(person: Person, hip: float, shoulder: float, bob: float, sway: float) -> list[Row]:
    h, g = person.height_m, person.girth
    head = CHILD_HEAD_SHARE if person.kind == "child" else ADULT_HEAD_SHARE
    wide = g * person.shoulders
    rows: list[Row] = [
        (sway, 0.925 * h + bob, 0.015, sway, 0.945 * h + bob, 0.015, head * h),
        (sway, shoulder, 0.0, sway, 0.90 * h + bob, 0.01, 0.036 * h),
        (-0.09 * h * wide + sway, shoulder, 0, 0.09 * h * wide + sway, shoulder, 0, 0.042 * h),
        (-0.055 * h * g + sway, 0.60 * h + bob, 0, -0.065 * h * wide + sway, 0.755 * h + bob, 0, 0.068 * h * g),
        (0.055 * h * g + sway, 0.60 * h + bob, 0, 0.065 * h * wide + sway, 0.755 * h + bob, 0, 0.068 * h * g),
        (sway, 0.60 * h + bob, 0, sway, 0.75 * h + bob, 0, 0.075 * h * g),
        (-0.045 * h * g, hip, 0, 0.045 * h * g, hip, 0, 0.070 * h * g),
    ]
    if person.belly > 0:
        rows.append((sway, 0.58 * h, 0.05 * h, sway, 0.64 * h, 0.05 * h, (0.06 + 0.045 * person.belly) * h * g))
    if person.coat:
        for side in (-1.0, 0.0, 1.0):
            x = side * 0.055 * h * g
            rows.append((x, hip + 0.06 * h, 0.0, 1.5 * x, 0.30 * h, 0.0, 0.075 * h * g))
    return rows


def _leant(rows: list[Row], hip: float, angle: float) -> list[Row]:
    if angle == 0:
        return rows
    cos, sin = math.cos(angle), math.sin(angle)
    leant: list[Row] = []
    for x0, u0, a0, x1, u1, a1, radius in rows:
        up0, ahead0 = hip + (u0 - hip) * cos - a0 * sin, a0 * cos + (u0 - hip) * sin
        up1, ahead1 = hip + (u1 - hip) * cos - a1 * sin, a1 * cos + (u1 - hip) * sin
        leant.append((x0, up0, ahead0, x1, up1, ahead1, radius))
    return leant


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


def _arm(person: Person, side: float, shoulder: float, sway: float, angle: float) -> list[Row]:
    h, g = person.height_m, person.girth
    x = side * 0.125 * h * g * person.shoulders + sway
    upper, fore = 0.175 * h, 0.20 * h
    held = _held(person, side)
    if held is None:
        elbow = (x + side * 0.02, shoulder - upper * math.cos(angle), upper * math.sin(angle))
        bent = angle + 0.35
        hand = (elbow[0], elbow[1] - fore * math.cos(bent), elbow[2] + fore * math.sin(bent))
    else:
        (ex, eu, ea), (hx, hu, ha) = held
        elbow = (x + side * ex * h, shoulder + eu * h, ea * h)
        hand = (elbow[0] + side * hx * h, elbow[1] + hu * h, elbow[2] + ha * h)
    return [(x, shoulder - 0.01, 0.0, *elbow, 0.028 * h * g), (*elbow, *hand, 0.022 * h * g)]


Offset = tuple[float, float, float]
# Elbow from the shoulder and hand from the elbow: outwards, up, ahead; shares of the height.
_FORWARD: tuple[Offset, Offset] = ((0.015, -0.16, 0.06), (-0.02, -0.06, 0.18))
_HELD: dict[str, tuple[Offset, Offset]] = {
    "hooked": ((0.06, -0.16, 0.02), (0.02, -0.01, 0.15)),
    "around": ((0.02, -0.06, 0.15), (-0.09, 0.03, 0.14)),
    "forward": _FORWARD,
    "folded": ((0.01, -0.165, 0.04), (-0.16, 0.01, 0.09)),
    "raised": ((0.06, 0.13, 0.05), (-0.02, 0.19, 0.03)),
    "stick": ((0.03, -0.17, 0.02), (0.02, -0.14, 0.12)),
    "iv-pole": ((0.02, -0.15, 0.08), (0.0, 0.04, 0.18)),
}


def _held(person: Person, side: float) -> tuple[Offset, Offset] | None:
    arms, right = person.arms, side > 0
    if arms in ("around", "forward", "folded"):
        return _HELD[arms]
    if (arms == "hooked-right" and right) or (arms == "hooked-left" and not right):
        return _HELD["hooked"]
    if arms == "raised" and right:
        return _HELD["raised"]
    if person.aid in ("rollator", "wheelchair"):
        return _FORWARD
    if person.aid in ("stick", "iv-pole") and right:
        return _HELD[person.aid]
    return None


def _seated(person: Person, sway: float) -> list[Row]:
    h, g = person.height_m, person.girth
    hip = SEAT_M + 0.07 * h * g
    sunk = 0.52 * h - hip
    upper = _torso(person, 0.52 * h, 0.80 * h, 0.0, sway)[: TORSO_ROWS_COUNT + (person.belly > 0)]
    rows: list[Row] = [(x0, u0 - sunk, a0, x1, u1 - sunk, a1, r) for x0, u0, a0, x1, u1, a1, r in upper]
    for side in (-1.0, 1.0):
        x = side * 0.06 * h * g
        knee = (1.25 * x, hip + 0.01, 0.245 * h)
        ankle = (1.1 * x, max(knee[1] - 0.22 * h, 0.14), 0.245 * h + 0.06)
        rows.append((x, hip, 0.0, *knee, 0.05 * h * g))
        rows.append((*knee, *ankle, 0.034 * h * g))
        rows.append((*ankle, ankle[0], ankle[1] - 0.02, ankle[2] + 0.12, 0.024 * h))
        rows += _arm(person, side, 0.80 * h - sunk, sway, 0.0)
    return rows


def _lying(person: Person, sway: float) -> list[Row]:
    h = person.height_m
    upright = _upright(person, 0.0, 0.0, sway)
    rows: list[Row] = [
        (x0, LYING_M + 0.4 * a0, 0.5 * h - u0, x1, LYING_M + 0.4 * a1, 0.5 * h - u1, r)
        for x0, u0, a0, x1, u1, a1, r in upright
    ]
    rows += [(0.11 * s * h, LYING_M, -0.2 * h, 0.09 * s * h, LYING_M, 0.45 * h, 0.09) for s in (-1.0, 0.0, 1.0)]
    return rows

"""Furniture of wards as capsules and boxes, in many kinds; some are only for judging. Deterministic by generator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clients.robot.synthetic.body import Capsules, place_rows
from clients.robot.synthetic.driving.solids import Box, Faces, place_boxes
from clients.robot.synthetic.props import Row, empty_bed_rows, iv_pole_rows, rollator_rows, wheelchair_rows


@dataclass(frozen=True, slots=True)
class Shape:
    """Capsules and boxes (right, up, ahead; metres) around the place where a piece stands."""

    rows: tuple[Row, ...] = ()
    boxes: tuple[Box, ...] = ()

    def half_size(self) -> tuple[float, float]:
        """Return how far it reaches to the right or left and ahead or back, at most."""
        right, ahead = [], []
        for x0, _, a0, x1, _, a1, radius in self.rows:
            right += [abs(x0) + radius, abs(x1) + radius]
            ahead += [abs(a0) + radius, abs(a1) + radius]
        for x, _, a, width, _, length, turned in self.boxes:
            cos, sin = abs(math.cos(turned)), abs(math.sin(turned))
            right.append(abs(x) + (width * cos + length * sin) / 2)
            ahead.append(abs(a) + (width * sin + length * cos) / 2)
        return max(right), max(ahead)


@dataclass(frozen=True, slots=True)
class Piece:
    """A piece of furniture at a place, looking along `heading` (0: against z)."""

    kind: str
    shape: Shape
    x: float
    z: float
    heading: float

    def capsules(self, up_m: float) -> Capsules:
        placed = place_rows(self.shape.rows, self.x, self.z, self.heading)
        up = np.array([0, up_m, 0], dtype=np.float32)
        return Capsules(placed.start + up, placed.end + up, placed.radius)

    def faces(self, up_m: float, label: int) -> Faces:
        return place_boxes(self.shape.boxes, self.x, self.z, self.heading, up_m, label)


def make_shape(kind: str, rng: np.random.Generator) -> Shape:
    return _KINDS[kind](rng)


def _posts(right: float, ahead: float, top: float, radius: float) -> tuple[Row, ...]:
    return tuple((r, 0.04, a, r, top, a, radius) for r in (-right, right) for a in (-ahead, ahead))


def _feet(count: int, reach: float, up: float, radius: float) -> tuple[Row, ...]:
    angles = [2 * math.pi * foot / count for foot in range(count)]
    return tuple(
        (0.0, up + 0.06, 0.0, reach * math.cos(angle), up, reach * math.sin(angle), radius) for angle in angles
    )


def _bed(rng: np.random.Generator) -> Shape:
    blanket = (0.0, 0.72, -0.3, 0.78, float(rng.uniform(0.06, 0.2)), 1.2, 0.0)
    return Shape(tuple(empty_bed_rows()), (blanket,))


def _wheelchair(_: np.random.Generator) -> Shape:
    return Shape(tuple(wheelchair_rows()))


def _rollator(rng: np.random.Generator) -> Shape:
    rows = rollator_rows(float(rng.uniform(1.5, 1.85)))
    return Shape(tuple((x0, u0, a0 - 0.44, x1, u1, a1 - 0.44, r) for x0, u0, a0, x1, u1, a1, r in rows))


def _iv_pole(_: np.random.Generator) -> Shape:
    return Shape(tuple(iv_pole_rows(0.0, 0.0)))


def _chair(rng: np.random.Generator) -> Shape:
    half, back = 0.21, float(rng.uniform(0.4, 0.55))
    boxes = ((0.0, 0.45, 0.0, 0.46, 0.07, 0.46, 0.0), (0.0, 0.5 + back / 2, -0.21, 0.44, back, 0.05, 0.0))
    return Shape(_posts(half, half, 0.45, 0.018), boxes)


def _table(rng: np.random.Generator) -> Shape:
    wide, top = float(rng.uniform(0.7, 1.3)), float(rng.uniform(0.68, 0.8))
    return Shape(_posts(wide / 2 - 0.05, 0.3, top, 0.025), ((0.0, top, 0.0, wide, 0.04, 0.7, 0.0),))


def _cupboard(rng: np.random.Generator) -> Shape:
    wide, high = float(rng.uniform(0.6, 1.2)), float(rng.uniform(1.1, 2.0))
    return Shape((), ((0.0, high / 2, 0.0, wide, high, float(rng.uniform(0.35, 0.6)), 0.0),))


def _locker(rng: np.random.Generator) -> Shape:
    high = float(rng.uniform(1.6, 1.85))
    count = int(rng.integers(1, 4))
    places = [0.42 * (number - (count - 1) / 2) for number in range(count)]
    return Shape((), tuple((right, high / 2, 0.0, 0.4, high, 0.5, 0.0) for right in places))


def _trolley(rng: np.random.Generator) -> Shape:
    wide, high = float(rng.uniform(0.6, 0.9)), float(rng.uniform(0.85, 1.25))
    shelves = tuple((0.0, up, 0.0, wide, 0.03, 0.45, 0.0) for up in (0.18, (0.18 + high) / 2, high))
    load = (float(rng.uniform(-0.15, 0.15)), high + 0.1, 0.0, 0.3, 0.18, 0.3, float(rng.uniform(0, 1.5)))
    handle: Row = (-wide / 2 - 0.06, high - 0.02, -0.2, -wide / 2 - 0.06, high - 0.02, 0.2, 0.016)
    return Shape((*_posts(wide / 2, 0.22, high, 0.016), handle), (*shelves, load))


def _pillar(rng: np.random.Generator) -> Shape:
    wide = float(rng.uniform(0.25, 0.5))
    if rng.random() < 0.5:
        return Shape((), ((0.0, 1.7, 0.0, wide, 3.6, wide, 0.0),))
    return Shape(((0.0, -0.3, 0.0, 0.0, 3.5, 0.0, wide / 2),))


def _screen(rng: np.random.Generator) -> Shape:
    high, fold = float(rng.uniform(1.55, 1.85)), float(rng.uniform(0.3, 0.8))
    half = 0.27 * math.cos(fold)
    leaf = (0.05 + high / 2, 0.0, 0.54, high - 0.1, 0.025)
    boxes = tuple(
        (right, leaf[0], leaf[1], leaf[2], leaf[3], leaf[4], turned)
        for right, turned in ((-2 * half, fold), (0.0, -fold), (2 * half, fold))
    )
    return Shape((), boxes)


def _door_leaf(rng: np.random.Generator) -> Shape:
    wide = float(rng.uniform(0.8, 1.2))
    handle: Row = (wide / 2 - 0.07, 1.03, -0.06, wide / 2 - 0.18, 1.03, -0.06, 0.012)
    return Shape((handle,), ((0.0, 1.04, 0.0, wide, 2.06, 0.045, 0.0),))


def _bin(rng: np.random.Generator) -> Shape:
    radius, high = float(rng.uniform(0.15, 0.24)), float(rng.uniform(0.45, 0.9))
    return Shape(((0.0, radius, 0.0, 0.0, max(high - radius, radius), 0.0, radius),))


def _vending_machine(rng: np.random.Generator) -> Shape:
    return Shape((), ((0.0, 0.92, 0.0, float(rng.uniform(0.75, 1.0)), 1.84, 0.8, 0.0),))


def _flip_chart(rng: np.random.Generator) -> Shape:
    low = float(rng.uniform(0.75, 0.95))
    top = low + 1.0
    legs: tuple[Row, ...] = tuple((0.3 * r, top, 0.0, 0.42 * r, 0.02, 0.12, 0.016) for r in (-1.0, 1.0))
    return Shape((*legs, (0.0, top, -0.03, 0.0, 0.02, -0.5, 0.016)), ((0.0, low + 0.5, 0.05, 0.7, 1.0, 0.03, 0.0),))


def _stool(rng: np.random.Generator) -> Shape:
    up = float(rng.uniform(0.42, 0.6))
    rows: tuple[Row, ...] = ((-0.08, up, 0.0, 0.08, up, 0.0, 0.09), (0.0, 0.1, 0.0, 0.0, up, 0.0, 0.03))
    return Shape((*rows, *_feet(5, 0.26, 0.04, 0.025)))


def _coat_stand(rng: np.random.Generator) -> Shape:
    """Shoulders, and often a hat."""
    top, wide = float(rng.uniform(1.65, 1.85)), float(rng.uniform(0.13, 0.19))
    hem, shoulder = float(rng.uniform(0.5, 0.9)), top - 0.28
    rows: list[Row] = [(0.0, 0.05, 0.0, 0.0, top, 0.0, 0.022), *_feet(4, 0.28, 0.04, 0.02)]
    rows.append((-wide, shoulder, 0.05, wide, shoulder, 0.05, 0.07))
    rows += [(right * wide, shoulder, 0.05, 1.2 * right * wide, hem, 0.06, 0.09) for right in (-0.7, 0.0, 0.7)]
    rows += [(side * wide, shoulder, 0.05, 1.5 * side * wide, shoulder - 0.55, 0.06, 0.05) for side in (-1.0, 1.0)]
    if rng.random() < 0.5:
        rows.append((0.0, top + 0.02, 0.0, 0.0, top + 0.05, 0.0, 0.1))
    return Shape(tuple(rows))


def _plant(rng: np.random.Generator) -> Shape:
    high = float(rng.uniform(1.0, 1.8))
    rows: list[Row] = [(0.0, 0.18, 0.0, 0.0, 0.3, 0.0, 0.18), (0.0, 0.3, 0.0, 0.0, 0.7 * high, 0.0, 0.03)]
    for _ in range(int(rng.integers(7, 14))):
        angle, reach = float(rng.uniform(0, 2 * math.pi)), float(rng.uniform(0.05, 0.3))
        right, ahead, up = reach * math.cos(angle), reach * math.sin(angle), float(rng.uniform(0.5, 0.93)) * high
        rows.append((0.5 * right, up - 0.08, 0.5 * ahead, right, up, ahead, float(rng.uniform(0.06, 0.13))))
    return Shape(tuple(rows))


def _water_dispenser(rng: np.random.Generator) -> Shape:
    high = float(rng.uniform(0.9, 1.1))
    rows: tuple[Row, ...] = ((0.0, high + 0.05, 0.0, 0.0, high + 0.12, 0.0, 0.06),)
    bottle: Row = (0.0, high + 0.25, 0.0, 0.0, high + 0.36, 0.0, 0.135)
    return Shape((*rows, bottle), ((0.0, high / 2, 0.0, 0.31, high, 0.33, 0.0),))


def _laundry_bag(rng: np.random.Generator) -> Shape:
    high, radius = float(rng.uniform(0.85, 1.05)), float(rng.uniform(0.22, 0.3))
    bag: Row = (0.0, 0.2 + radius, 0.0, 0.0, max(high - radius, 0.3 + radius), 0.0, radius)
    return Shape((bag, *_posts(radius + 0.03, radius + 0.03, high, 0.014)))


def _hoist(rng: np.random.Generator) -> Shape:
    """Two legs, a mast and a boom with its bar."""
    top, out = float(rng.uniform(1.35, 1.6)), float(rng.uniform(0.6, 0.9))
    rows: list[Row] = [(0.3 * side, 0.09, -0.55, 0.33 * side, 0.09, 0.55, 0.04) for side in (-1.0, 1.0)]
    rows += [(-0.3, 0.1, -0.5, 0.3, 0.1, -0.5, 0.04), (0.0, 0.1, -0.5, 0.0, top, -0.4, 0.045)]
    rows += [(0.0, top, -0.4, 0.0, top + 0.2, out - 0.4, 0.035), (0.0, 0.65, -0.45, 0.0, 0.85, -0.45, 0.11)]
    rows += [(0.0, top + 0.2, out - 0.4, 0.0, top - 0.05, out - 0.4, 0.015)]
    rows += [(-0.28, top - 0.08, out - 0.4, 0.28, top - 0.08, out - 0.4, 0.022)]
    return Shape(tuple(rows))


_KINDS: dict[str, Callable[[np.random.Generator], Shape]] = {
    "bed": _bed,
    "wheelchair": _wheelchair,
    "rollator": _rollator,
    "iv-pole": _iv_pole,
    "chair": _chair,
    "table": _table,
    "cupboard": _cupboard,
    "locker": _locker,
    "trolley": _trolley,
    "pillar": _pillar,
    "screen": _screen,
    "door-leaf": _door_leaf,
    "bin": _bin,
    "vending-machine": _vending_machine,
    "flip-chart": _flip_chart,
    "stool": _stool,
    "coat-stand": _coat_stand,
    "plant": _plant,
    "water-dispenser": _water_dispenser,
    "laundry-bag": _laundry_bag,
    "hoist": _hoist,
}
KINDS: tuple[str, ...] = tuple(_KINDS)
JUDGED_ONLY = frozenset({"coat-stand", "plant", "water-dispenser", "laundry-bag", "hoist"})
"""Kinds that no scene for learning has: the study's worst mistakes are among them."""

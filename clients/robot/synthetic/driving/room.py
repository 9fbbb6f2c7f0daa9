"""Corridors and rooms: walls with openings, ground that may rise, mirrors, panes of glass. Deterministic by generator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from clients.robot.synthetic.driving.solids import Box, Faces, Floats, box_between, joined_faces, place_boxes

Wall = Literal["left", "right", "far", "near"]
WALLS: tuple[Wall, ...] = ("left", "right", "far", "near")

THICK_M = 0.12
OUTSIDE_M = 3.0  # how far the rooms behind openings reach
FAR_M = 40.0
BELOW_M = -0.6
WHEELBASE_M, TRACK_M = 0.5, 0.4
OPENING_APART_M = 0.4
RAIL_UP_M, RAIL_M = (0.86, 0.98), 0.06


@dataclass(frozen=True, slots=True)
class Ground:
    """How high the ground is along z: knots (z, up), straight between them, level beyond."""

    knots: tuple[tuple[float, float], ...] = ((0.0, 0.0),)

    def up_m(self, z: float) -> float:
        return float(np.interp(z, [knot[0] for knot in self.knots], [knot[1] for knot in self.knots]))

    def under_robot(self, z: float, yaw: float) -> tuple[float, float, float]:
        """Return (height in metres, pitch down, roll to the right) of a robot on its four wheels."""
        ahead, right = WHEELBASE_M / 2 * math.cos(yaw), -TRACK_M / 2 * math.sin(yaw)
        front, back, starboard, port = (self.up_m(z + dz) for dz in (ahead, -ahead, right, -right))
        pitch, roll = math.atan2(back - front, WHEELBASE_M), math.atan2(port - starboard, TRACK_M)
        return (front + back + starboard + port) / 4, pitch, roll

    def faces(self) -> Faces:
        ends = [(-FAR_M, self.knots[0][1]), *self.knots, (FAR_M, self.knots[-1][1])]
        parts = [
            quad(((-FAR_M, u0, z0), (FAR_M, u0, z0), (FAR_M, u1, z1), (-FAR_M, u1, z1)), (0.0, -9.0, (z0 + z1) / 2))
            for (z0, u0), (z1, u1) in pairwise(ends)
        ]
        return joined_faces(parts)


@dataclass(frozen=True, slots=True)
class Opening:
    """A doorway, or with a sill a window, in a wall; `at_m`: its middle along the wall (z, or x)."""

    wall: Wall
    at_m: float
    width_m: float
    top_m: float
    sill_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Panel:
    """A mirror on a wall, or a pane of glass in an opening. Of a `share` of its pixels some are lost, and a pane's others
    show the pane itself.
    """

    kind: Literal["mirror", "glass"]
    wall: Wall
    at_m: float
    width_m: float
    up_m: tuple[float, float]
    share: float


Corner = tuple[float, float, float]


def quad(corners: tuple[Corner, Corner, Corner, Corner], back: Corner) -> Faces:
    return Faces(np.array([corners]), np.array([back]), np.zeros(1, dtype=np.uint8))


@dataclass(frozen=True, slots=True)
class Room:
    """A corridor or room between x = -width / 2 and width / 2 and between z = 0 and its length."""

    width_m: float
    length_m: float
    ceiling_m: float
    openings: tuple[Opening, ...] = ()
    has_rails: bool = False
    ground: Ground = Ground()
    panels: tuple[Panel, ...] = ()

    def inside(self, points: Floats, margin_m: float) -> bool:
        """Tell whether all points (n, 2: x, z) keep so far from the walls."""
        x, z = points[:, 0], points[:, 1]
        half = self.width_m / 2 - margin_m
        return bool((np.abs(x) <= half).all() and (z >= margin_m).all() and (z <= self.length_m - margin_m).all())

    def extent(self, wall: Wall) -> tuple[float, float]:
        """Along itself."""
        half = self.width_m / 2
        return (0.0, self.length_m) if wall in ("left", "right") else (-half, half)

    def faces(self) -> Faces:
        half, top = self.width_m / 2 + OUTSIDE_M, self.ceiling_m
        low, high = -OUTSIDE_M, self.length_m + OUTSIDE_M
        boxes = [box for wall in WALLS for box in self._wall(wall)]
        away = FAR_M
        outside = [
            box_between((-away, -half), (BELOW_M, top), (-away, away)),
            box_between((half, away), (BELOW_M, top), (-away, away)),
            box_between((-away, away), (BELOW_M, top), (high, away)),
            box_between((-away, away), (BELOW_M, top), (-away, low)),
            box_between((-away, away), (top, top + 1), (-away, away)),
        ]
        return joined_faces([place_boxes([*boxes, *outside]), self.ground.faces()])

    def panel_face(self, panel: Panel) -> Faces:
        """Return a panel's one face, which looks into the room."""
        depth = -THICK_M / 2 if panel.kind == "glass" else 0.01
        begin, end = panel.at_m - panel.width_m / 2, panel.at_m + panel.width_m / 2
        low, high = panel.up_m
        (x0, x1), (z0, z1) = self._along(panel.wall, (begin, end), (depth, depth))
        (back_x, _), (back_z, _) = self._along(panel.wall, (panel.at_m, panel.at_m), (depth - 1, depth - 1))
        corners = ((x0, low, z0), (x1, low, z1), (x1, high, z1), (x0, high, z0))
        return quad(corners, (back_x, (low + high) / 2, back_z))

    def wall_seen(self, x: float, z: float, yaw: float) -> tuple[Wall, float]:
        """Return the wall that lies in a direction from a place inside, and where along it."""
        dx, dz = math.sin(yaw), math.cos(yaw)
        aside: Wall = "right" if dx > 0 else "left"
        ahead: Wall = "far" if dz > 0 else "near"
        to_side = (self.width_m / 2 - (x if dx > 0 else -x)) / max(abs(dx), 1e-9)
        to_end = (self.length_m - z if dz > 0 else z) / max(abs(dz), 1e-9)
        return (aside, z + to_side * dz) if to_side < to_end else (ahead, x + to_end * dx)

    def place_by(self, wall: Wall, at_m: float, inwards_m: float) -> tuple[float, float]:
        """Return the (x, z) of a place beside a wall; negative: behind it."""
        (x, _), (z, _) = self._along(wall, (at_m, at_m), (inwards_m, inwards_m))
        return x, z

    def _along(
        self, wall: Wall, along: tuple[float, float], inwards: tuple[float, float]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return ranges of x and z from ranges along a wall and from it into the room."""
        half = self.width_m / 2
        if wall == "left":
            return (-half + inwards[0], -half + inwards[1]), along
        if wall == "right":
            return (half - inwards[1], half - inwards[0]), along
        if wall == "far":
            return along, (self.length_m - inwards[1], self.length_m - inwards[0])
        return along, inwards

    def _wall(self, wall: Wall) -> list[Box]:
        begin, end = self.extent(wall)
        own = sorted((item for item in self.openings if item.wall == wall), key=lambda item: item.at_m)
        parts: list[tuple[tuple[float, float], tuple[float, float]]] = []
        solid = []
        for item in own:
            left, right = item.at_m - item.width_m / 2, item.at_m + item.width_m / 2
            solid.append((begin, left))
            parts.append(((left, right), (item.top_m, self.ceiling_m)))
            if item.sill_m > 0:
                parts.append(((left, right), (BELOW_M, item.sill_m)))
            begin = right
        solid.append((begin, end))
        parts += [(along, (BELOW_M, self.ceiling_m)) for along in solid]
        boxes = [self._wall_box(wall, along, up, (-THICK_M, 0.0)) for along, up in parts]
        if self.has_rails and wall in ("left", "right"):
            boxes += [self._wall_box(wall, along, RAIL_UP_M, (0.0, RAIL_M)) for along in solid]
        return boxes

    def _wall_box(
        self, wall: Wall, along: tuple[float, float], up: tuple[float, float], inwards: tuple[float, float]
    ) -> Box:
        x, z = self._along(wall, along, inwards)
        return box_between(x, up, z)


def draw_room(rng: np.random.Generator, *, wide: bool, long_m: float, ground: Ground | None = None) -> Room:
    """Return a corridor that is at least so long, or (`wide`) a room."""
    if wide:
        width, length = float(rng.uniform(4.0, 7.0)), max(float(rng.uniform(5.0, 9.0)), long_m)
    else:
        width, length = float(rng.uniform(2.6, 5.2)), max(float(rng.uniform(9.0, 14.0)), long_m)
    room = Room(width, length, float(rng.uniform(2.5, 3.0)), (), bool(rng.random() < 0.4), ground or Ground())
    openings: list[Opening] = []
    if wide or rng.random() < 0.7:
        openings.append(_opening(rng, room, "far"))
    for wall in ("left", "right"):
        for _ in range(int(rng.integers(0, 3))):
            item = _opening(rng, room, "left" if wall == "left" else "right")
            if all(other.wall != wall or _apart(item, other) for other in openings):
                openings.append(item)
    return Room(room.width_m, length, room.ceiling_m, tuple(openings), room.has_rails, room.ground)


def _opening(rng: np.random.Generator, room: Room, wall: Wall) -> Opening:
    begin, end = room.extent(wall)
    width = float(rng.uniform(0.85, min(1.4, end - begin - 0.8)))
    at = float(rng.uniform(begin + width / 2 + 0.2, end - width / 2 - 0.2))
    return Opening(wall, at, width, float(rng.uniform(2.0, 2.15)))


def _apart(one: Opening, other: Opening) -> bool:
    return abs(one.at_m - other.at_m) > (one.width_m + other.width_m) / 2 + OPENING_APART_M

"""Doors, beds and reflective floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from clients.robot.sensing.sensor_events import Mask
from clients.robot.synthetic.body import Capsules
from clients.robot.synthetic.camera import NEAR_M, Camera, Image, Labels, draw
from clients.robot.synthetic.corridor import BEYOND_M, HALF_WIDTH_M, directions
from clients.robot.synthetic.props import bed_rows
from clients.robot.synthetic.scenario import Door, Environment

DOOR_HEIGHT_M = 2.05
DOOR_SWING_S = 1.4
DOOR_OPEN_RAD = math.radians(86)
ROOM_DEPTH_M = 2.2
MIRROR_DROP = 0.25  # how much of a mirroring floor returns nothing
PATCH_SIZE_PX = 4.0


def door_angle(door: Door, at_s: float) -> float:
    """In radians."""
    opened = (at_s - door.opens_s) / DOOR_SWING_S
    closed = (at_s - door.closes_s) / DOOR_SWING_S
    share = min(max(opened, 0.0), 1.0) - min(max(closed, 0.0), 1.0)
    return DOOR_OPEN_RAD * max(share, 0.0)


def furnish(camera: Camera, depth: Image, environment: Environment, at_s: float) -> None:
    for door in environment.doors:
        angle = door_angle(door, at_s)
        if angle > 0:
            _draw_door(camera, depth, door, angle)
    nobody = np.zeros(depth.shape, dtype=np.uint8)
    for bed in environment.beds:
        if at_s >= bed.from_s:
            rows = np.array(bed_rows(bed), dtype=np.float32)
            draw(camera, depth, nobody, Capsules(rows[:, :3], rows[:, 3:6], rows[:, 6]), 0)


def _draw_door(camera: Camera, depth: Image, door: Door, angle: float) -> None:
    x, z, _ = camera.at
    wall = HALF_WIDTH_M if door.side == "right" else -HALF_WIDTH_M
    inwards = -1.0 if door.side == "right" else 1.0
    dx, dz = directions(camera)
    ry = np.broadcast_to(camera.ray_y, camera.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_wall = (wall - x) / dx
        to_room = (wall - inwards * ROOM_DEPTH_M - x) / dx
        at_z, up = z + to_wall * dz, camera.height_m - to_wall * ry
        opening = (at_z > door.z_m) & (at_z < door.z_m + door.width_m) & (up > 0) & (up < DOOR_HEIGHT_M)
        opening &= (to_wall > NEAR_M) & (np.abs(depth - to_wall) < 0.02)
        floor = np.where(ry > 0, camera.height_m / ry, np.inf)
        depth[opening] = np.minimum(to_room, floor)[opening]
        hinge = door.z_m + door.width_m
        along_x, along_z = inwards * math.sin(angle), -math.cos(angle)
        across = dx * along_z - dz * along_x
        hit = ((wall - x) * along_z - (hinge - z) * along_x) / across
        place = (x + hit * dx - wall) * along_x + (z + hit * dz - hinge) * along_z
        up = camera.height_m - hit * ry
        leaf = (place > 0) & (place < door.width_m) & (up > 0.01) & (up < DOOR_HEIGHT_M) & (hit > NEAR_M)
        leaf &= hit < depth
    depth[leaf] = hit[leaf]


def mirror(
    camera: Camera, depth: Image, labels: Labels, bodies: Sequence[tuple[Capsules, int]], shiny: Mask, dull: Mask
) -> None:
    """Mirror bodies in the shiny part of the floor, with holes in the dull part. In place; each reflection has the label
    beside its body.
    """
    is_floor = (np.abs(depth - camera.ground()) < 0.01) & (labels == 0)
    below = np.full(depth.shape, np.inf, dtype=np.float32)
    marks = np.zeros(depth.shape, dtype=np.uint8)
    down = np.array([1, -1, 1], dtype=np.float32)
    for body, label in bodies:
        draw(camera, below, marks, Capsules(body.start * down, body.end * down, body.radius), label)
    seen = is_floor & shiny & np.isfinite(below)
    depth[seen] = below[seen]
    labels[seen] = marks[seen]
    depth[is_floor & dull & ~seen] = BEYOND_M


@lru_cache(maxsize=4)
def patches(shape: tuple[int, ...], share: float, seed: int) -> tuple[Mask, Mask]:
    """Return a random share of an area in blotches, and a smaller one."""
    fields = []
    for number, part in ((0x317, share), (0x318, share * MIRROR_DROP)):
        rng = np.random.default_rng([seed, number])
        rough = np.asarray(cv2.GaussianBlur(rng.standard_normal(shape, dtype=np.float32), (0, 0), PATCH_SIZE_PX))
        fields.append(rough >= np.quantile(rough, 1 - part))
    return fields[0], fields[1]

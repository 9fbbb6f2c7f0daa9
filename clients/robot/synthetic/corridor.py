"""Noise-free depth of the empty corridor."""

from __future__ import annotations

import math

import numpy as np

from clients.robot.synthetic.camera import NEAR_M, Camera, Image

HALF_WIDTH_M = 2.6
CEILING_M = 2.7
FAR_WALL_M = 7.5
DOOR_M = (-0.62, 0.52, 2.1)  # left, right, height of the doorway in the far wall
BEYOND_M = 14.0
# Boxes that stand along the walls: x, y (up from the floor) and z ranges.
FURNITURE_M = (
    ((2.05, 2.6), (0.0, 0.48), (4.4, 6.2)),
    ((-2.6, -2.52), (0.85, 0.95), (3.2, 7.5)),
    ((-2.6, -2.25), (0.0, 1.9), (6.0, 6.9)),
    ((2.48, 2.6), (1.2, 2.0), (4.9, 5.7)),
)


def empty_corridor(camera: Camera) -> Image:
    """In metres from the camera."""
    ry = np.broadcast_to(camera.ray_y, camera.shape)
    with np.errstate(divide="ignore"):
        vertical = np.where(ry > 0, camera.height_m / ry, (camera.height_m - CEILING_M) / ry)
    if camera.at == (0.0, 0.0, 0.0):
        rx = np.broadcast_to(camera.ray_x, camera.shape)
        with np.errstate(divide="ignore"):
            sides = HALF_WIDTH_M / np.abs(rx)
        left, right, top = DOOR_M
        at_wall_x, at_wall_up = rx * FAR_WALL_M, camera.height_m - ry * FAR_WALL_M
        in_door = (at_wall_x > left) & (at_wall_x < right) & (at_wall_up < top)
        far = np.where(in_door, BEYOND_M, FAR_WALL_M)
        depth = np.minimum(np.minimum(sides, np.abs(vertical)), far)
        for box in FURNITURE_M:
            depth = np.minimum(depth, _box(rx, ry, camera.height_m, box))
        return depth.astype(np.float32)
    return _corridor_from(camera, ry, np.abs(vertical))


def _corridor_from(camera: Camera, ry: Image, vertical: Image) -> Image:
    x, z, _ = camera.at
    dx, dz = directions(camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.where(dx > 0, (HALF_WIDTH_M - x) / dx, (-HALF_WIDTH_M - x) / dx)
        wall = np.where(dz > 0, (FAR_WALL_M - z) / dz, np.inf)
        beyond = np.where(dz > 0, (BEYOND_M - z) / dz, np.inf)
    sides[~np.isfinite(sides) | (sides <= 0)] = BEYOND_M
    left, right, top = DOOR_M
    at_x, at_up = x + dx * wall, camera.height_m - ry * wall
    in_door = (at_x > left) & (at_x < right) & (at_up < top)
    depth = np.minimum(np.minimum(sides, vertical), np.where(in_door, beyond, wall))
    for (x0, x1), up, (z0, z1) in FURNITURE_M:
        depth = np.minimum(depth, _box_at(camera, dx, dz, ry, ((x0 - x, x1 - x), up, (z0 - z, z1 - z))))
    return np.minimum(depth, np.float32(BEYOND_M)).astype(np.float32)


def directions(camera: Camera) -> tuple[Image, Image]:
    """As (right, ahead) per metre along the optical axis."""
    cos, sin = np.float32(math.cos(camera.at[2])), np.float32(math.sin(camera.at[2]))
    dx = np.broadcast_to(camera.ray_x * cos + sin, camera.shape)
    dz = np.broadcast_to(cos - camera.ray_x * sin, camera.shape)
    return dx.astype(np.float32), dz.astype(np.float32)


def _box_at(camera: Camera, dx: Image, dz: Image, ry: Image, box: tuple[tuple[float, float], ...]) -> Image:
    (x0, x1), (up0, up1), (z0, z1) = box
    entry = np.zeros(dx.shape, dtype=np.float32)
    leave = np.full(dx.shape, np.inf, dtype=np.float32)
    heights = (camera.height_m - up1, camera.height_m - up0)
    for ray, low, high in ((dx, x0, x1), (ry, *heights), (dz, z0, z1)):
        safe = np.where(np.abs(ray) < 1e-6, np.float32(1e-6), ray)
        first, second = low / safe, high / safe
        entry = np.maximum(entry, np.minimum(first, second))
        leave = np.minimum(leave, np.maximum(first, second))
    return np.where((entry <= leave) & (entry > NEAR_M), entry, np.inf).astype(np.float32)


def _box(rx: Image, ry: Image, height_m: float, box: tuple[tuple[float, float], ...]) -> Image:
    (x0, x1), (up0, up1), (z0, z1) = box
    entry = np.full(rx.shape, z0, dtype=np.float32)
    leave = np.full(rx.shape, z1, dtype=np.float32)
    for ray, low, high in ((rx, x0, x1), (ry, height_m - up1, height_m - up0)):
        safe = np.where(np.abs(ray) < 1e-6, np.float32(1e-6), ray)
        first, second = low / safe, high / safe
        entry = np.maximum(entry, np.minimum(first, second))
        leave = np.minimum(leave, np.maximum(first, second))
    return np.where((entry <= leave) & (entry > NEAR_M), entry, np.inf).astype(np.float32)

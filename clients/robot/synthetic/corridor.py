"""Noise-free depth of the empty corridor, and capsule rendering. Pure geometry."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from clients.robot.synthetic.body import Capsules
from clients.robot.synthetic.scenario import Scenario

Image = npt.NDArray[np.float32]
Labels = npt.NDArray[np.uint8]

HALF_WIDTH_M = 2.6
CEILING_M = 2.7
FAR_WALL_M = 7.5
DOOR_M = (-0.62, 0.52, 2.1)  # left, right, height of the doorway in the far wall
BEYOND_M = 14.0
NEAR_M = 0.4
AID_BIT = 0x80  # in drawn labels: an aid's pixel, of the person in the other bits
# Boxes that stand along the walls: x, y (up from the floor) and z ranges.
FURNITURE_M = (
    ((2.05, 2.6), (0.0, 0.48), (4.4, 6.2)),
    ((-2.6, -2.52), (0.85, 0.95), (3.2, 7.5)),
    ((-2.6, -2.25), (0.0, 1.9), (6.0, 6.9)),
    ((2.48, 2.6), (1.2, 2.0), (4.9, 5.7)),
)


class Camera:
    """A pinhole camera; `rays` are (x, y down) at z = 1, angles in radians, right."""

    def __init__(self, scenario: Scenario) -> None:
        self.height_m = scenario.camera_height_m
        self.focal = np.float32(scenario.focal_px)
        self.shape = (scenario.height, scenario.width)
        self.centre = (np.float32((scenario.width - 1) / 2), np.float32((scenario.height - 1) / 2))
        self.ray_x: Image = ((np.arange(scenario.width, dtype=np.float32) - self.centre[0]) / self.focal)[None, :]
        self.ray_y: Image = ((np.arange(scenario.height, dtype=np.float32) - self.centre[1]) / self.focal)[:, None]
        self.at: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def seen(self, points: Image) -> Image:
        """Transform points (n, 3: right, up, ahead) into camera coordinates (right, down, ahead)."""
        x, z, yaw = self.at
        right, ahead = points[:, 0], points[:, 2]
        if self.at != (0.0, 0.0, 0.0):
            cos, sin = np.float32(math.cos(yaw)), np.float32(math.sin(yaw))
            dx, dz = right - np.float32(x), ahead - np.float32(z)
            right, ahead = dx * cos - dz * sin, dx * sin + dz * cos
        return np.stack([right, self.height_m - points[:, 1], ahead], axis=-1).astype(np.float32)


def empty_corridor(camera: Camera) -> Image:
    """Depth in metres from the camera."""
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
    """Column rays (right, ahead) per metre along the optical axis."""
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


def draw(camera: Camera, depth: Image, labels: Labels, capsules: Capsules, label: int, aid: int = 0) -> None:
    """Draw body and aid into `depth` (metres) where nearest. In place."""
    starts, ends = camera.seen(capsules.start), camera.seen(capsules.end)
    body = len(starts) - capsules.props
    for number, (a, b) in enumerate(zip(starts, ends, strict=True)):
        _draw_capsule(camera, depth, labels, a, b, np.float32(capsules.radius[number]), label if number < body else aid)


def _draw_capsule(
    camera: Camera, depth: Image, labels: Labels, a: Image, b: Image, radius: np.float32, label: int
) -> None:
    nearest = float(min(a[2], b[2]) - radius)
    if nearest < NEAR_M:
        return
    height, width = camera.shape
    pad = float(radius) / nearest * float(camera.focal) + 2
    us = [float(p[0] / p[2] * camera.focal + camera.centre[0]) for p in (a, b)]
    vs = [float(p[1] / p[2] * camera.focal + camera.centre[1]) for p in (a, b)]
    left, right = max(0, int(min(us) - pad)), min(width, int(max(us) + pad) + 1)
    top, bottom = max(0, int(min(vs) - pad)), min(height, int(max(vs) + pad) + 1)
    if left >= right or top >= bottom:
        return
    box = (slice(top, bottom), slice(left, right))
    hit = _hit_capsule(camera.ray_x[:, left:right], camera.ray_y[top:bottom], a, b, radius)
    nearer = hit < depth[box]
    depth[box][nearer] = hit[nearer]
    labels[box][nearer] = label


def _hit_capsule(rx: Image, ry: Image, a: Image, b: Image, radius: np.float32) -> Image:
    """Depth where rays hit; infinity on miss."""
    ba = b - a
    baba = float(ba @ ba) + 1e-9
    baoa = -float(ba @ a)
    aa, bb = float(a @ a), float(b @ b)
    r2 = float(radius) ** 2
    rdrd = rx * rx + ry * ry + 1
    bard = rx * ba[0] + ry * ba[1] + ba[2]
    rda = -(rx * a[0] + ry * a[1] + a[2])
    k2 = baba * rdrd - bard * bard
    k1 = baba * rda - baoa * bard
    k0 = baba * aa - baoa * baoa - r2 * baba
    root = k1 * k1 - k2 * k0
    miss = root < 0
    t = (-k1 - np.sqrt(np.maximum(root, 0))) / np.maximum(k2, 1e-9)
    along = baoa + t * bard
    at_start = along <= 0
    rdb = -(rx * b[0] + ry * b[1] + b[2])
    c1 = np.where(at_start, rda, rdb)
    c0 = np.where(at_start, np.float32(aa - r2), np.float32(bb - r2))
    cap_root = c1 * c1 - rdrd * c0
    cap = (-c1 - np.sqrt(np.maximum(cap_root, 0))) / rdrd
    side = (along > 0) & (along < baba)
    result = np.where(side, t, np.where(cap_root >= 0, cap, np.inf))
    result[miss] = np.inf
    return result.astype(np.float32)

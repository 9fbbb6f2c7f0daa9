"""A pinhole camera, anywhere and at any angle, and how capsules appear in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clients.robot.synthetic.body import Capsules
from clients.robot.synthetic.scenario import Scenario

Image = npt.NDArray[np.float32]
Labels = npt.NDArray[np.uint8]

NEAR_M = 0.4
LENS_M = 0.05  # what is nearer is not in front of the lens
AID_BIT = 0x80  # in drawn labels: an aid's pixel, of the person in the other bits
TILTED_MARGIN = 1.25  # of a capsule's rectangle: off the axis a ball is wider in the picture


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where a camera is, in metres above the origin's ground, and how it looks: radians to the right, down, and leaning
    to the right.
    """

    x: float
    z: float
    height_m: float
    yaw: float
    pitch: float = 0.0
    roll: float = 0.0

    def axes(self) -> npt.NDArray[np.float64]:
        """Right, down and ahead, as rows (right, up, ahead) of the world."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        right, down, ahead = np.array([cos, 0, -sin]), np.array([0.0, -1, 0]), np.array([sin, 0, cos])
        cos, sin = math.cos(self.pitch), math.sin(self.pitch)
        down, ahead = cos * down - sin * ahead, cos * ahead + sin * down
        cos, sin = math.cos(self.roll), math.sin(self.roll)
        return np.stack([cos * right + sin * down, cos * down - sin * right, ahead])


class Camera:
    """A pinhole camera; `rays` are (x, y down) at z = 1. It is level, at (x, z, yaw), until it is moved to a pose."""

    def __init__(self, scenario: Scenario) -> None:
        self.height_m = scenario.camera_height_m
        self.focal = np.float32(scenario.focal_px)
        self.shape = (scenario.height, scenario.width)
        self.centre = (np.float32((scenario.width - 1) / 2), np.float32((scenario.height - 1) / 2))
        self.ray_x: Image = ((np.arange(scenario.width, dtype=np.float32) - self.centre[0]) / self.focal)[None, :]
        self.ray_y: Image = ((np.arange(scenario.height, dtype=np.float32) - self.centre[1]) / self.focal)[:, None]
        self.at: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.pose: CameraPose | None = None

    def move(self, pose: CameraPose) -> None:
        self.pose = pose
        self.height_m = pose.height_m
        self.at = (pose.x, pose.z, pose.yaw)

    def seen(self, points: npt.NDArray[np.floating]) -> Image:
        """Transform points (..., 3: right, up, ahead) into camera coordinates (right, down, ahead)."""
        if self.pose is not None:
            moved = points - np.array([self.pose.x, self.pose.height_m, self.pose.z])
            return np.asarray(moved @ self.pose.axes().T, dtype=np.float32)
        x, z, yaw = self.at
        right, ahead = points[..., 0], points[..., 2]
        if self.at != (0.0, 0.0, 0.0):
            cos, sin = np.float32(math.cos(yaw)), np.float32(math.sin(yaw))
            dx, dz = right - np.float32(x), ahead - np.float32(z)
            right, ahead = dx * cos - dz * sin, dx * sin + dz * cos
        return np.stack([right, self.height_m - points[..., 1], ahead], axis=-1).astype(np.float32)

    def ground(self) -> Image:
        """Infinity above the horizon."""
        if self.pose is None:
            falls = np.broadcast_to(self.ray_y, self.shape)
        else:
            across, down, ahead = (np.float32(-axis[1]) for axis in self.pose.axes())
            falls = across * self.ray_x + down * self.ray_y + ahead
        with np.errstate(divide="ignore"):
            return np.where(falls > 0, self.height_m / falls, np.inf)


def draw(camera: Camera, depth: Image, labels: Labels, capsules: Capsules, label: int, aid: int = 0) -> None:
    """Draw body and aid into `depth` (metres) where nearest. In place."""
    starts, ends = camera.seen(capsules.start), camera.seen(capsules.end)
    body = len(starts) - capsules.props
    for number, (a, b) in enumerate(zip(starts, ends, strict=True)):
        _draw_capsule(camera, depth, labels, a, b, np.float32(capsules.radius[number]), label if number < body else aid)


def _draw_capsule(
    camera: Camera, depth: Image, labels: Labels, a: Image, b: Image, radius: np.float32, label: int
) -> None:
    if max(a[2], b[2]) <= NEAR_M:
        return
    cut = min(a[2], b[2]) < NEAR_M
    if cut:
        a, b = (a, b) if a[2] > b[2] else (b, a)
        b = a + (b - a) * ((a[2] - np.float32(NEAR_M)) / (a[2] - b[2]))
    nearest = max(float(min(a[2], b[2]) - radius), 2 * LENS_M)
    height, width = camera.shape
    pad = float(radius) / nearest * float(camera.focal) * (1.0 if camera.pose is None else TILTED_MARGIN) + 2
    us = [float(p[0] / p[2] * camera.focal + camera.centre[0]) for p in (a, b)]
    vs = [float(p[1] / p[2] * camera.focal + camera.centre[1]) for p in (a, b)]
    left, right = max(0, int(min(us) - pad)), min(width, int(max(us) + pad) + 1)
    top, bottom = max(0, int(min(vs) - pad)), min(height, int(max(vs) + pad) + 1)
    if left >= right or top >= bottom:
        return
    box = (slice(top, bottom), slice(left, right))
    if nearest > depth[box].max():
        return
    hit = _hit_capsule(camera.ray_x[:, left:right], camera.ray_y[top:bottom], a, b, radius)
    nearer = hit < depth[box]
    if cut:
        nearer &= hit > LENS_M
    depth[box][nearer] = hit[nearer]
    labels[box][nearer] = label


def _hit_capsule(rx: Image, ry: Image, a: Image, b: Image, radius: np.float32) -> Image:
    """Infinity on a miss."""
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

"""The plane on which the robot stands, found in each frame, and coordinates that are level with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float32]
Vector = npt.NDArray[np.float64]

NEAREST_M, FARTHEST_M = 0.4, 5.0
CANDIDATE_M, CANDIDATE_PER_M = 0.06, 0.05  # from the last plane, and more for each metre away
INLIER_M, INLIER_PER_M = 0.025, 0.01  # from a plane that is tried
POINTS_COUNT = 500
HYPOTHESES_COUNT = 40
ROUNDS_COUNT = 2  # of fitting anew to the inliers
TILT_MAX_RAD = math.radians(4)  # from the mount, by a ramp, a threshold or a braking robot
HEIGHT_MAX_M = 0.12
INLIERS_MIN_COUNT = 60
INLIERS_SPAN_M = 0.6  # a narrower strip of floor does not tell the tilt
NEW_SHARE = 0.6  # of a frame's plane in the one that is used
MOUNT_TILT_MAX_RAD = math.radians(30)
MOUNT_HEIGHT_M = (0.3, 2.2)
MOUNT_HYPOTHESES_COUNT = 400
MOUNT_POINTS_COUNT = 2_000
MOUNT_INLIERS_MIN_SHARE = 0.15
BELOW_MAX_SHARE = 0.02  # of points below: with more it is no floor, but a table


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """`up`: unit vector in camera coordinates (right, down, ahead); `height_m`: of the camera above the plane."""

    up: Vector
    height_m: float

    @classmethod
    def of_mount(cls, height_m: float, pitch: float, roll: float = 0.0) -> Ground:
        """Return the plane under a camera that looks down by `pitch` and leans to the right by `roll` (radians)."""
        level = math.cos(pitch)
        return cls(np.array([-math.sin(roll) * level, -math.cos(roll) * level, -math.sin(pitch)]), height_m)

    @property
    def pitch(self) -> float:
        """Radians that the camera looks down."""
        return -math.asin(max(-1.0, min(1.0, float(self.up[2]))))

    def level_axes(self) -> Vector:
        """Return right, up and ahead, level with the plane, as rows in camera coordinates."""
        ahead = np.array([0.0, 0.0, 1.0]) - self.up[2] * self.up
        ahead /= np.linalg.norm(ahead)
        (ax, ay, az), (ux, uy, uz) = ahead.tolist(), self.up.tolist()
        right = np.array(
            [ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux]
        )  # np.cross takes longer than all the rest
        return np.stack([right, self.up, ahead])

    def is_near(self, other: Ground) -> bool:
        tilt = math.acos(max(-1.0, min(1.0, float(self.up @ other.up))))
        return tilt <= TILT_MAX_RAD and abs(self.height_m - other.height_m) <= HEIGHT_MAX_M


def fit_ground(points: Points, last: Ground, mount: Ground) -> Ground | None:
    """Return the plane among camera coordinates (count, 3); None if too little of it is seen.

    Candidates lie near the `last` plane; a plane is accepted within 4 degrees and 12 cm of the `mount`'s.
    """
    z = points[:, 2]
    height = points @ last.up.astype(np.float32) + np.float32(last.height_m)
    near = (np.abs(height) < CANDIDATE_M + CANDIDATE_PER_M * z) & (z > NEAREST_M) & (z < FARTHEST_M)
    found = points[near]
    if len(found) < INLIERS_MIN_COUNT:
        return None
    found = found[:: -(-len(found) // POINTS_COUNT)].astype(np.float64)
    tolerance = INLIER_M + INLIER_PER_M * found[:, 2]
    plane = _best_hypothesis(found, tolerance, mount)
    for _ in range(ROUNDS_COUNT):
        if plane is None:
            return None
        plane = _refit(found, tolerance, plane)
    if plane is None or not plane.is_near(mount):
        return None
    return plane


def measure_mount(points: Points) -> Ground | None:
    """Return the ground of a robot that stands, by its first frames: the lowest large plane, whatever its pitch.

    `points`: camera coordinates (count, 3), of a scene without people. None if no plane of 0.3 to 2.2 m below the camera,
    tilted by 30 degrees at most, holds 15 % of them with hardly any below.
    """
    z = points[:, 2]
    found = points[(z > NEAREST_M) & (z < FARTHEST_M)]
    if len(found) < INLIERS_MIN_COUNT:
        return None
    seen: Vector = found[:: -(-len(found) // MOUNT_POINTS_COUNT)].astype(np.float64)
    tolerance = INLIER_M + INLIER_PER_M * seen[:, 2]
    draws = np.random.default_rng(0).integers(0, len(seen), (MOUNT_HYPOTHESES_COUNT, 3))
    best, most = None, 0
    for up, height in zip(*_planes(seen, draws, Ground.of_mount(0.0, 0.0).up), strict=True):
        if -up[1] < math.cos(MOUNT_TILT_MAX_RAD) or not MOUNT_HEIGHT_M[0] < height < MOUNT_HEIGHT_M[1]:
            continue
        above = seen @ up + height
        count = int(np.count_nonzero(np.abs(above) < tolerance))
        if count > most and np.count_nonzero(above < -2 * tolerance) <= BELOW_MAX_SHARE * len(seen):
            best, most = Ground(up, float(height)), count
    for _ in range(ROUNDS_COUNT):
        best = None if best is None else _refit(seen, tolerance, best)
    return best if most >= MOUNT_INLIERS_MIN_SHARE * len(seen) else None


def blend(last: Ground, new: Ground) -> Ground:
    up = NEW_SHARE * new.up + (1 - NEW_SHARE) * last.up
    return Ground(up / np.linalg.norm(up), NEW_SHARE * new.height_m + (1 - NEW_SHARE) * last.height_m)


def _best_hypothesis(points: Vector, tolerance: Vector, mount: Ground) -> Ground | None:
    ups, heights = _planes(points, _triples(len(points)), mount.up)
    allowed = (ups @ mount.up >= math.cos(TILT_MAX_RAD)) & (np.abs(heights - mount.height_m) <= HEIGHT_MAX_M)
    if not allowed.any():
        return None
    ups, heights = ups[allowed], heights[allowed]
    counts = np.count_nonzero(np.abs(ups @ points.T + heights[:, None]) < tolerance, axis=1)
    best = int(counts.argmax())
    return Ground(ups[best], float(heights[best]))


def _planes(points: Vector, triples: npt.NDArray[np.int64], up: Vector) -> tuple[Vector, Vector]:
    """Return the planes through triples of points: unit vectors on `up`'s side, and the camera's heights above them."""
    one, two, three = points[triples].transpose(1, 0, 2)
    ups = np.cross(two - one, three - one)
    lengths = np.linalg.norm(ups, axis=1)
    good = lengths > 1e-6
    ups, one = ups[good] / lengths[good, None], one[good]
    ups *= np.sign(ups @ up)[:, None]
    return ups, -np.einsum("ij,ij->i", ups, one)


def _refit(points: Vector, tolerance: Vector, plane: Ground) -> Ground | None:
    """Weighted least squares of height over the plan, among the plane's inliers."""
    axes = plane.level_axes()
    level = points @ axes.T
    inside = np.abs(level[:, 1] + plane.height_m) < tolerance
    right, up, ahead = level[inside].T
    if len(ahead) < INLIERS_MIN_COUNT or np.ptp(ahead) < INLIERS_SPAN_M:
        return None
    weights = 1 / tolerance[inside] ** 2
    table = np.stack([np.ones_like(right), right, ahead], axis=1)
    normal = table.T @ (weights[:, None] * table)
    offset, by_right, by_ahead = np.linalg.solve(normal + 1e-9 * np.eye(3), table.T @ (weights * up))
    turned = axes[1] - by_right * axes[0] - by_ahead * axes[2]
    length = float(np.linalg.norm(turned))
    return Ground(turned / length, -float(offset) / length)


@lru_cache(maxsize=POINTS_COUNT + 1)
def _triples(count: int) -> npt.NDArray[np.int64]:
    """The same picture gives the same plane."""
    return np.random.default_rng(count).integers(0, count, (HYPOTHESES_COUNT, 3))

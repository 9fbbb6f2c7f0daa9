"""Walls, as straight lines in plan among what is higher than furniture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Plan = npt.NDArray[np.float32]

WALLS_MAX_COUNT, HYPOTHESES_COUNT, POINTS_COUNT = 3, 48, 600
LOWEST_M, HIGHEST_M = 0.9, 2.4  # above the floor: of a wall more is seen there than of furniture
NEAR_M = 0.05  # from the line
BIN_M = 0.125  # along the line, for how much of it is filled
LENGTH_MIN_M = 1.6
FILLED_MIN_SHARE = 0.85  # with 0.6 two people abreast are taken for a wall
INLIERS_MIN_COUNT = 40


@dataclass(frozen=True, slots=True)
class Wall:
    """A line in plan (right, ahead): a point on it, its direction, how far it reaches both ways from there (metres)."""

    x_m: float
    z_m: float
    along_x: float
    along_z: float
    begin_m: float
    end_m: float

    def depth_behind(self, x: Plan, z: Plan) -> Plan:
        """Return how far behind the wall's line, as seen from the robot, places are."""
        across_x, across_z = -self.along_z, self.along_x
        side = -1.0 if across_x * self.x_m + across_z * self.z_m < 0 else 1.0
        return np.asarray(side * (across_x * (x - self.x_m) + across_z * (z - self.z_m)), dtype=np.float32)

    def covers(self, x: Plan, z: Plan, noise_m: Plan) -> npt.NDArray[np.bool_]:
        """Tell whether places are at the wall or behind it."""
        behind = self.depth_behind(x, z)
        covered = behind > -(NEAR_M + noise_m)
        at = np.flatnonzero(covered)
        if not at.size:
            return covered
        x, z, behind = x[at], z[at], behind[at]
        # Where the line of sight meets the wall's line; before it, the nearest place on the wall.
        robot = float(self.depth_behind(np.zeros(1, np.float32), np.zeros(1, np.float32))[0])
        share = np.clip(robot / np.minimum(robot - behind, -1e-6), 0.0, 1.0).astype(np.float32)
        met = np.where(behind > 0, share, np.float32(1))
        along = (met * x - self.x_m) * self.along_x + (met * z - self.z_m) * self.along_z
        covered[at] = (along > self.begin_m - BIN_M) & (along < self.end_m + BIN_M)
        return np.asarray(covered)


def find_walls(x: Plan, z: Plan, height_m: Plan, noise_m: Plan) -> list[Wall]:
    """Return at most three walls, the longest first seen; flat arrays of level coordinates in metres."""
    tall = (height_m > LOWEST_M) & (height_m < HIGHEST_M)
    points = np.stack([x[tall], z[tall], noise_m[tall]], axis=1)
    if len(points) < INLIERS_MIN_COUNT:
        return []
    points = points[:: -(-len(points) // POINTS_COUNT)]
    walls: list[Wall] = []
    while len(walls) < WALLS_MAX_COUNT and len(points) >= INLIERS_MIN_COUNT:
        wall, near = _best_line(points)
        if wall is None:
            break
        walls.append(wall)
        points = points[~near]
    return walls


def _best_line(points: Plan) -> tuple[Wall | None, npt.NDArray[np.bool_]]:
    first, second = points[_pairs(len(points))].transpose(1, 0, 2)
    along = second[:, :2] - first[:, :2]
    lengths = np.hypot(along[:, 0], along[:, 1])
    long = lengths > BIN_M
    along, first = along[long] / lengths[long, None], first[long]
    offset = along[:, 1] * first[:, 0] - along[:, 0] * first[:, 1]
    away = np.abs(np.outer(along[:, 1], points[:, 0]) - np.outer(along[:, 0], points[:, 1]) - offset[:, None])
    inside = away < NEAR_M + points[:, 2]
    counts = np.count_nonzero(inside, axis=1)
    for number in np.argsort(-counts)[:3]:
        near = inside[number]
        if counts[number] < INLIERS_MIN_COUNT:
            break
        wall = _fit_line(points[near])
        if wall is not None:
            return wall, near
    return None, np.zeros(len(points), dtype=np.bool_)


def _fit_line(points: Plan) -> Wall | None:
    middle = points[:, :2].mean(axis=0)
    moved = points[:, :2] - middle
    values, axes = np.linalg.eigh(moved.T @ moved)
    along = axes[:, int(values.argmax())]
    places = moved @ along
    begin = float(places.min())
    bins = np.bincount(((places - begin) / BIN_M).astype(np.int64)) > 0
    first, last = _longest_filled(bins)
    if (last - first) * BIN_M < LENGTH_MIN_M:
        return None
    ends = begin + first * BIN_M, begin + last * BIN_M
    return Wall(float(middle[0]), float(middle[1]), float(along[0]), float(along[1]), *ends)


def _longest_filled(bins: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """As (first, end)."""
    score = np.concatenate([[0.0], np.cumsum(bins - FILLED_MIN_SHARE)])
    ends = np.arange(len(score))
    holds = (score[None, :] >= score[:, None] - 1e-9) & (ends[None, :] > ends[:, None])
    lengths = np.where(holds, ends[None, :] - ends[:, None], 0)
    first, end = np.unravel_index(int(lengths.argmax()), lengths.shape)
    return int(first), int(end)


@lru_cache(maxsize=POINTS_COUNT + 1)
def _pairs(count: int) -> npt.NDArray[np.int64]:
    """The same picture gives the same walls."""
    return np.random.default_rng(count).integers(0, count, (HYPOTHESES_COUNT, 2))

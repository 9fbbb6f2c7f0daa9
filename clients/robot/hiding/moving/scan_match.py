"""Whether the room moved past the camera as the odometry says: wheels slip, and a robot may be pushed or carried.

A correlative scan match in plan (Olson, ICRA 2009), of what stands there against what stood there a moment before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.moving.plan_bodies import LevelView
from clients.robot.hiding.own_motion import OwnMotion, RobotPlace

CHECK_EVERY_MS = 500
COMPARED_M, COMPARED_RAD, COMPARED_MS = 0.5, math.radians(12), 3_000  # so far from a frame, the next is compared with
TOO_OLD_MS = COMPARED_MS + 2 * CHECK_EVERY_MS  # nobody looked meanwhile: odometry drifts, and things are moved
LOWEST_M, HIGHEST_M = 0.3, 2.0  # above the floor: what is compared
NEAREST_M, FARTHEST_M, ASIDE_M = 0.5, 4.5, 3.0
CELL_M = 0.05
POINTS_MIN_COUNT, POINTS_MAX_COUNT = 80, 160
AGREES_SHARE = 0.85  # of points that lie on what was there before: the odometry is right
FOUND_MIN_SHARE = 0.5  # at another place: fewer prove nothing
BETTER_BY_SHARE = 0.2  # so many more than where the odometry says: it is wrong
DRIFT_CELLS, DRIFT_RAD = 2, math.radians(4)  # what honest odometry may be off by, delay included
SEARCHED_CELLS, SEARCHED_RAD = 12, math.radians(15)  # around where the odometry says
STEP_CELLS, STEP_RAD = 2, math.radians(1.5)

Plan = npt.NDArray[np.float64]

_NEAR = np.ones((3, 3), np.uint8)
_MARGIN = SEARCHED_CELLS + 2  # places outside the plan go there: no displacement searched brings them in
_ROWS, _COLUMNS = round(FARTHEST_M / CELL_M) + 4 * _MARGIN, round(2 * ASIDE_M / CELL_M) + 4 * _MARGIN


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    place: RobotPlace
    points: Plan
    cells: npt.NDArray[np.bool_]


class ScanMatch:
    """One camera's frames, in time order. `slope`: of its picture's sides, metres aside by metre ahead.

    Tells the robot's own motion what it finds.
    """

    def __init__(self, slope: float, motion: OwnMotion) -> None:
        self._slope = slope
        self._motion = motion
        self.restart()

    def restart(self) -> None:
        """Places that follow have nothing to do with those before."""
        self._before: _Scan | None = None
        self._checked_ms: int | None = None

    def agrees(self, view: LevelView, people: list[int], place: RobotPlace) -> bool:
        """Tell whether nothing speaks against the odometry; `people`: labels of bodies that may walk.

        Looks twice a second. In a bare corridor nothing speaks against a wrong distance along it.
        """
        before, at_ms, checked_ms = self._before, place.at_ms, self._checked_ms
        if checked_ms is not None and 0 <= at_ms - checked_ms < CHECK_EVERY_MS:
            return True
        self._checked_ms = at_ms
        if before is not None and not 0 <= at_ms - before.place.at_ms <= TOO_OLD_MS:
            before = None
        scan = _scan(view, people, place)
        right = before is None or self._agree(before, scan)
        if before is None or not right or _is_far(before.place, place):
            self._before = scan
        if before is None or right:
            self._motion.confirm(at_ms)
        else:
            last_ms = before.place.at_ms if checked_ms is None else checked_ms
            self._motion.doubt(max(last_ms, at_ms - COMPARED_MS), at_ms)
        return right

    def _agree(self, before: _Scan, scan: _Scan) -> bool:
        moved = math.remainder(scan.place.yaw - before.place.yaw, 2 * math.pi)
        x_m, z_m = scan.place.x_m - before.place.x_m, scan.place.z_m - before.place.z_m
        shift = _turn(np.array([x_m, z_m]), -before.place.yaw)
        x, z = (_turn(scan.points, moved) + shift).T
        was_seen = (z > NEAREST_M) & (z < FARTHEST_M) & (np.abs(x) < np.minimum(ASIDE_M, self._slope * z))
        points = scan.points[was_seen]
        if len(points) < POINTS_MIN_COUNT:
            return True
        points = points[:: -(-len(points) // POINTS_MAX_COUNT)]
        near = _best_share(before, points, moved, shift, DRIFT_CELLS, DRIFT_RAD)
        if near >= AGREES_SHARE:
            return True
        best = _best_share(before, points, moved, shift, SEARCHED_CELLS, SEARCHED_RAD)
        return best < max(near + BETTER_BY_SHARE, FOUND_MIN_SHARE)


def _scan(view: LevelView, people: list[int], place: RobotPlace) -> _Scan:
    stands = (view.height > LOWEST_M) & (view.height < HIGHEST_M) & (view.z > NEAREST_M) & (view.z < FARTHEST_M)
    stands &= (view.depth > 0) & (np.abs(view.x) < ASIDE_M) & ~np.isin(view.labels, people)
    points = np.stack([view.x[stands], view.z[stands]], axis=1).astype(np.float64)
    cells = np.zeros((_ROWS, _COLUMNS), dtype=np.uint8)
    cells[_cells_of(points)] = 1
    return _Scan(place, points, np.asarray(cv2.dilate(cells, _NEAR)) > 0)


def _best_share(before: _Scan, points: Plan, moved: float, shift: Plan, reach_cells: int, reach_rad: float) -> float:
    """Return which share of the points lies where something stood, for the best displacement within reach."""
    steps = np.arange(-reach_cells, reach_cells + 1, STEP_CELLS)
    away = (steps[:, None] * _COLUMNS + steps).reshape(-1, 1)
    turns = np.arange(-reach_rad, reach_rad + STEP_RAD / 2, STEP_RAD)
    stood, best = before.cells.ravel(), 0
    for turn in turns:
        row, column = _cells_of(_turn(points, moved + turn) + shift)
        best = max(best, int(np.count_nonzero(stood[row * _COLUMNS + column + away], axis=1).max()))
    return best / len(points)


def _turn(points: Plan, angle: float) -> Plan:
    """Turn places (right, ahead) of a robot that turned to the right by `angle` into the axes of before."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.asarray(points @ np.array([[cos, -sin], [sin, cos]]), dtype=np.float64)


def _cells_of(points: Plan) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    column = np.floor((points[:, 0] + ASIDE_M) / CELL_M).astype(np.int64) + 2 * _MARGIN
    row = np.floor(points[:, 1] / CELL_M).astype(np.int64) + 2 * _MARGIN
    return np.clip(row, _MARGIN, _ROWS - _MARGIN - 1), np.clip(column, _MARGIN, _COLUMNS - _MARGIN - 1)


def _is_far(before: RobotPlace, place: RobotPlace) -> bool:
    turned = abs(math.remainder(place.yaw - before.yaw, 2 * math.pi))
    moved = math.hypot(place.x_m - before.x_m, place.z_m - before.z_m)
    return moved > COMPARED_M or turned > COMPARED_RAD or not 0 <= place.at_ms - before.at_ms <= COMPARED_MS

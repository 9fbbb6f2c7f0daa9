"""Bodies that stand apart in plan: what is above the ground and before the walls, in cells of 5 cm."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.moving.ground_plane import Ground, Points, blend, fit_ground
from clients.robot.hiding.moving.wall_lines import Wall, find_walls
from clients.robot.sensing.depth_noise import depth_sigma_m
from clients.robot.sensing.sensor_events import Depth, Mask

Image = npt.NDArray[np.float32]
Labels = npt.NDArray[np.int32]

STEP_PX = 4  # of the camera's pixels, one is looked at in each direction
CELL_M = 0.05
ASIDE_M, AHEAD_M = 5.0, 7.9  # how far the plan reaches
LOWEST_M, HIGHEST_M = 0.10, 2.05  # above the floor: what counts as standing on it
FLOOR_M, FLOOR_PER_M = 0.04, 0.015  # how thick the floor looks, and more for each metre away
AID_AREA_MAX_M2, AID_TOP_MAX_M = 0.17, 1.05  # a rollator, or knees
AID_AHEAD_M, AID_GAP_M = 0.85, 0.35  # before a body, and from it
AID_MIN_PX = 6
DENSE_MIN_PX = 3  # in a cell: what is between two surfaces at an edge scatters thinner
PIECE_MIN_M2 = 0.08
ALONE_M = 1.2  # nearer to two bodies, it could be anybody's
POLE_BREADTH_M = 0.16
NOISE_SIGMAS = 2  # so far a measured place is taken to be off
FAR_CELLS_M = 3.5  # beyond, steps of disparity exceed a cell

_NEAR_CELLS = np.ones((3, 3), np.uint8)
_FAR_CELLS = np.ones((5, 5), np.uint8)
_COLUMNS, _ROWS = round(2 * ASIDE_M / CELL_M) + 1, round(AHEAD_M / CELL_M) + 1  # a float at the edge may round up


@dataclass(frozen=True, slots=True, eq=False)
class LevelView:
    """A frame at quarter resolution, level with the ground: `x`, `height`, `z` in metres (height, width).

    `labels`: the number of the body that a pixel belongs to, 0: none. `cells`: the same for cells of the plan (ahead,
    right); `occupied`: cells that hold something.
    """

    depth: Depth
    x: Image
    height: Image
    z: Image
    labels: Labels
    cells: Labels
    occupied: npt.NDArray[np.uint8]
    count: int
    ground: Ground
    walls: tuple[Wall, ...]


class PlanView:
    """Finds ground, walls and bodies of one camera's frames, in order."""

    def __init__(self, shape: tuple[int, int], focal_px: float, mount: Ground) -> None:
        self.focal_px = focal_px / STEP_PX
        self._ray_x, self._ray_y = _rays(shape, focal_px)
        self._mount = mount
        self.ground = mount
        self.frames_without_ground_count = 0

    def look(self, depth: Depth) -> LevelView:
        """`depth`: whole frame in millimetres."""
        quarter = np.ascontiguousarray(depth[::STEP_PX, ::STEP_PX])
        ahead = quarter.astype(np.float32) / np.float32(1000)
        self._find_ground(ahead)
        right, up, forward = self.ground.level_axes().astype(np.float32)
        x, height, z = (
            ahead * (self._ray_x * axis[0] + (self._ray_y * axis[1] + axis[2])) for axis in (right, up, forward)
        )
        height += np.float32(self.ground.height_m)
        noise = NOISE_SIGMAS * depth_sigma_m(ahead)
        floor = np.maximum(np.float32(LOWEST_M), FLOOR_M + FLOOR_PER_M * ahead)
        above = (ahead > 0) & (height > floor) & (z > 0) & (z < AHEAD_M) & (np.abs(x) < ASIDE_M)
        body = above & (height < HIGHEST_M)
        walls = find_walls(x[above], z[above], height[above], noise[above])
        at = np.flatnonzero(body)
        for wall in walls:
            at = at[~wall.covers(x.flat[at], z.flat[at], noise.flat[at])]
        labels, cells, occupied, count = _join_cells(at, x, z, ahead / np.float32(self.focal_px))
        view = LevelView(quarter, x, height, z, labels, cells, occupied, count, self.ground, tuple(walls))
        join_aids(view, self.focal_px)
        return view

    def _find_ground(self, ahead: Image) -> None:
        rows = slice(ahead.shape[0] // 3, None)  # of floor there is enough in these
        z = ahead[rows]
        points = np.stack([z * self._ray_x, z * self._ray_y[rows], z], axis=-1).reshape(-1, 3)
        found = fit_ground(points, self.ground, self._mount)
        self.frames_without_ground_count = 0 if found is not None else self.frames_without_ground_count + 1
        if found is not None:
            self.ground = blend(self.ground, found)


def join_aids(view: LevelView, focal_px: float) -> None:
    """Join low, small pieces just before a lone body to it (rollator, knees), and what is as thin as a pole beside it.

    In place. Near two bodies they stay what they are.
    """
    counts = np.bincount(view.labels.ravel(), minlength=view.count + 1)
    pieces = {label: _measure_piece(view, label, focal_px) for label in range(1, counts.size) if counts[label]}
    bodies = [label for label, piece in pieces.items() if piece.area_m2 >= AID_AREA_MAX_M2]
    for label, piece in pieces.items():
        if label in bodies or counts[label] < AID_MIN_PX:
            continue
        near = [body for body in bodies if _gap_m(piece, pieces[body]) < ALONE_M]
        if len(near) != 1:
            continue
        body = pieces[near[0]]
        before = piece.top_m < AID_TOP_MAX_M and 0 < body.z_m - piece.z_m < AID_AHEAD_M
        pole = piece.right_m - piece.left_m < POLE_BREADTH_M
        if (before or pole) and _gap_m(piece, body) < AID_GAP_M:
            view.labels[view.labels == label] = near[0]
            view.cells[view.cells == label] = near[0]


@dataclass(frozen=True, slots=True)
class _Piece:
    left_m: float
    right_m: float
    near_m: float
    far_m: float
    top_m: float
    z_m: float
    area_m2: float


def _measure_piece(view: LevelView, label: int, focal_px: float) -> _Piece:
    inside = view.labels == label
    x, z, up = view.x[inside], view.z[inside], view.height[inside]
    side = view.depth[inside].astype(np.float32) / np.float32(1000 * focal_px)
    ends = float(x.min()), float(x.max()), float(z.min()), float(z.max())
    return _Piece(*ends, float(up.max()), float(np.median(z)), float(side @ side))


def _gap_m(one: _Piece, other: _Piece) -> float:
    aside = max(one.left_m - other.right_m, other.left_m - one.right_m, 0.0)
    ahead = max(one.near_m - other.far_m, other.near_m - one.far_m, 0.0)
    return float(np.hypot(aside, ahead))


def camera_points(depth: Depth, focal_px: float) -> Points:
    """Return what is measured at a quarter of the resolution, in camera coordinates (count, 3) in metres."""
    ray_x, ray_y = _rays((depth.shape[0], depth.shape[1]), focal_px)
    z = depth[::STEP_PX, ::STEP_PX].astype(np.float32) / np.float32(1000)
    points = np.stack([z * ray_x, z * ray_y, z], axis=-1).reshape(-1, 3)
    return points[points[:, 2] > 0]


def _rays(shape: tuple[int, int], focal_px: float) -> tuple[Image, Image]:
    down, across = ((np.arange(0, size, STEP_PX) - (size - 1) / 2) / focal_px for size in shape)
    return across.astype(np.float32)[None, :], down.astype(np.float32)[:, None]


def _join_cells(
    at: npt.NDArray[np.int64], x: Image, z: Image, pixel_m: Image
) -> tuple[Labels, Labels, npt.NDArray[np.uint8], int]:
    """`pixel_m`: how broad what a pixel shows is."""
    column = ((x.flat[at] + np.float32(ASIDE_M)) / np.float32(CELL_M)).astype(np.int64)
    row = (z.flat[at] / np.float32(CELL_M)).astype(np.int64)
    occupied = np.zeros((_ROWS, _COLUMNS), dtype=np.uint8)
    occupied[row, column] = 1
    count, cells = _components(occupied)
    place = row * _COLUMNS + column
    areas = np.asarray(np.bincount(place, weights=pixel_m.flat[at] ** 2, minlength=occupied.size), dtype=np.float64)
    dense = np.bincount(place, minlength=occupied.size).reshape(occupied.shape) >= DENSE_MIN_PX
    count = _part_at_strays(cells, count, dense, areas)
    labels: Labels = np.zeros(x.shape, dtype=np.int32)
    labels.flat[at] = cells[row, column]
    return labels, cells, occupied, count - 1


def _components(occupied: npt.NDArray[np.uint8]) -> tuple[int, Labels]:
    """Cells that touch, grown by one, or by two far away."""
    grown = np.asarray(cv2.dilate(occupied, _NEAR_CELLS))
    far = round(FAR_CELLS_M / CELL_M)
    grown[far:] = np.asarray(cv2.dilate(occupied, _FAR_CELLS))[far:]
    count, joined = cv2.connectedComponents(grown, connectivity=8, ltype=cv2.CV_32S)
    return count, np.asarray(joined, dtype=np.int32)


def _part_at_strays(cells: Labels, count: int, dense: Mask, areas: npt.NDArray[np.float64]) -> int:
    """Part components whose large pieces touch by stray points only, each point to the nearest; return the new count.

    In place. What is small stays with the piece that is nearest: it may be of somebody behind.
    """
    parts_count, parts = _components(dense.view(np.uint8))
    seen_m2 = np.bincount(parts[dense], weights=areas.reshape(dense.shape)[dense], minlength=parts_count)
    large = seen_m2 >= PIECE_MIN_M2
    first = np.zeros(parts_count, dtype=np.int32)  # the component that a piece lies in
    first[parts[dense]] = cells[dense]
    for whole in np.flatnonzero(np.bincount(first[large], minlength=count) > 1):
        pieces = np.flatnonzero(large & (first == whole))
        own = cells == whole
        away = [cv2.distanceTransform((~(dense & (parts == piece))).view(np.uint8), cv2.DIST_L2, 5) for piece in pieces]
        numbers = np.array([whole, *range(count, count + pieces.size - 1)], dtype=np.int32)
        cells[own] = numbers[np.argmin([part[own] for part in away], axis=0)]
        count += pieces.size - 1
    return count

"""What is measured of a body before the robot, to tell one person apart from all else."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.companion import CUES, Floats, measure
from clients.robot.hiding.moving.plan_bodies import CELL_M, LevelView
from clients.robot.hiding.silhouette_parts import find_behind_mm, shows_head_behind
from clients.robot.sensing.sensor_events import Mask

PIXELS_MIN_COUNT = 40
AREA_M2 = (0.10, 1.7)
TOP_MIN_M = 0.75  # lower: a chair, a child who crawls
WIDTH_MAX_M = 1.7
RANGE_MAX_M = 6.0
HEAD_M, SHOULDERS_M, CHEST_M = (0.0, 0.22), (0.30, 0.50), (0.30, 0.75)  # below the top
BODY_OFFSET_M = 0.10  # from the skin that the camera sees to the middle of the body
FREE_OF_WALLS_M = 9.0

BODY_CUES = (
    *CUES,
    "top_m",
    "bottom_m",
    "upright_residual_m",
    "plan_axis_long_m",
    "plan_axis_short_m",
    "shoulders_to_head",
    "chest_relief_m",
    "plan_area_m2",
    "wall_distance_m",
    "valid_share",
    "head_offset_m",
)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A body of a frame: its label, box in quarter-resolution pixels (x, y, width, height), level place, and cues."""

    label: int
    box: tuple[int, int, int, int]
    inside: Mask
    x_m: float
    z_m: float
    range_m: float
    top_m: float
    nearest_m: float
    median_mm: int
    pixels_count: int
    cues: Floats

    def shows_head_behind(self, view: LevelView, focal_px: float) -> bool:
        return shows_head_behind(self.inside, view.depth[self.rows_and_columns], focal_px)

    def behind_mm(self, view: LevelView) -> int:
        """Return how far away what may be of somebody behind begins."""
        return find_behind_mm(self.inside, view.depth[self.rows_and_columns])

    @property
    def rows_and_columns(self) -> tuple[slice, slice]:
        """Its box in the view."""
        left, top, width, height = self.box
        return slice(top, top + height), slice(left, left + width)


def measure_bodies(view: LevelView, focal_px: float) -> list[Body]:
    """The largest first."""
    counts = np.bincount(view.labels.ravel(), minlength=view.count + 1)
    found = []
    for label in sorted(range(1, view.count + 1), key=lambda label: -int(counts[label])):
        if counts[label] < PIXELS_MIN_COUNT:
            break
        body = _measure(view, label, int(counts[label]), focal_px)
        if body is not None:
            found.append(body)
    return found


def _measure(view: LevelView, label: int, count: int, focal_px: float) -> Body | None:
    mask = view.labels == label
    left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
    box = (slice(top, top + height), slice(left, left + width))
    inside = np.ascontiguousarray(mask[box])
    depth, x, z, up = (part[box][inside] for part in (view.depth, view.x, view.z, view.height))
    pixel_m = depth.astype(np.float32) / np.float32(1000 * focal_px)
    area_m2 = float(pixel_m @ pixel_m)
    highest, broad = float(np.partition(up, -3)[-3]), float(np.ptp(x))
    middle_x, middle_z = float(x.mean()), float(np.median(z))
    away_m = float(np.hypot(middle_x, middle_z))
    if not AREA_M2[0] <= area_m2 <= AREA_M2[1] or highest < TOP_MIN_M or broad > WIDTH_MAX_M or away_m > RANGE_MAX_M:
        return None
    shape = (view.depth.shape[0], view.depth.shape[1])
    cues = measure(inside, view.depth[box], left, top, shape, focal_px)
    eye_m = view.ground.height_m
    ahead_m = middle_z + BODY_OFFSET_M
    chest_m = max(0.0, highest * 0.75)
    return Body(
        label=label,
        box=(left, top, width, height),
        inside=inside,
        x_m=middle_x,
        z_m=ahead_m,
        range_m=float(np.sqrt(middle_x**2 + ahead_m**2 + (eye_m - chest_m) ** 2)),
        top_m=highest,
        nearest_m=float(z.min()),
        median_mm=int(np.median(depth)),
        pixels_count=count,
        cues=np.concatenate([cues, _own_cues(view, label, inside, x, z, up, highest)]),
    )


def _own_cues(
    view: LevelView,
    label: int,
    inside: Mask,
    x: npt.NDArray[np.float32],
    z: npt.NDArray[np.float32],
    up: npt.NDArray[np.float32],
    highest: float,
) -> Floats:
    below = np.float32(highest) - up
    dx, dz = x - x.mean(), z - z.mean()
    table = np.array([[dx @ dx, dx @ dz], [dx @ dz, dz @ dz]], dtype=np.float64) / x.size
    values, axes = np.linalg.eigh(table)
    residual = np.abs(dx * np.float32(axes[0, 0]) + dz * np.float32(axes[1, 0]))
    head, shoulders, chest = (
        (below >= low) & (below < high) if low else below < high for low, high in (HEAD_M, SHOULDERS_M, CHEST_M)
    )
    breadths = [float(np.ptp(x[part])) if np.count_nonzero(part) > 2 else 0.0 for part in (head, shoulders)]
    offset = abs(float(x[head].mean() - x[shoulders].mean())) if head.any() and shoulders.any() else 0.0
    rows = inside.any(axis=1)
    spans = inside.shape[1] - inside.argmax(axis=1) - inside[:, ::-1].argmax(axis=1)
    cells = np.count_nonzero((view.cells == label) & (view.occupied > 0))
    away = [float(-wall.depth_behind(x, z).max()) for wall in view.walls]
    return np.array(
        [
            highest,
            float(np.partition(up, 2)[2]),
            float(residual.mean()),
            float(np.sqrt(max(values[1], 0.0))),
            float(np.sqrt(max(values[0], 0.0))),
            breadths[1] / max(breadths[0], 0.05),
            _relief_m(x[chest], z[chest]),
            cells * CELL_M * CELL_M,
            min(away, default=FREE_OF_WALLS_M),
            x.size / max(1, int(spans[rows].sum())),
            offset,
        ],
        dtype=np.float64,
    )


def _relief_m(x: npt.NDArray[np.float32], z: npt.NDArray[np.float32]) -> float:
    """Return the deviation of depth from a plane that may be turned."""
    if x.size < 8:
        return 0.0
    dx, dz = x - x.mean(), z - z.mean()
    slope = float(dx @ dz) / max(float(dx @ dx), 1e-6)
    return float(np.std(dz - np.float32(slope) * dx))

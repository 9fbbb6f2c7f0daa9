"""Cuts one body out of the whole frame, onto nothing: what lies in its own cells of the plan and not behind it."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.cutouts import Cutout
from clients.robot.hiding.moving.body_cues import Body
from clients.robot.hiding.moving.plan_bodies import (
    AHEAD_M,
    ASIDE_M,
    CELL_M,
    HIGHEST_M,
    NOISE_SIGMAS,
    STEP_PX,
    LevelView,
)
from clients.robot.sensing.depth_noise import depth_sigma_m
from clients.robot.sensing.sensor_events import Depth, Mask

Ray = npt.NDArray[np.float32]

MARGIN_PX = 4
FEET_M = 0.03
SLACK_MM = 2.0  # of rounding
PIECE_MIN_PX = 24  # at full resolution, joined to what was found at a quarter of it


def cut_body(depth: Depth, view: LevelView, body: Body, focal_px: float) -> Cutout:
    left, top, width, height = (STEP_PX * part for part in body.box)
    x0, y0 = max(0, left - MARGIN_PX), max(0, top - MARGIN_PX)
    x1, y1 = min(depth.shape[1], left + width + MARGIN_PX), min(depth.shape[0], top + height + MARGIN_PX)
    pixels = depth[y0:y1, x0:x1]
    across = ((np.arange(x0, x1) - (depth.shape[1] - 1) / 2) / focal_px).astype(np.float32)
    down = ((np.arange(y0, y1) - (depth.shape[0] - 1) / 2) / focal_px).astype(np.float32)
    axes = view.ground.level_axes().astype(np.float32)
    at = np.flatnonzero(_as_far(pixels, view, body, across, down, axes[2]))
    ahead = pixels.ravel()[at].astype(np.float32) / np.float32(1000)
    x, up, z = (
        ahead * ((across * axis[0])[None, :] + (down * axis[1] + axis[2])[:, None]).ravel()[at] for axis in axes
    )
    up += np.float32(view.ground.height_m)
    known = np.flatnonzero((up > FEET_M) & (up < HIGHEST_M) & (z > 0) & (z < AHEAD_M) & (np.abs(x) < ASIDE_M))
    x, z, ahead, at = x[known], z[known], ahead[known], at[known]
    column = ((x + np.float32(ASIDE_M)) / np.float32(CELL_M)).astype(np.int32)
    row = (z / np.float32(CELL_M)).astype(np.int32)
    own = view.cells.ravel()[row * view.cells.shape[1] + column] == body.label
    for wall in view.walls:
        own &= ~wall.covers(x, z, NOISE_SIGMAS * depth_sigma_m(ahead))
    mask = np.zeros(pixels.shape, dtype=np.uint8)
    mask.ravel()[at[own]] = 1
    return Cutout(x0, y0, np.where(_joined(mask, body, x0, y0), pixels, np.uint16(0)))


def _as_far(pixels: Depth, view: LevelView, body: Body, across: Ray, down: Ray, ahead: Ray) -> Mask:
    """Tell which pixels are as far away as the body's cells, roughly, and not behind its largest part."""
    own = np.flatnonzero((view.cells == body.label).any(axis=1))
    share = np.add.outer(down[[0, -1]] * ahead[1] + ahead[2], across[[0, -1]] * ahead[0])  # of depth that leads ahead
    low, high = 1, body.behind_mm(view)
    if share.min() > 0:
        low = int(max(low, 1000 * CELL_M * own[0] / share.max() - SLACK_MM))
        high = int(min(high, 1000 * CELL_M * (own[-1] + 1) / share.min() + SLACK_MM))
    return np.asarray(cv2.inRange(pixels, low, high)) > 0


def _joined(mask: cv2.typing.MatLike, body: Body, x0: int, y0: int) -> cv2.typing.MatLike:
    """Keep pieces in which the body was found."""
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8, ltype=cv2.CV_32S)
    rows, columns = np.nonzero(body.inside)
    rows, columns = STEP_PX * (rows + body.box[1]) - y0, STEP_PX * (columns + body.box[0]) - x0
    found = np.bincount(pieces[rows, columns], minlength=count)
    keep = (found > 0) & (stats[:, cv2.CC_STAT_AREA] >= PIECE_MIN_PX)
    keep[0] = False
    return np.asarray(keep[pieces])

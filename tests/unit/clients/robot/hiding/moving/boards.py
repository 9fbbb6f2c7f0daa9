"""Upright boards before a level camera, as a frame of depth."""

from __future__ import annotations

import numpy as np

from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.plan_bodies import STEP_PX, LevelView, PlanView
from clients.robot.sensing.sensor_events import Depth

FOCAL_PX, EYE_M = 525.0, 1.2
PERSON_M = (-0.25, 0.25), (0.3, 1.7), 2.0  # right, up, ahead
BEHIND_M = 2.6
SLIVER = (0.2, 0.40), (1.2, 1.7), BEHIND_M  # right of who is at 0.25 m
STRAYS_M = tuple(np.arange(2.05, BEHIND_M, 0.05))
Board = tuple[tuple[float, float], tuple[float, float], float]


def draw(*boards: Board, strays_m: tuple[float, ...] = ()) -> Depth:
    """The nearer before the farther, and points beside the first one that lie at such depths."""
    depth = np.zeros((480, 640), np.uint16)
    across, down = (np.arange(640) - 319.5) / FOCAL_PX, (np.arange(480) - 239.5) / FOCAL_PX
    for (left, right), (low, high), ahead in sorted(boards, key=lambda board: -board[2]):
        columns = (across * ahead >= left) & (across * ahead <= right)
        rows = (EYE_M - down * ahead >= low) & (EYE_M - down * ahead <= high)
        depth[np.ix_(rows, columns)] = round(1000 * ahead)
    (_, right), _, ahead = boards[0]
    edge = STEP_PX * (int(np.flatnonzero(across * ahead <= right)[-1]) // STEP_PX + 1)
    for number, ahead in enumerate(strays_m):
        depth[160 + 4 * STEP_PX * number, edge] = round(1000 * ahead)
    return depth


def look(depth: Depth) -> LevelView:
    return PlanView((480, 640), FOCAL_PX, Ground.of_mount(EYE_M, 0.0)).look(depth)

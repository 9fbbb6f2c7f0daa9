"""What stands apart in plan, and what only stray points between two surfaces join."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.plan_bodies import STEP_PX, LevelView, PlanView

FOCAL_PX, EYE_M = 525.0, 1.2
PERSON_M = (-0.25, 0.25), (0.3, 1.7), 2.0  # right, up, ahead
BEHIND_M = 2.6


def look(
    *boards: tuple[tuple[float, float], tuple[float, float], float], strays_m: tuple[float, ...] = ()
) -> LevelView:
    """Upright boards, the nearer before the farther, and points beside the first one that lie at such depths."""
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
    return PlanView((480, 640), FOCAL_PX, Ground.of_mount(EYE_M, 0.0)).look(depth)


def labels_at(view: LevelView, ahead_m: float) -> set[int]:
    return set(view.labels[np.abs(view.z - ahead_m) < 0.02].tolist())


def test_stray_points_between_a_person_and_furniture_do_not_make_them_one() -> None:
    cupboard = (0.1, 0.9), (0.3, 1.5), BEHIND_M
    strays = tuple(np.arange(2.05, BEHIND_M, 0.05))
    alone, joined = look(PERSON_M, cupboard), look(PERSON_M, cupboard, strays_m=strays)
    for view in (alone, joined):
        (person,), (thing,) = labels_at(view, 2.0), labels_at(view, BEHIND_M)
        assert person != thing
    assert labels_at(joined, 2.1) == labels_at(joined, 2.0), "a stray point is of whom it is nearest to"
    assert labels_at(joined, 2.5) == labels_at(joined, BEHIND_M)


@pytest.mark.parametrize("between", ["sliver", "arm"])
def test_a_sliver_behind_a_person_or_an_arm_towards_furniture_stays_with_them(between: str) -> None:
    if between == "sliver":  # of somebody behind, too small to be a body
        view = look(PERSON_M, ((0.2, 0.32), (1.2, 1.7), BEHIND_M), strays_m=tuple(np.arange(2.05, BEHIND_M, 0.05)))
        assert labels_at(view, BEHIND_M) == labels_at(view, 2.0)
        return
    arm = [((0.25, 0.33), (ahead - 0.9, ahead - 0.8), ahead) for ahead in np.arange(2.05, BEHIND_M, 0.05)]
    view = look(PERSON_M, ((0.1, 0.9), (0.3, 1.5), BEHIND_M), *arm)
    assert labels_at(view, BEHIND_M) == labels_at(view, 2.0)

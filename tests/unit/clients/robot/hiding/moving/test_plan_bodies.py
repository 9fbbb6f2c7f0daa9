"""What stands apart in plan, and what only stray points between two surfaces join."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.hiding.moving.plan_bodies import PIECE_MIN_M2, LevelView, _part_at_strays
from tests.unit.clients.robot.hiding.moving.boards import BEHIND_M, PERSON_M, SLIVER, STRAYS_M, draw, look


def labels_at(view: LevelView, ahead_m: float) -> set[int]:
    return set(view.labels[np.abs(view.z - ahead_m) < 0.02].tolist())


def test_stray_points_between_a_person_and_furniture_do_not_make_them_one() -> None:
    cupboard = (0.1, 0.9), (0.3, 1.5), BEHIND_M
    alone, joined = look(draw(PERSON_M, cupboard)), look(draw(PERSON_M, cupboard, strays_m=STRAYS_M))
    for view in (alone, joined):
        (person,), (thing,) = labels_at(view, 2.0), labels_at(view, BEHIND_M)
        assert person != thing
    assert labels_at(joined, 2.1) == labels_at(joined, 2.0), "a stray point is of whom it is nearest to"
    assert labels_at(joined, 2.5) == labels_at(joined, BEHIND_M)


@pytest.mark.parametrize("between", ["sliver", "arm"])
def test_a_sliver_behind_a_person_or_an_arm_towards_furniture_stays_with_them(between: str) -> None:
    if between == "sliver":  # of somebody behind, too small to be a body
        view = look(draw(PERSON_M, SLIVER, strays_m=STRAYS_M))
        assert labels_at(view, BEHIND_M) == labels_at(view, 2.0)
        return
    arm = [((0.25, 0.33), (ahead - 0.9, ahead - 0.8), ahead) for ahead in STRAYS_M]
    view = look(draw(PERSON_M, ((0.1, 0.9), (0.3, 1.5), BEHIND_M), *arm))
    assert labels_at(view, BEHIND_M) == labels_at(view, 2.0)


def test_of_two_pieces_that_stray_points_join_only_large_ones_are_two_bodies() -> None:
    """A small one may be of somebody behind, whose sliver must not pass for another body beside the owner."""
    dense = np.zeros((20, 20), dtype=bool)
    dense[2:8, 2:8] = dense[14:16, 2:8] = True
    joined = dense.copy()
    joined[8:14, 4] = True
    for area_m2, bodies_count in ((PIECE_MIN_M2 / 4, 3), (PIECE_MIN_M2 / 20, 2)):
        cells = joined.astype(np.int32)
        assert _part_at_strays(cells, 2, dense, np.full(dense.size, area_m2)) == bodies_count
        assert len(set(cells[dense].tolist())) == bodies_count - 1

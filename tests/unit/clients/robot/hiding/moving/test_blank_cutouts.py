"""What is cut out of a frame onto nothing."""

from __future__ import annotations

import numpy as np

from clients.robot.hiding.moving.blank_cutouts import cut_body
from clients.robot.hiding.moving.body_cues import measure_bodies
from clients.robot.hiding.moving.plan_bodies import STEP_PX
from tests.unit.clients.robot.hiding.moving.boards import FOCAL_PX, PERSON_M, SLIVER, STRAYS_M, draw, look


def test_a_sliver_of_somebody_right_behind_is_not_shown_though_it_is_in_the_same_body() -> None:
    depth = draw(PERSON_M, SLIVER, strays_m=STRAYS_M)
    view = look(depth)
    (body,) = measure_bodies(view, FOCAL_PX / STEP_PX)
    inside = view.depth[view.labels == body.label]
    assert np.count_nonzero(inside > 2_500) >= 20, "the sliver is in the body"
    shown = cut_body(depth, view, body, FOCAL_PX).pixels
    assert np.count_nonzero(shown) == np.count_nonzero(depth == 2_000)


def test_a_leg_that_is_set_back_is_shown() -> None:
    coat, leg = ((-0.25, 0.25), (0.8, 1.7), 2.0), ((-0.2, -0.05), (0.3, 0.8), 2.08)
    depth = draw(coat, leg)
    view = look(depth)
    (body,) = measure_bodies(view, FOCAL_PX / STEP_PX)
    shown = cut_body(depth, view, body, FOCAL_PX).pixels
    assert np.count_nonzero(shown) == np.count_nonzero(depth)

"""Who is shown before the empty scene."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.standing_hider import StandingHider
from clients.robot.sensing.sensor_events import Depth

FOCAL_PX, ROOM_MM = 525.0, 8_000


EMPTY = np.full((480, 640), ROOM_MM, np.uint16)


def withhold_reason(depth: Depth, *, drives: bool) -> str:
    found = StandingHider(learn_background([EMPTY] * 3), FOCAL_PX, drives=drives).find_people(depth, None, 0)
    assert found is not None
    (person,) = found.silhouettes
    return person.withhold_reason


def somebody(away_mm: int, left_px: int) -> Depth:
    """1.7 m tall, half a metre broad."""
    depth, scale = EMPTY.copy(), FOCAL_PX * 1_000 / away_mm
    top, height, width = round(240 - 0.9 * scale), round(1.7 * scale), round(0.55 * scale)
    head = slice(left_px + width // 3, left_px + 2 * width // 3)
    depth[top : top + height // 8, head] = away_mm
    depth[top + height // 8 : top + height, max(0, left_px) : left_px + width] = away_mm
    return depth


@pytest.mark.parametrize(("drives", "reason"), [(False, ""), (True, "out-of-range")])
def test_a_robot_that_drives_shows_nobody_beyond_a_limit(*, drives: bool, reason: str) -> None:
    assert withhold_reason(somebody(5_500, 290), drives=drives) == reason
    assert withhold_reason(somebody(4_000, 290), drives=drives) == ""


@pytest.mark.parametrize(("drives", "reason"), [(False, ""), (True, "cut-off")])
def test_a_robot_that_drives_shows_nobody_whom_the_pictures_side_cuts_off(*, drives: bool, reason: str) -> None:
    """An arm of somebody beside the picture was part of the silhouette, and the tag theirs."""
    assert withhold_reason(somebody(3_500, 0), drives=drives) == reason
    assert withhold_reason(somebody(3_500, 4), drives=drives) == ""

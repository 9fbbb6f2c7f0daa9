"""Who is shown before the empty scene."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.standing_hider import StandingHider
from clients.robot.sensing.sensor_events import Depth

FOCAL_PX, ROOM_MM = 525.0, 8_000
EMPTY = np.full((480, 640), ROOM_MM, np.uint16)
LEFT_PX, RIGHT_PX = 0, 640 - 82  # of somebody 3.5 m away at either side of the picture


def withhold_reason(depth: Depth, *, drives: bool, empty: Depth = EMPTY) -> str:
    found = StandingHider(learn_background([empty] * 3), FOCAL_PX, drives=drives).find_people(depth, None, 0)
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
@pytest.mark.parametrize(("side_px", "inwards_px"), [(LEFT_PX, 4), (RIGHT_PX, -4)])
@pytest.mark.parametrize("unmeasured_px", [0, 4, 20])
def test_a_robot_that_drives_shows_nobody_whom_the_pictures_side_cuts_off(
    *, drives: bool, reason: str, side_px: int, inwards_px: int, unmeasured_px: int
) -> None:
    """An arm of somebody beside the picture was part of the silhouette, and the tag theirs.

    Stereo and registered depth leave out some columns, and the picture ends there.
    """

    def reason_at(left_px: int) -> str:
        return withhold_reason(without_sides(somebody(3_500, left_px)), drives=drives, empty=without_sides(EMPTY))

    def without_sides(depth: Depth) -> Depth:
        measured = np.zeros_like(depth)
        measured[:, unmeasured_px : 640 - unmeasured_px] = depth[:, unmeasured_px : 640 - unmeasured_px]
        return measured

    band_px = unmeasured_px if side_px == LEFT_PX else -unmeasured_px
    assert reason_at(side_px) == reason
    assert reason_at(side_px + band_px) == reason
    assert reason_at(side_px + band_px + inwards_px) == ""

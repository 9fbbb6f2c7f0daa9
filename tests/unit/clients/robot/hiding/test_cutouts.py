"""What is cut out for one person holds no pixel of the person beside them, nor of what stands far behind."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.hiding.background import Background, learn_background
from clients.robot.hiding.cutouts import extract_cutout
from clients.robot.hiding.segmentation import Segmented, Silhouette

NEAR_MM, ROOM_MM = 2_000, 4_000
OWNER, OTHER = 1, 2
TOP, BOTTOM = 20, 100


@pytest.fixture(scope="module")
def background() -> Background:
    return learn_background([np.full((120, 160), ROOM_MM, np.uint16)] * 3)


def cut_beside(background: Background, first_column: int, depth_mm: int, label: int) -> np.ndarray:
    """Cut the owner, columns 40 to 59, out of a frame in which something begins at a column; return the whole frame."""
    depth = np.full((120, 160), ROOM_MM, np.uint16)
    depth[TOP:BOTTOM, 40:60] = NEAR_MM
    depth[TOP:BOTTOM, first_column : first_column + 20] = depth_mm
    labels = np.zeros((60, 80), np.int32)
    labels[TOP // 2 : BOTTOM // 2, 20:30] = OWNER
    labels[TOP // 2 : BOTTOM // 2, (first_column + 1) // 2 : first_column // 2 + 10] = label
    owner = Silhouette(
        OWNER, (20, TOP // 2, 10, (BOTTOM - TOP) // 2), 0.0, 2.0, 2.0, NEAR_MM, "", ahead_m=2.0, right_m=0.0
    )
    out = extract_cutout(depth, background, Segmented((owner,), labels), owner)
    whole = np.zeros_like(depth)
    whole[out.y : out.y + out.pixels.shape[0], out.x : out.x + out.pixels.shape[1]] = out.pixels
    return whole


def test_of_the_owner_every_pixel_inside_is_there_and_nothing_of_the_room(background: Background) -> None:
    whole = cut_beside(background, 120, NEAR_MM, OTHER)
    assert (whole[TOP + 4 : BOTTOM - 4, 44:56] == NEAR_MM).all()
    assert set(np.unique(whole)) == {0, NEAR_MM}


@pytest.mark.parametrize("label", [OTHER, -1])
@pytest.mark.parametrize("first_column", [60, 62])
def test_nothing_is_there_of_somebody_who_stands_as_near_right_beside(
    background: Background, first_column: int, label: int
) -> None:
    """An edge is regrown by 3 px, further than the gap between the two; -1 is foreground that is nobody's."""
    whole = cut_beside(background, first_column, NEAR_MM, label)
    assert not whole[:, first_column:].any()
    assert whole[60, 50] == NEAR_MM


def test_nothing_is_there_of_a_wall_that_somebody_leans_against() -> None:
    """The room is as near as a step there, and no farther than a body is deep: it shows by being as it was empty."""
    wall_mm = NEAR_MM + 100
    background = learn_background([np.full((120, 160), wall_mm, np.uint16)] * 3)
    depth = np.full((120, 160), wall_mm, np.uint16)
    depth[TOP:BOTTOM, 40:60] = NEAR_MM
    labels = np.zeros((60, 80), np.int32)
    labels[TOP // 2 : BOTTOM // 2, 20:30] = OWNER
    owner = Silhouette(
        OWNER, (20, TOP // 2, 10, (BOTTOM - TOP) // 2), 0.0, 2.0, 2.0, NEAR_MM, "", ahead_m=2.0, right_m=0.0
    )
    out = extract_cutout(depth, background, Segmented((owner,), labels), owner)
    assert set(np.unique(out.pixels)) == {0, NEAR_MM}


@pytest.mark.parametrize("columns", [2, 8])
def test_nothing_is_there_of_who_shows_right_behind_within_the_owners_silhouette(
    background: Background, columns: int
) -> None:
    depth = np.full((120, 160), ROOM_MM, np.uint16)
    depth[TOP:BOTTOM, 40:60] = NEAR_MM
    depth[60:BOTTOM, 60 : 60 + columns] = NEAR_MM + 300
    labels = np.zeros((60, 80), np.int32)
    labels[TOP // 2 : BOTTOM // 2, 20 : (60 + columns) // 2] = OWNER
    labels[TOP // 2 : 30, 30:] = 0
    box = (20, TOP // 2, 10 + columns // 2, (BOTTOM - TOP) // 2)
    owner = Silhouette(OWNER, box, 0.0, 2.0, 2.0, NEAR_MM, "", ahead_m=2.0, right_m=0.0)
    out = extract_cutout(depth, background, Segmented((owner,), labels), owner)
    assert set(np.unique(out.pixels)) == {0, NEAR_MM}
    assert np.count_nonzero(out.pixels) == 20 * (BOTTOM - TOP)


def test_nothing_is_there_of_what_stands_a_step_behind(background: Background) -> None:
    """It is a body's depth away at most, in no silhouette of its own, and still not of this person."""
    whole = cut_beside(background, 60, NEAR_MM + 500, 0)
    assert not whole[:, 60:].any()

"""What a time-of-flight camera measures between two surfaces is in no picture."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.flying_pixels import JUMP_MM, drop_flying_pixels
from clients.robot.hiding.frame_redactor import FrameRedactor, KeptFrame, Output
from clients.robot.sensing.sensor_events import Depth, Facing, Frame, Sighting

ROOM_MM, PERSON_MM, BETWEEN_MM = 4_000, 2_500, 2_700
FOCAL_PX = 262.5
FRAMES_COUNT, FRAME_MS = 60, 100


def room() -> Depth:
    return np.full((240, 320), ROOM_MM, np.uint16)


def somebody(left: int) -> Depth:
    """A person with a seam of pixels that are measured on the way to the wall."""
    depth = room()
    depth[40:220, left - 1 : left + 51] = BETWEEN_MM
    depth[40:220, left : left + 50] = PERSON_MM
    return depth


def pictures(*, time_of_flight: bool) -> list[Depth]:
    redactor = FrameRedactor(learn_background([room()] * 3), time_of_flight=time_of_flight, focal_px=FOCAL_PX)
    outputs: list[Output] = []
    for number in range(FRAMES_COUNT):
        at_ms, left = number * FRAME_MS, 100 + number
        x_m = (left + 25 - 160) * PERSON_MM / 1000 / FOCAL_PX
        heard = Sighting(at_ms, at_ms, "", 1, Facing.FRONT, -50.0, math.hypot(x_m, PERSON_MM / 1000), 0.2)
        outputs += redactor.push_sighting("owner", heard)
        outputs += redactor.push_frame(Frame(at_ms, number, somebody(left)))
    kept = [one for one in [*outputs, *redactor.flush()] if isinstance(one, KeptFrame)]
    return [
        np.asarray(cv2.imdecode(np.frombuffer(one.cutout.pixels_png, np.uint8), cv2.IMREAD_UNCHANGED), np.uint16)
        for one in kept
    ]


def test_pixels_between_a_person_and_the_wall_are_dropped_from_pictures_before_a_learned_scene() -> None:
    shown = pictures(time_of_flight=True)
    assert len(shown) > 0.8 * FRAMES_COUNT
    assert {int(value) for picture in shown for value in np.unique(picture)} == {0, PERSON_MM}
    assert all(np.count_nonzero(picture) > 0.9 * 180 * 48 for picture in shown)
    # Else the seam is taken for somebody right behind the person.
    assert pictures(time_of_flight=False) == []


@pytest.mark.parametrize("slope_mm", [0, 5, 20])
def test_a_surface_that_is_seen_at_an_angle_stays_whole(slope_mm: int) -> None:
    depth = np.broadcast_to(2_000 + slope_mm * np.arange(80), (60, 80)).astype(np.uint16)
    assert np.array_equal(drop_flying_pixels(depth), depth)


def test_a_step_is_dropped_on_both_sides_and_unmeasured_pixels_count_for_nothing() -> None:
    depth = np.full((60, 80), 1_000, np.uint16)
    depth[:, 40:], depth[:, 20] = 1_000 + 3 * JUMP_MM, 0
    left = np.flatnonzero(drop_flying_pixels(depth)[30] == 0)
    assert left.tolist() == [20, 39, 40]

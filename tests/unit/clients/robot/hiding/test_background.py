"""The empty scene is known again from where it was recorded, with people and doors in it, and not from elsewhere."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from clients.robot.hiding.background import Background, fits, learn_background
from clients.robot.hiding.frame_redactor import FrameRedactor, WithheldFrame
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.sensing.sensor_events import Facing, Frame, Sighting
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.scenes import draw_scene


def scene(*, moving: bool) -> Scenario:
    drawn = draw_scene(7, "moving-robot", duration_s=6.0, third=False)
    path = ((0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (5.0, 0.1, 0.4, 0.2), (6.0, 0.1, 0.4, 0.2))
    return replace(drawn, environment=replace(drawn.environment, camera_path=path if moving else ()))


def learned(renderer: Renderer) -> Background:
    return learn_background([renderer.empty_frame(i) for i in range(8)])


@pytest.fixture(scope="module")
def moving() -> Renderer:
    return Renderer(scene(moving=True))


def test_people_before_the_empty_scene_do_not_make_it_another_one() -> None:
    renderer = Renderer(scene(moving=False))
    background = learned(renderer)
    assert all(fits(background, renderer.frame(index)) for index in (0, 25, 50))
    assert fits(background, renderer.empty_frame(20))


def test_a_picture_without_any_measurement_says_nothing_of_another_scene(moving: Renderer) -> None:
    assert fits(learned(moving), np.zeros(moving.camera.shape, dtype=np.uint16))


def test_a_robot_that_has_moved_does_not_know_the_scene_again(moving: Renderer) -> None:
    background = learned(moving)
    assert fits(background, moving.frame(5))
    assert not fits(background, moving.frame(55))


def test_what_a_moved_robot_sees_is_withheld_and_said_so(moving: Renderer) -> None:
    redactor = FrameRedactor(learned(moving))
    outputs = []
    for index in (0, 5, 50, 55):
        outputs += redactor.push_frame(Frame(100 * index, index, moving.frame(index)))
        outputs += redactor.push_sighting(
            "owner", Sighting(100 * index, 100 * index, "", 1, Facing.FRONT, -50.0, 2.0, 0.3)
        )
    outputs += redactor.flush()
    reasons = {output.sequence: output.reason for output in outputs if isinstance(output, WithheldFrame)}
    assert Counter(reason for index, reason in reasons.items() if index >= 50) == Counter({WithholdReason.MOVED: 2})
    assert WithholdReason.MOVED not in {reason for index, reason in reasons.items() if index < 50}


@pytest.mark.parametrize("width", [80, 160, 320])
def test_a_small_camera_knows_its_scene_again(small_scenario: Scenario, width: int) -> None:
    scale = width / small_scenario.width
    camera = {"width": width, "height": width * 3 // 4, "focal_px": small_scenario.focal_px * scale}
    renderer = Renderer(replace(small_scenario, **camera))
    background = learned(renderer)
    assert all(fits(background, renderer.frame(index)) for index in range(6))


def test_a_small_camera_that_was_turned_does_not_know_the_scene_again() -> None:
    small = replace(scene(moving=True), width=160, height=120, focal_px=131.25)
    renderer = Renderer(small)
    background = learned(renderer)
    assert fits(background, renderer.frame(5))
    assert not fits(background, renderer.frame(55))


@pytest.mark.parametrize(
    ("measured", "sides"),
    [
        (slice(0, 80), (0, 79)),
        (slice(7, 75), (7, 74)),
        (slice(0, 0), (0, 79)),  # hardly anything: nothing is known of its sides
    ],
)
def test_the_sides_are_the_outermost_columns_that_the_camera_measures(measured: slice, sides: tuple[int, int]) -> None:
    empty = np.zeros((60, 80), np.uint16)
    empty[:, measured] = 3_000
    empty[30, 3] = 3_000  # a stray pixel is no column
    empty[:40, 10:20] = 0  # a window near the side, with the floor before it
    assert learn_background([empty] * 3).sides == sides

"""Drives written by hand: what a file says is what is drawn, and what is wrong in it is named."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_file import parse_scene
from clients.robot.synthetic.driving.drive_render import DriveRenderer
from clients.robot.synthetic.scenario import Scenario, load_scenario
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.conftest import SMALL

ROOM = """
[room]
width_m = 3.0
length_m = 9.0
ceiling_m = 2.6
doors = [{ wall = "left", at_m = 4.0, width_m = 1.2 }]

[robot]
start = [0.0, 1.0, 0.0]
speeds = [[0.0, 0.0, 0.0], [0.2, 0.5, 0.0], [0.6, 0.5, 0.0]]

[[furniture]]
kind = "partition"
width_m = 2.0
x = 0.0
z = 6.0
"""
TEXT = SMALL.replace("[[0.0, -0.4, 2.5], [0.6, 0.0, 2.2]]", "[[0.0, -0.6, 4.0], [0.6, -0.5, 4.0]]") + ROOM


def drive(text: str = TEXT) -> Drive:
    made = parse_scene(text)
    assert isinstance(made, Drive)
    return made


def test_a_file_without_a_room_is_a_scene_of_the_corridor() -> None:
    assert isinstance(parse_scene(SMALL), Scenario)


def test_the_robot_drives_as_the_file_says_and_its_odometry_agrees() -> None:
    made = drive()
    x, z, yaw = made.scenario.camera_at(0.6)
    assert (x, yaw) == (0.0, 0.0)
    assert z == pytest.approx(1.25, abs=0.02)
    last = made.odometry()[-1]
    assert math.hypot(last.x_m, last.z_m) == pytest.approx(0.25, abs=0.05)


def test_the_picture_shows_the_person_the_partition_and_through_the_door_what_is_behind_it() -> None:
    truth = DriveRenderer(drive()).truth(0)
    assert np.count_nonzero(truth.labels == 1) > 300
    ahead = truth.depth[truth.furniture == 1]
    assert np.median(ahead) == pytest.approx(4_950, abs=100)
    walled = DriveRenderer(drive(TEXT.replace("at_m = 4.0", "at_m = 8.0"))).truth(0)
    left = (slice(50, 70), slice(0, 30))
    assert truth.depth[left].max() > walled.depth[left].max() + 500


@pytest.mark.parametrize(
    ("right", "wrong", "named"),
    [
        ('wall = "left"', 'wall = "top"', "wall = 'top'"),
        ('kind = "partition"', 'kind = "sofa"', "kind = 'sofa'"),
        ("start = [0.0, 1.0, 0.0]\n", "", "'start'"),
        ("start = [0.0, 1.0, 0.0]", "start = [0.0]", "wrong kind"),
        ("speeds = [[0.0, 0.0, 0.0]", 'speeds = [["now", 0.0, 0.0]', "wrong kind"),
        ("speeds = [[0.0, 0.0, 0.0], ", "speeds = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], ", "rising time"),
        ("width_m = 2.0\n", "", "'width_m'"),
    ],
)
def test_what_is_wrong_is_named(right: str, wrong: str, named: str) -> None:
    with pytest.raises(BlockRobotError, match=named) as refused:
        parse_scene(TEXT.replace(right, wrong))
    assert refused.value.code == "CONFIGURATION_INVALID"


@pytest.mark.parametrize("speeds", ["[]", "[[0.0, 0.5, 0.0]]"])
def test_a_way_needs_two_moments(speeds: str) -> None:
    lines = [f"speeds = {speeds}" if line.startswith("speeds") else line for line in TEXT.splitlines()]
    with pytest.raises(BlockRobotError, match="two or more points"):
        parse_scene("\n".join(lines))


def test_a_robot_that_is_to_stand_plays_no_drive(tmp_path: Path) -> None:
    path = tmp_path / "drive.toml"
    path.write_text(TEXT, encoding="utf-8")
    with pytest.raises(BlockRobotError, match=r"\[room\]"):
        load_scenario(path)

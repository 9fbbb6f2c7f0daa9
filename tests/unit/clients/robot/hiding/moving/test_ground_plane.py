"""The plane under the robot: found with a mount that is known roughly, and never taken from something else."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clients.robot.hiding.moving.ground_plane import Ground, blend, fit_ground, measure_mount


def floor_seen(ground: Ground, *, sigma_m: float = 0.005, count: int = 1_500) -> np.ndarray:
    """Return points of the floor, in camera coordinates, 1 to 5 m ahead."""
    rng = np.random.default_rng(1)
    right, up, ahead = ground.level_axes()
    across, away = rng.uniform(-1.5, 1.5, count), rng.uniform(1.0, 5.0, count)
    height = rng.normal(-ground.height_m, sigma_m, count)
    points: np.ndarray = across[:, None] * right + height[:, None] * up + away[:, None] * ahead
    return points.astype(np.float32)


def tilt_deg(one: Ground, other: Ground) -> float:
    return math.degrees(math.acos(min(1.0, float(one.up @ other.up))))


@given(
    st.floats(0.9, 1.4),
    st.floats(math.radians(-2), math.radians(12)),
    st.floats(-0.02, 0.02),
    st.floats(-0.03, 0.03),
    st.floats(math.radians(-1.5), math.radians(1.5)),
)
def test_height_and_pitch_are_found_though_the_mount_is_known_roughly(
    height_m: float, pitch: float, roll: float, height_error_m: float, pitch_error: float
) -> None:
    true = Ground.of_mount(height_m, pitch, roll)
    mount = Ground.of_mount(height_m + height_error_m, pitch + pitch_error)
    found = fit_ground(floor_seen(true), mount, mount)
    assert found is not None
    assert tilt_deg(found, true) < 0.3
    assert abs(found.height_m - height_m) < 0.01


def test_a_table_top_is_not_the_ground() -> None:
    mount = Ground.of_mount(1.2, 0.05)
    assert fit_ground(floor_seen(Ground.of_mount(0.5, 0.05)), mount, mount) is None


def test_a_camera_that_was_knocked_askew_finds_no_ground() -> None:
    mount = Ground.of_mount(1.2, 0.05)
    assert fit_ground(floor_seen(Ground.of_mount(1.2, 0.05 + math.radians(9))), mount, mount) is None


def test_a_strip_of_floor_or_none_is_too_little() -> None:
    mount = Ground.of_mount(1.2, 0.05)
    points = floor_seen(mount)
    strip = points[np.abs(points[:, 2] - 3.0) < 0.2]
    assert fit_ground(strip, mount, mount) is None
    assert fit_ground(points[:20], mount, mount) is None


def test_a_new_plane_moves_the_last_one_only_in_part() -> None:
    both = blend(Ground.of_mount(1.0, 0.0), Ground.of_mount(1.1, 0.0))
    assert 1.05 < both.height_m < 1.07
    assert math.isclose(float(np.linalg.norm(both.up)), 1.0)


def test_level_axes_are_upright_and_right_handed() -> None:
    axes = Ground.of_mount(1.2, 0.2, 0.05).level_axes()
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert axes[0, 0] > 0.99
    assert Ground.of_mount(1.2, 0.2).pitch == 0.2


@given(st.floats(0.5, 1.8), st.floats(math.radians(-5), math.radians(25)))
def test_the_mount_is_measured_without_knowing_it(height_m: float, pitch: float) -> None:
    true = Ground.of_mount(height_m, pitch)
    table = floor_seen(Ground.of_mount(height_m - 0.15, pitch))[:700]
    found = measure_mount(np.concatenate([floor_seen(true), table]))
    assert found is not None
    assert tilt_deg(found, true) < 0.5
    assert abs(found.height_m - height_m) < 0.015


def test_a_wall_alone_says_nothing_of_the_mount() -> None:
    rng = np.random.default_rng(4)
    wall = np.stack([rng.uniform(-1, 1, 800), rng.uniform(-1, 1, 800), rng.normal(2, 0.01, 800)], axis=1)
    assert measure_mount(wall.astype(np.float32)) is None

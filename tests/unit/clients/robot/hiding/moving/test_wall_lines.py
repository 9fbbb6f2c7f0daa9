"""Walls in plan: long and filled; people abreast are none."""

from __future__ import annotations

import numpy as np

from clients.robot.hiding.moving.wall_lines import find_walls


def wall_points(count: int = 400, *, z_m: float = 4.0, half_m: float = 2.0) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(2)
    x = rng.uniform(-half_m, half_m, count).astype(np.float32)
    z = rng.normal(z_m, 0.01, count).astype(np.float32)
    return x, z, rng.uniform(1.0, 2.3, count).astype(np.float32), np.full(count, 0.02, np.float32)


def at(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float32)


def test_a_wall_covers_what_is_at_it_and_behind_it_but_not_before_it_or_beside_it() -> None:
    (wall,) = find_walls(*wall_points())
    x, z = at(0, 0, 0, 0, 3.0), at(4.03, 6.0, 3.5, 2.0, 4.0)
    assert wall.covers(x, z, np.zeros(5, np.float32)).tolist() == [True, True, False, False, False]
    assert np.allclose(wall.depth_behind(x, z)[:4], [0.03, 2.0, -0.5, -2.0], atol=0.05)


def test_what_is_seen_past_the_end_of_a_wall_is_not_behind_it() -> None:
    (wall,) = find_walls(*wall_points(half_m=1.0))
    assert not wall.covers(at(3.0), at(6.0), at(0.0))[0]  # the line of sight meets the wall's line 2 m aside
    assert wall.covers(at(1.2), at(6.0), at(0.0))[0]


def test_two_people_abreast_are_no_wall() -> None:
    rng = np.random.default_rng(3)
    x = np.concatenate([rng.uniform(-0.9, -0.35, 200), rng.uniform(0.35, 0.9, 200)]).astype(np.float32)
    z = rng.normal(3.0, 0.02, 400).astype(np.float32)
    assert find_walls(x, z, np.full(400, 1.4, np.float32), np.full(400, 0.02, np.float32)) == []


def test_what_is_low_is_no_wall() -> None:
    x, z, height, noise = wall_points()
    assert find_walls(x, z, height - np.float32(0.9 + 0.6), noise) == []


def test_two_walls_of_a_corner_are_both_found() -> None:
    x, z, height, noise = wall_points()
    walls = find_walls(np.concatenate([x, z - 6]), np.concatenate([z, x + 2]), np.tile(height, 2), np.tile(noise, 2))
    assert len(walls) == 2

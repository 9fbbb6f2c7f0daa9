"""Odometry that lies is found by what stands in the room: wheels that slip, a robot that is pushed, carried or turned."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.plan_bodies import LevelView
from clients.robot.hiding.moving.scan_match import CELL_M, DRIFT_CELLS, ScanMatch
from clients.robot.hiding.own_motion import OwnMotion, RobotPlace

SLOPE, COLUMNS, ROWS = 0.6, 160, 12
FRAME_MS, ENDS_MS = 100, 6_000
WALKER = 7
ROOM = [(-2.5, -2.0, -2.5, 6.0), (-2.5, 6.0, 2.0, 6.0), (2.0, 6.0, 2.0, -2.0), (2.0, -2.0, -2.5, -2.0)]
CUPBOARDS = [(-2.5, 3.0, -1.9, 3.0), (-1.9, 3.0, -1.9, 3.8), (2.0, 4.2, 1.3, 4.2), (-0.4, 5.0, 0.3, 5.0)]
HALL = [(-1.0, -50.0, -1.0, 50.0), (1.0, -50.0, 1.0, 50.0)]

Segment = tuple[float, float, float, float]


def view_from(place: RobotPlace, room: list[Segment], walker: tuple[float, float] | None = None) -> LevelView:
    """What the camera measures at the height of furniture, in plan."""
    slopes = np.linspace(-SLOPE, SLOPE, COLUMNS)
    cos, sin = math.cos(place.yaw), math.sin(place.yaw)
    along = np.stack([slopes * cos + sin, -slopes * sin + cos], axis=1)
    ahead, label = np.full(COLUMNS, 60.0), np.zeros(COLUMNS, np.int32)
    x, z = walker or (0.0, 0.0)
    body = [(x - 0.4, z, x + 0.4, z)] if walker else []
    for number, (x0, z0, x1, z1) in enumerate([*room, *body]):
        wall = np.array([x1 - x0, z1 - z0])
        start = np.array([x0 - place.x_m, z0 - place.z_m])
        across = along[:, 0] * wall[1] - along[:, 1] * wall[0]
        across = np.where(np.abs(across) < 1e-9, 1e-9, across)
        far = (start[0] * wall[1] - start[1] * wall[0]) / across
        share = (start[0] * along[:, 1] - start[1] * along[:, 0]) / across
        hit = (far > 0.1) & (share >= 0) & (share <= 1) & (far < ahead)
        ahead[hit], label[hit] = far[hit], WALKER * (number >= len(room))
    ahead = np.where(ahead < 50, ahead, 0.0)
    z_m = np.tile(ahead, (ROWS, 1)).astype(np.float32)
    height = np.tile(np.linspace(0.2, 2.2, ROWS)[:, None], (1, COLUMNS)).astype(np.float32)
    none = np.zeros((1, 1), np.uint8)
    labels = np.tile(label, (ROWS, 1))
    depth = (1000 * z_m).astype(np.uint16)
    x_m = np.asarray(z_m * slopes.astype(np.float32), np.float32)
    cells = none.astype(np.int32)
    return LevelView(depth, x_m, height, z_m, labels, cells, none, 0, Ground.of_mount(1.2, 0.0), ())


def drive(
    true: Callable[[float], RobotPlace],
    said: Callable[[float], RobotPlace],
    *,
    room: list[Segment] | None = None,
    walker: Callable[[float], tuple[float, float]] | None = None,
) -> OwnMotion:
    motion = OwnMotion()
    scans = ScanMatch(SLOPE, motion)
    for at_ms in range(0, ENDS_MS, FRAME_MS):
        at_s = at_ms / 1000
        where, told = true(at_s), said(at_s)
        place = RobotPlace(at_ms, told.x_m, told.z_m, told.yaw)
        motion.add(place)
        scans.agrees(view_from(where, room or ROOM + CUPBOARDS, walker and walker(at_s)), [WALKER], place)
    return motion


def ahead(mps: float) -> Callable[[float], RobotPlace]:
    return lambda at_s: RobotPlace(0, 0.0, mps * at_s)


def turning(degrees_per_s: float) -> Callable[[float], RobotPlace]:
    return lambda at_s: RobotPlace(0, 0.0, 0.0, math.radians(degrees_per_s) * at_s)


def stands(_: float) -> RobotPlace:
    return RobotPlace(0)


HONEST = [stands, ahead(0.4), ahead(-0.2), turning(20), lambda s: RobotPlace(0, 0.2 * s, 0.3 * s, -0.1 * s)]


@pytest.mark.parametrize("moves", HONEST)
def test_honest_odometry_is_believed_until_the_last_comparison(moves: Callable[[float], RobotPlace]) -> None:
    motion = drive(moves, moves)
    assert not motion.is_doubted(0, ENDS_MS)
    assert motion._confirmed_ms >= ENDS_MS - 600


@pytest.mark.parametrize(
    ("true", "said"),
    [
        (stands, ahead(0.4)),
        (ahead(0.4), stands),
        (ahead(0.1), stands),
        (turning(8), stands),
        (turning(10), turning(30)),
        (ahead(0.3), ahead(0.6)),
        (lambda s: RobotPlace(0, -0.15 * s, 0.0), stands),
    ],
)
def test_a_lie_is_found_within_three_seconds_and_again(
    true: Callable[[float], RobotPlace], said: Callable[[float], RobotPlace]
) -> None:
    motion = drive(true, said)
    assert motion.is_doubted(0, 3_000)
    assert len(motion._doubts) >= 2


def test_before_it_is_found_a_robot_is_pushed_by_less_than_readings_are_uncertain_by() -> None:
    """What was weighed until then was weighed for a place that was nearly right."""
    motion = OwnMotion()
    scans = ScanMatch(SLOPE, motion)
    for at_ms in range(0, ENDS_MS, FRAME_MS):
        pushed_m = 0.25 * at_ms / 1000
        motion.add(RobotPlace(at_ms))
        if not scans.agrees(view_from(RobotPlace(0, 0.0, pushed_m), ROOM + CUPBOARDS), [], RobotPlace(at_ms)):
            assert DRIFT_CELLS * CELL_M < pushed_m < 0.4
            return
    pytest.fail("the push was not found")


def test_somebody_who_comes_close_is_no_reason_for_doubt() -> None:
    motion = drive(stands, stands, walker=lambda at_s: (0.0, 2.0 - 0.2 * at_s))
    assert not motion.is_doubted(0, ENDS_MS)


def test_along_a_bare_corridor_nothing_speaks_against_a_distance_and_a_turn_is_found() -> None:
    assert not drive(ahead(0.4), stands, room=HALL).is_doubted(0, ENDS_MS)
    assert drive(turning(8), stands, room=HALL).is_doubted(0, ENDS_MS)


def test_where_nothing_is_in_reach_the_odometry_is_believed() -> None:
    assert not drive(ahead(0.4), stands, room=[(-50, 40, 50, 40)]).is_doubted(0, ENDS_MS)


def test_after_a_restart_nothing_of_before_is_compared_with() -> None:
    motion = OwnMotion()
    scans = ScanMatch(SLOPE, motion)
    assert scans.agrees(view_from(RobotPlace(0), ROOM + CUPBOARDS), [], RobotPlace(50_000))
    scans.restart()
    assert scans.agrees(view_from(RobotPlace(0, 0.0, 0.5), ROOM + CUPBOARDS), [], RobotPlace(1_000))
    assert motion._confirmed_ms == 1_000
    assert not motion.is_doubted(0, 60_000)


@pytest.mark.parametrize(("later_ms", "is_compared"), [(1_000, True), (3_900, True), (60_000, False)])
def test_what_was_seen_long_ago_is_not_compared_with(later_ms: int, *, is_compared: bool) -> None:
    """Before the empty scene nothing is compared, for as long as the robot stands there."""
    motion = OwnMotion()
    scans = ScanMatch(SLOPE, motion)
    assert scans.agrees(view_from(RobotPlace(0), ROOM + CUPBOARDS), [], RobotPlace(0))
    view = view_from(RobotPlace(0, 0.0, 0.5), ROOM + CUPBOARDS)
    assert scans.agrees(view, [], RobotPlace(later_ms)) is not is_compared
    assert motion.doubts_count == is_compared


def test_everything_since_the_last_comparison_is_doubted_also_since_time_zero() -> None:
    motion = OwnMotion()
    scans = ScanMatch(SLOPE, motion)
    assert scans.agrees(view_from(RobotPlace(0), ROOM + CUPBOARDS), [], RobotPlace(0))
    assert not scans.agrees(view_from(RobotPlace(0, 0.0, 0.5), ROOM + CUPBOARDS), [], RobotPlace(500))
    assert motion.is_doubted(100, 100)

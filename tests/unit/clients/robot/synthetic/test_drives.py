"""Drawn drives: each stratum is what it says, nothing stands in anybody's way, learning and judging never meet."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from clients.robot.synthetic.driving.draws import DRIVE_STRATA, DriveStratum, draw_drive
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.furniture import JUDGED_ONLY, KINDS, Piece, make_shape
from clients.robot.synthetic.driving.robot_motion import WOBBLE_MAX_RAD, Wobble
from clients.robot.synthetic.driving.room import Ground
from clients.robot.synthetic.scenario import check_scenario

SEEDS = range(20)
Floats = npt.NDArray[np.float64]


@cache
def drives(stratum: DriveStratum) -> tuple[Drive, ...]:
    """Return drives of a stratum, every second for judging."""
    return tuple(draw_drive(seed, stratum, judging=seed % 2 == 1) for seed in SEEDS)


def way_of(drive: Drive) -> Floats:
    """Return (t, x, z, yaw) of the robot while frames are taken."""
    table = np.array(drive.scenario.environment.camera_path)
    return table[table[:, 0] <= drive.scenario.duration_s]


def parts_of(piece: Piece) -> Floats:
    """Return (x, z) of ends of capsules and corners of boxes up to 2 m high."""
    capsules, faces = piece.capsules(0.0), piece.faces(0.0, 1)
    points = np.concatenate([capsules.start, capsules.end, faces.corners.reshape(-1, 3)])
    return points[points[:, 1] < 2.0][:, [0, 2]]


@pytest.mark.parametrize("stratum", DRIVE_STRATA)
def test_every_stratum_draws_whole_drives(stratum: DriveStratum) -> None:
    for drive in drives(stratum):
        scene = drive.scenario
        check_scenario(scene)
        assert (drive.stratum, scene.frame_rate, scene.width, scene.height) == (stratum, 5, 640, 480)
        assert 8 <= scene.duration_s <= 10
        assert 3 <= len(drive.pieces) <= 8
        assert drive.owners["owner"] >= 1
        assert 1 <= len(scene.people) <= 8
        assert all(person.place(t / 5) is not None for person in scene.people for t in range(scene.frame_count))
        assert abs(drive.mount.believed_height_m - scene.camera_height_m) <= 0.03
        assert abs(drive.mount.believed_pitch - drive.mount.pitch) <= math.radians(1.5)
        assert 1.0 <= scene.camera_height_m <= 1.35
        assert drive.time_of_flight == (stratum == "time-of-flight")
        assert bool(drive.room.panels) == (stratum == "glass")
        assert (drive.room.ground != Ground()) == (stratum == "ramp")


@pytest.mark.parametrize("stratum", DRIVE_STRATA)
def test_furniture_stands_in_nobodys_way(stratum: DriveStratum) -> None:
    for drive in drives(stratum):
        walked = [np.array([p.place(t / 5) for t in range(drive.scenario.frame_count)]) for p in drive.scenario.people]
        everybody = np.concatenate(walked)
        for piece in drive.pieces:
            parts = parts_of(piece)
            assert min(np.hypot(*(way_of(drive)[:, 1:3] - part).T).min() for part in parts) > 0.4
            assert min(np.hypot(*(everybody - part).T).min() for part in parts) > 0.2
        for path in walked:
            assert np.hypot(*(path - way_of(drive)[:, 1:3][::5][: len(path)]).T).min() > 0.6


@pytest.mark.parametrize("stratum", DRIVE_STRATA)
def test_robot_people_and_furniture_are_inside_the_room(stratum: DriveStratum) -> None:
    for drive in drives(stratum):
        assert drive.room.inside(way_of(drive)[:, 1:3], 0.5)
        for person in drive.scenario.people:
            if person.alias != "behind":
                assert drive.room.inside(np.array([point[1:] for point in person.path]), 0.25)
        for piece in drive.pieces:
            assert drive.room.inside(parts_of(piece), -0.05)


def test_learning_and_judging_never_meet() -> None:
    learned: set[str] = set()
    judged: set[str] = set()
    for stratum in DRIVE_STRATA:
        for drive in drives(stratum):
            (judged if drive.judging else learned).update(piece.kind for piece in drive.pieces)
            assert drive.scenario.seed % 2 == drive.judging
    assert len(JUDGED_ONLY) == 5
    assert len(KINDS) - len(JUDGED_ONLY) >= 15
    assert not learned & JUDGED_ONLY
    assert judged >= JUDGED_ONLY
    one, other = (draw_drive(7, "stop", judging=judging) for judging in (False, True))
    assert one.scenario.people != other.scenario.people
    assert one.scenario.environment.camera_path != other.scenario.environment.camera_path


def test_the_same_seed_draws_the_same_drive() -> None:
    for stratum in DRIVE_STRATA:
        one, two = (draw_drive(4, stratum, judging=False) for _ in range(2))
        assert one == two
        assert one.scenario.digest == two.scenario.digest != drives(stratum)[5].scenario.digest
        assert one.odometry() == two.odometry()


@pytest.mark.parametrize("stratum", DRIVE_STRATA)
def test_the_robot_drives_as_its_stratum_says(stratum: DriveStratum) -> None:
    for drive in drives(stratum):
        speed, turn = np.array([drive.speeds(t / 10) for t in range(round(10 * drive.scenario.duration_s))]).T
        assert np.abs(speed).max() <= 1.01
        assert np.abs(turn).max() <= math.radians(41)
        assert np.abs(np.diff(speed)).max() <= 0.15
        assert np.abs(np.diff(turn)).max() <= math.radians(15)
        if stratum in ("straight", "past"):
            assert speed.max() >= 0.19
            assert np.allclose(turn, 0)
        elif stratum == "turn":
            assert np.allclose(speed, 0)
            assert np.abs(turn).max() >= math.radians(10)
        elif stratum == "curve":
            assert np.abs(turn).max() >= math.radians(4.9)
            assert speed.max() >= 0.19
        elif stratum == "stop":
            assert np.count_nonzero(speed < 1e-3) >= 10
            assert speed[-1] > 0.1
        elif stratum == "to-and-fro":
            assert speed.min() < -0.15
            assert speed.max() > 0.15


def test_strata_of_people_are_what_they_say() -> None:
    for drive in drives("crowd"):
        assert len(drive.scenario.people) == 8
    for drive in drives("companions"):
        assert any(person.accompanies for person in drive.scenario.people)
    for drive in drives("bed"):
        assert any(person.aid == "bed" for person in drive.scenario.people)
    for drive in drives("past"):
        near = [np.hypot(*(way_of(drive)[:, 1:3] - person.path[0][1:]).T).min() for person in drive.scenario.people]
        assert min(near) < 1.8
    people = [person for stratum in DRIVE_STRATA[:6] for drive in drives(stratum) for person in drive.scenario.people]
    assert 0.1 < np.mean([bool(person.aid) for person in people]) < 0.3
    assert 0.02 < np.mean([person.kind == "child" for person in people]) < 0.15
    counts = [len(drive.scenario.people) for stratum in DRIVE_STRATA[:5] for drive in drives(stratum)]
    assert set(counts) == {1, 2, 3}


def test_a_body_wobbles_a_little_while_it_drives_and_not_while_it_stands() -> None:
    largest = 0.0
    for drive in drives("stop"):
        for t in range(80):
            level = drive.mount.wobble.at(t / 10, 1.0)
            largest = max(largest, *map(abs, level))
            assert max(map(abs, level)) <= WOBBLE_MAX_RAD
            if max(map(abs, drive.speeds(t / 10))) < 1e-6:
                pose = drive.camera_pose(t / 10)
                assert (pose.pitch, pose.roll) == pytest.approx((drive.mount.pitch, drive.mount.roll))
    assert largest > 0.5 * WOBBLE_MAX_RAD


def test_a_ramp_lifts_and_tilts_the_robot_and_a_threshold_bumps_it() -> None:
    drive = drives("straight")[0]
    (_, _, z, _), (_, _, last_z, _) = way_of(drive)[0], way_of(drive)[-1]
    sign = 1.0 if last_z > z else -1.0
    still = replace(drive, mount=replace(drive.mount, pitch=0.0, roll=0.0, wobble=Wobble()))
    middle = (z + last_z) / 2
    up = ((middle - 9.0, -9.0 * 0.05 * sign), (middle + 9.0, 9.0 * 0.05 * sign))
    climbing = replace(still, room=replace(still.room, ground=Ground(up)))
    start, end = (climbing.camera_pose(t) for t in (0.0, drive.scenario.duration_s))
    assert end.height_m - start.height_m == pytest.approx(0.05 * abs(last_z - z), rel=0.02)
    assert start.pitch == pytest.approx(-math.atan(0.05) * math.cos(start.yaw) * sign, abs=2e-3)
    bump = Ground(((middle, 0.0), (middle + 0.05, 0.02), (middle + 0.13, 0.02), (middle + 0.18, 0.0)))
    bumped = replace(still, room=replace(still.room, ground=bump))
    pitches = [bumped.camera_pose(t / 50).pitch for t in range(50 * 8)]
    assert max(pitches) > math.radians(1.5)
    assert min(pitches) < -math.radians(1.5)
    assert pitches[0] == 0


def test_readings_are_taken_from_the_moving_robot() -> None:
    for stratum in ("straight", "turn", "to-and-fro"):
        drive = drives(stratum)[2]
        reader = replace(drive.scenario.reader, missed=0.0, late_s=0.0, distance_sigma_m=1e-4, front_misread=0.0)
        sure = replace(drive, scenario=replace(drive.scenario, reader=reader))
        people = {person.alias: person for person in drive.scenario.people}
        for reading in sure.readings():
            pose, place = drive.camera_pose(reading.at_s), people[reading.alias].place(reading.at_s)
            assert place is not None
            dx, dz = place[0] - pose.x, place[1] - pose.z
            up = people[reading.alias].chest_height_m - pose.height_m
            assert reading.distance_m == pytest.approx(math.hypot(dx, dz, up), abs=1e-3)
            assert (reading.facing == "front") == (dx * math.sin(pose.yaw) + dz * math.cos(pose.yaw) >= 0)


def test_a_control_is_the_drive_less_one() -> None:
    drive = next(drive for drive in drives("straight") if len(drive.scenario.people) > 1)
    alone = drive.without("other")
    assert alone.scenario.absent == {"other"}
    assert replace(alone, scenario=drive.scenario) == drive
    assert {reading.alias for reading in alone.readings()} <= {"owner", "third"}


@pytest.mark.parametrize("kind", KINDS)
def test_furniture_stands_on_the_floor_upright_at_any_angle(kind: str) -> None:
    for seed in range(4):
        shape = make_shape(kind, np.random.default_rng(seed))
        piece = Piece(kind, shape, 1.0, 2.0, 0.7 * seed)
        capsules, faces = piece.capsules(0.5), piece.faces(0.5, 3)
        ends = np.concatenate([capsules.start, capsules.end])
        low = [*(ends[:, 1] - np.tile(capsules.radius, 2)), *faces.corners[..., 1].ravel()]
        high = [*(ends[:, 1] + np.tile(capsules.radius, 2)), *faces.corners[..., 1].ravel()]
        if kind != "pillar":  # goes through floor and ceiling
            assert 0.5 - 0.06 <= min(low) <= 0.5 + 0.12
            assert 0.9 <= max(high) <= 0.5 + 2.2
        right, ahead = shape.half_size()
        points = np.concatenate([ends[:, [0, 2]], faces.corners.reshape(-1, 3)[:, [0, 2]]])
        assert np.hypot(points[:, 0] - 1.0, points[:, 1] - 2.0).max() <= math.hypot(right, ahead) + 1e-6
        assert set(faces.labels) <= {3}

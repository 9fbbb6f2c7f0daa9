"""Frames of drives: labels, reflections, glass, ramps, flying pixels and blur are as told, in the same bytes each time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from clients.robot.sensing.sensor_events import Depth, Mask
from clients.robot.synthetic.driving.draws import DRIVE_STRATA, DriveStratum, draw_drive
from clients.robot.synthetic.driving.drive import Drive, Mount
from clients.robot.synthetic.driving.drive_render import DriveRenderer
from clients.robot.synthetic.driving.furniture import KINDS, Piece, make_shape
from clients.robot.synthetic.driving.robot_motion import Wobble
from clients.robot.synthetic.driving.room import Ground, Opening, Panel, Room
from clients.robot.synthetic.noise import FLYING_SHARE, FlightNoise, blur
from clients.robot.synthetic.scenario import Environment, Person

LEVEL = Mount(0.0, 0.0, Wobble(), 1.2, 0.0)
STILL = ((0.0, 0.0, 1.0, 0.0), (10.0, 0.0, 1.0, 0.0))
ANN = Person("owner", 1.7, 1.0, 1.0, ((0.0, 0.7, 4.0), (10.0, 0.7, 4.0)), (), 0.0)


def small(drive: Drive) -> Drive:
    return replace(drive, scenario=replace(drive.scenario, width=160, height=120, focal_px=131.25))


def standing(room: Room, *people: Person, mirror_floor: float = 0.0) -> Drive:
    """Return a small drive that stands at z = 1 in a room without furniture, and looks ahead."""
    drive = small(draw_drive(1, "straight", judging=False))
    environment = Environment(mirror_floor=mirror_floor, camera_path=STILL)
    scenario = replace(drive.scenario, camera_height_m=1.2, people=people, environment=environment)
    return replace(drive, scenario=scenario, room=room, pieces=(), mount=LEVEL, exposure_s=0.0)


def metres(depth: Depth) -> float:
    """Return how far most of a part of a frame is."""
    return float(np.median(depth[depth > 0])) / 1000


@pytest.mark.parametrize("stratum", DRIVE_STRATA)
def test_the_same_seed_has_the_same_bytes_and_each_pixel_one_truth(stratum: DriveStratum) -> None:
    first, second = (DriveRenderer(small(draw_drive(3, stratum, judging=True))) for _ in range(2))
    second.truth(30)
    shown = set()
    for index in (5, 25):
        one, two = first.truth(index), second.truth(index)
        for name in ("depth", "labels", "props", "furniture", "reflections"):
            assert np.array_equal(getattr(one, name), getattr(two, name))
        assert one.pose == two.pose
        marked = [one.labels > 0, one.furniture > 0, one.reflections > 0]
        assert not (np.sum(marked, axis=0) > 1).any()
        assert np.array_equal(one.props[one.props > 0], one.labels[one.props > 0])
        assert set(np.unique(one.labels)) <= set(range(len(first.drive.scenario.people) + 1))
        assert set(np.unique(one.furniture)) <= set(range(len(first.drive.pieces) + 1))
        shown |= {int(one.labels.max() > 0), 2 * int(one.furniture.max() > 0)}
    assert shown & {1, 2}


def test_all_kinds_of_furniture_can_be_seen_and_counted() -> None:
    drive = standing(Room(6.0, 12.0, 2.7))
    for kind in KINDS:
        piece = Piece(kind, make_shape(kind, np.random.default_rng(1)), 0.0, 4.0, 0.4)
        truth = DriveRenderer(replace(drive, pieces=(piece,))).truth(3)
        own = truth.furniture == 1
        assert np.count_nonzero(own) > 40
        assert not truth.labels.any()
        assert np.median(truth.depth[own & (truth.depth > 0)]) == pytest.approx(3000, abs=900)


def test_walls_and_ground_are_where_they_are() -> None:
    depth = DriveRenderer(standing(Room(4.0, 7.0, 2.7))).truth(3).depth
    assert metres(depth[40:50, 70:90]) == pytest.approx(6.0, abs=0.15)
    assert metres(depth[55:65, 156:]) == pytest.approx(2.0 / ((157.5 - 79.5) / 131.25), abs=0.15)
    assert metres(depth[110, 40:120]) == pytest.approx(1.2 / ((110 - 59.5) / 131.25), abs=0.1)


def test_a_ramp_is_drawn_as_high_as_the_ground_is() -> None:
    ground = Ground(((3.0, 0.0), (6.0, 0.3)))
    drive = standing(Room(4.0, 9.0, 2.7, ground=ground), replace(ANN, path=((0.0, 0.0, 6.5), (10.0, 0.0, 6.5))))
    truth = DriveRenderer(drive).truth(3)
    fall = (90 - 59.5) / 131.25
    expected = (1.2 + 0.1 * 2.0) / (fall + 0.1)  # the ramp rises 0.1 in 1 from 2 m before the camera
    assert metres(truth.depth[90, 20:60]) == pytest.approx(expected, abs=0.1)
    feet = np.nonzero(truth.labels == 1)[0].max()
    assert feet == pytest.approx(59.5 + 131.25 * (1.2 - 0.3) / 5.5, abs=3)


def test_a_mirror_shows_people_behind_it_and_says_whose_reflection_it_is() -> None:
    mirror = Panel("mirror", "far", 0.0, 3.0, (0.02, 2.2), 0.02)
    behind_robot = replace(ANN, path=((0.0, 0.4, 0.5), (10.0, 0.4, 0.5)))
    truth = DriveRenderer(standing(Room(4.0, 4.0, 2.7, panels=(mirror,)), behind_robot)).truth(3)
    assert not truth.labels.any()
    own = truth.reflections == 1
    assert np.count_nonzero(own) > 50
    assert np.median(truth.depth[own & (truth.depth > 0)]) / 1000 == pytest.approx(2 * 3.99 - 0.5 - 1.0, abs=0.25)
    rows, columns = np.nonzero(own)
    assert columns.mean() == pytest.approx(79.5 + 131.25 * 0.4 / 6.5, abs=3)
    wide = [np.ptp(columns[rows == row]) for row in (rows.min() + 2, (rows.min() + rows.max()) // 2)]
    assert wide[0] < wide[1]  # the head is on top


def test_a_pane_shows_what_is_behind_or_itself_or_nothing() -> None:
    pane = Panel("glass", "far", 0.0, 2.0, (0.0, 2.1), 0.4)
    room = Room(4.0, 5.0, 2.7, (Opening("far", 0.0, 2.0, 2.1),))
    visitor = replace(ANN, path=((0.0, 0.0, 6.0), (10.0, 0.0, 6.0)))
    bare, glazed = (DriveRenderer(standing(replace(room, panels=p), visitor)).truth(3) for p in ((), (pane,)))
    body = bare.labels == 1
    assert np.count_nonzero(body) > 300
    through, itself = body & (glazed.labels == 1), body & (glazed.labels == 0) & (glazed.depth > 0)
    assert 0.3 < np.count_nonzero(through) / np.count_nonzero(body) < 0.9
    assert np.count_nonzero(itself) > 30
    assert np.median(glazed.depth[itself]) == pytest.approx(4060, abs=120)
    assert np.count_nonzero(body & (glazed.depth == 0)) > np.count_nonzero(body & (bare.depth == 0))


def test_a_shiny_floor_shows_people_below_their_feet() -> None:
    room = Room(4.0, 9.0, 2.7)
    truth = DriveRenderer(standing(room, ANN, mirror_floor=0.9)).truth(3)
    own = truth.reflections == 1
    assert np.count_nonzero(own) > 50
    assert np.nonzero(own)[0].min() >= np.nonzero(truth.labels == 1)[0].max() - 12
    assert not (own & (truth.labels > 0)).any()
    assert truth.depth[own].max() > 1000


def holes_in_floor(drive: Drive) -> dict[tuple[int, int], bool]:
    """Return which decimetres of the floor have no depth in most of their pixels."""
    renderer = DriveRenderer(drive)
    truth = renderer.truth(3)
    away, axes = renderer.camera.ground(), truth.pose.axes()
    ray = [axes[0][i] * renderer.camera.ray_x + (axes[1][i] * renderer.camera.ray_y + axes[2][i]) for i in (0, 2)]
    x, z = truth.pose.x + away * ray[0], truth.pose.z + away * ray[1]
    near = (away < 2.5) & (np.abs(x) < 1.5)
    cells: dict[tuple[int, int], list[bool]] = {}
    for right, ahead, lost in zip(x[near], z[near], truth.depth[near] == 0, strict=True):
        cells.setdefault((int(right * 10 // 1), int(ahead * 10 // 1)), []).append(bool(lost))
    return {cell: bool(np.mean(lost) > 0.5) for cell, lost in cells.items() if len(lost) > 5}


def test_blotches_of_a_shiny_floor_stay_where_they_are_while_the_robot_moves() -> None:
    drive = standing(Room(5.0, 9.0, 2.7), mirror_floor=0.9)
    drive = replace(drive, mount=replace(LEVEL, pitch=0.6))
    environment = replace(drive.scenario.environment, camera_path=((0.0, 0.2, 1.3, 0.3), (10.0, 0.2, 1.3, 0.3)))
    one = holes_in_floor(drive)
    other = holes_in_floor(replace(drive, scenario=replace(drive.scenario, environment=environment)))
    shared = [(one[cell], other[cell]) for cell in one.keys() & other.keys()]
    assert len(shared) > 100
    assert 0.1 < np.mean([first for first, _ in shared]) < 0.5
    assert np.mean([first == second for first, second in shared]) > 0.85


def test_flying_pixels_are_in_between_and_as_many_as_said() -> None:
    depth = np.full((120, 160), 4.0, dtype=np.float32)
    depth[:, 80:] = 2.0
    noise = FlightNoise(depth.shape, 131.25, 7)
    seen, labels = noise.apply(depth, np.zeros(depth.shape, dtype=np.uint8), 3)
    assert labels is not None
    edge = np.zeros(depth.shape, dtype=bool)
    edge[:, 79:81] = True
    flying = (seen > 2100) & (seen < 3900)
    assert not (flying & ~edge).any()
    assert np.count_nonzero(flying) / np.count_nonzero(edge) == pytest.approx(0.95 * FLYING_SHARE, abs=0.1)
    assert np.std(seen[:, :70].astype(float)) < 20


def test_turning_mixes_depths_at_edges_only_and_keeps_the_nearer_label() -> None:
    depth = np.full((40, 160), 4.0, dtype=np.float32)
    labels = np.zeros(depth.shape, dtype=np.uint8)
    depth[:, 80:], labels[:, 80:] = 2.0, 1
    same, _ = blur(depth, labels, 0.6, 1, 2)
    assert np.array_equal(same, depth)
    mixed, marks = blur(depth, labels, 6.0, 1, 2)
    changed: Mask = mixed != depth
    assert changed[:, 77:83].mean() > 0.9
    assert not changed[:, :77].any()
    assert not changed[:, 83:].any()
    assert ((mixed >= 2.0) & (mixed <= 4.0)).all()
    assert (marks[:, 77:83] == 1).all()


def test_a_turning_robot_blurs_and_a_standing_one_does_not() -> None:
    drive = small(draw_drive(5, "turn", judging=False))
    sharp, blurred = (
        np.stack([DriveRenderer(replace(drive, exposure_s=s)).truth(index).depth for index in (10, 15, 20, 25)])
        for s in (0.0, 0.08)
    )
    assert np.count_nonzero(sharp != blurred) > 100
    still = small(draw_drive(5, "straight", judging=False))
    sharp, same = (DriveRenderer(replace(still, exposure_s=s)).truth(20).depth for s in (0.0, 0.05))
    assert np.array_equal(sharp, same)


def test_one_who_stands_still_moves_in_the_picture_as_the_robot_does() -> None:
    room = Room(5.0, 12.0, 2.7)
    track = tuple((t / 5, 0.0, 1.0, math.radians(2.0 * t)) for t in range(51))
    drive = standing(room, ANN)
    turning = replace(
        drive, scenario=replace(drive.scenario, environment=replace(drive.scenario.environment, camera_path=track))
    )
    renderer = DriveRenderer(turning)
    for index in (0, 5, 10):
        columns = np.nonzero(renderer.truth(index).labels == 1)[1]
        bearing = math.atan2(0.7, 3.0) - math.radians(2.0 * index)
        assert columns.mean() == pytest.approx(79.5 + 131.25 * math.tan(bearing), abs=3.5)

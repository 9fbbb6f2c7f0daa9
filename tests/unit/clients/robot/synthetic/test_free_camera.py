"""A camera anywhere and at any angle: ground, walls, boxes and people are where rays and rigid motion put them."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clients.robot.synthetic.body import Capsules, place_rows
from clients.robot.synthetic.camera import Camera, CameraPose, Image, Labels, draw
from clients.robot.synthetic.driving.room import Ground
from clients.robot.synthetic.driving.solids import Box, Faces, box_between, draw_faces, place_boxes, reflected
from clients.robot.synthetic.scenes import draw_scene

Floats = npt.NDArray[np.float64]
SCENE = replace(draw_scene(1, "single"), width=160, height=120, focal_px=131.25)
POSES = (
    CameraPose(0.0, 0.0, 1.2, 0.0, 0.15, 0.0),
    CameraPose(-0.7, 2.0, 1.0, 0.6, -0.03, 0.02),
    CameraPose(0.4, 5.0, 1.35, -2.4, 0.2, -0.05),
)
FAR_M = 20.0


def rays(camera: Camera, pose: CameraPose) -> tuple[Floats, Floats, Floats]:
    """Return (right, up, ahead) in the world of each pixel's ray, by turning it back step by step."""
    x, y = np.broadcast_arrays(camera.ray_x.astype(np.float64), camera.ray_y.astype(np.float64))
    right, down = x * math.cos(pose.roll) - y * math.sin(pose.roll), x * math.sin(pose.roll) + y * math.cos(pose.roll)
    fall = down * math.cos(pose.pitch) + math.sin(pose.pitch)
    ahead = math.cos(pose.pitch) - down * math.sin(pose.pitch)
    world_x = right * math.cos(pose.yaw) + ahead * math.sin(pose.yaw)
    return world_x, -fall, ahead * math.cos(pose.yaw) - right * math.sin(pose.yaw)


def camera_at(pose: CameraPose) -> Camera:
    camera = Camera(SCENE)
    camera.move(pose)
    return camera


def seen_faces(camera: Camera, faces: Faces) -> tuple[Image, Labels]:
    nearness = np.full(camera.shape, 1 / FAR_M, dtype=np.float32)
    labels = np.zeros(camera.shape, dtype=np.uint8)
    draw_faces(camera, nearness, labels, faces)
    return np.float32(1) / nearness, labels


def seen_bodies(camera: Camera, capsules: Capsules) -> tuple[Image, Labels]:
    depth, labels = np.full(camera.shape, FAR_M, dtype=np.float32), np.zeros(camera.shape, dtype=np.uint8)
    draw(camera, depth, labels, capsules, 1)
    return depth, labels


@pytest.mark.parametrize("pose", POSES)
def test_the_ground_is_as_deep_as_rays_to_it_are_long(pose: CameraPose) -> None:
    camera = camera_at(pose)
    _, up, _ = rays(camera, pose)
    below = up < -1e-3
    expected = np.where(below, pose.height_m / np.where(below, -up, 1), np.inf)
    for depth in (camera.ground(), seen_faces(camera, Ground().faces())[0]):
        near = expected < 0.9 * FAR_M
        assert near.any()
        assert np.allclose(depth[near], expected[near], rtol=1e-4)
        assert (depth[~below] >= FAR_M - 1e-3).all()


@pytest.mark.parametrize("pose", POSES)
def test_walls_are_as_deep_as_rays_to_them_are_long(pose: CameraPose) -> None:
    camera = camera_at(pose)
    side = math.copysign(1.5, pose.yaw)
    low, high = sorted((side, 1.1 * side))
    wall = place_boxes([box_between((low, high), (-9.0, 9.0), (-30.0, 30.0))])
    depth, _ = seen_faces(camera, wall)
    x, _, _ = rays(camera, pose)
    expected = (side - pose.x) / np.where(x * side > 1e-3, x, np.nan)
    near = np.isfinite(expected) & (expected < 8)
    assert near.any()
    assert np.allclose(depth[near], expected[near], rtol=1e-4)
    assert (depth[~np.isfinite(expected)] >= FAR_M - 1e-3).all()


ANGLES = st.floats(-math.pi, math.pi)
CAMERAS = st.builds(
    CameraPose,
    st.floats(-2, 2),
    st.floats(-2, 2),
    st.floats(0.6, 1.6),
    ANGLES,
    st.floats(-0.3, 0.5),
    st.floats(-0.3, 0.3),
)


MOTIONS = st.tuples(*[st.floats(-0.4, 0.4)] * 3, *[st.floats(-0.15, 0.15)] * 3)


@given(CAMERAS, MOTIONS, st.floats(1.5, 6.0), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2))
def test_a_moved_camera_sees_a_point_where_rigid_motion_says(
    first: CameraPose, motion: tuple[float, ...], away: float, right: float, down: float
) -> None:
    """A point is put before the camera by hand, and seen again after a motion."""
    second = CameraPose(*(at + moved for at, moved in zip(astuple(first), motion, strict=True)))
    x, y, z = first.axes().T @ (away * np.array([right, down, 1.0]))
    point = np.array([[first.x + x, first.height_m + y, first.z + z]])
    assert np.allclose(camera_at(first).seen(point)[0], away * np.array([right, down, 1.0]), atol=1e-4)
    camera = camera_at(second)
    turned = second.axes() @ (point[0] - np.array([second.x, second.height_m, second.z]))
    assert np.allclose(camera.seen(point)[0], turned, atol=1e-4)
    assert math.isclose(
        np.linalg.norm(turned), math.dist(point[0], (second.x, second.height_m, second.z)), abs_tol=1e-6
    )
    column, row = turned[:2] / max(turned[2], 1e-3) * float(camera.focal) + np.array(camera.centre, dtype=float)
    assume(turned[2] > 0.6 and 3 < column < 156 and 3 < row < 116)
    ball = point.astype(np.float32)
    depth, labels = seen_bodies(camera, Capsules(ball, ball, np.array([0.02 * turned[2]], dtype=np.float32)))
    rows, columns = np.nonzero(labels)
    assert abs(columns.mean() - column) < 0.7
    assert abs(rows.mean() - row) < 0.7
    assert depth.min() == pytest.approx(turned[2], rel=0.04)


@given(
    CAMERAS,
    st.tuples(st.floats(0.8, 5.0), st.floats(-0.6, 0.6), ANGLES),
    st.tuples(*[st.floats(0.05, 1.5)] * 3),
    st.floats(-1, 1),
)
def test_boxes_are_where_rays_meet_them(
    pose: CameraPose, seen: tuple[float, float, float], size: tuple[float, float, float], turned: float
) -> None:
    away, bearing, heading = seen
    place = (pose.x + away * math.sin(pose.yaw + bearing), pose.z + away * math.cos(pose.yaw + bearing), heading)
    camera = camera_at(pose)
    box: Box = (0.1, size[1] / 2, 0.0, *size, turned)
    depth, labels = seen_faces(camera, place_boxes([box], *place, label=7))
    expected = _slab(rays(camera, pose), pose, box, place)
    assume(expected is not None)
    assert expected is not None
    hit = (expected > 0.05) & (expected < 0.95 * FAR_M)
    both = hit & (labels == 7)
    edge = 4 + sum(int(np.count_nonzero(hit ^ np.roll(hit, 1, axis))) for axis in (0, 1))
    assert np.count_nonzero(hit != (labels == 7)) <= 0.2 * edge
    wrong = np.abs(depth[both] / expected[both] - 1) > 1e-3
    assert np.count_nonzero(wrong) <= 0.2 * edge


def _slab(
    ray: tuple[Floats, Floats, Floats], pose: CameraPose, box: Box, place: tuple[float, float, float]
) -> Floats | None:
    """Return the depth at which rays enter a box by clipping them at its three pairs of sides; None from inside."""
    x, z, heading = place
    size = (box[3], box[4], box[5])
    cos, sin, own_cos, own_sin = math.cos(heading), math.sin(heading), math.cos(box[6]), math.sin(box[6])

    def local(dx: Floats, up: Floats, dz: Floats) -> tuple[Floats, Floats, Floats]:
        return dx * cos + dz * sin, up, dx * sin - dz * cos

    def unturned(right: Floats, up: Floats, ahead: Floats) -> tuple[Floats, Floats, Floats]:
        return right * own_cos - ahead * own_sin, up, ahead * own_cos + right * own_sin

    eye = local(np.array(pose.x - x), np.array(pose.height_m), np.array(pose.z - z))
    eye = unturned(eye[0] - box[0], eye[1] - box[1], eye[2] - box[2])
    if all(abs(float(at)) < half / 2 + 0.02 for at, half in zip(eye, size, strict=True)):
        return None
    enter, leave = np.full(ray[0].shape, -np.inf), np.full(ray[0].shape, np.inf)
    for at, towards, length in zip(eye, unturned(*local(*ray)), size, strict=True):
        safe = np.where(np.abs(towards) < 1e-9, 1e-9, towards)
        one, two = (-length / 2 - at) / safe, (length / 2 - at) / safe
        enter, leave = np.maximum(enter, np.minimum(one, two)), np.minimum(leave, np.maximum(one, two))
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def test_a_level_camera_sees_the_same_whether_moved_or_set() -> None:
    body = place_rows([(0.1, 0.2, 0.0, -0.1, 1.6, 0.2, 0.1)], 0.3, 2.5, 0.7)
    level = Camera(SCENE)
    level.at = (0.2, -0.3, 0.25)
    depth, labels = seen_bodies(level, body)
    moved = camera_at(CameraPose(0.2, -0.3, level.height_m, 0.25))
    depth_moved, labels_moved = seen_bodies(moved, body)
    assert np.array_equal(labels, labels_moved)
    assert np.allclose(depth, depth_moved, atol=1e-4)
    assert np.allclose(level.ground(), moved.ground(), rtol=1e-4)


def test_a_rail_that_begins_beside_the_camera_is_still_seen_ahead() -> None:
    pose = CameraPose(0.0, 0.0, 1.2, 0.0, 0.1)
    rail = place_rows([(0.5, 0.9, 1.0, 0.5, 0.9, -4.0, 0.04)], 0.0, 0.0, 0.0)
    depth, labels = seen_bodies(camera_at(pose), rail)
    assert labels.any()
    x, _, _ = rays(camera_at(pose), pose)
    shown = labels > 0
    assert np.allclose((depth * x)[shown], 0.5, atol=0.05)
    assert depth[shown].max() == pytest.approx(4.0, abs=0.1)
    assert depth[shown].min() < 1.2


def test_a_mirror_image_is_as_far_behind_as_the_thing_is_before() -> None:
    normal = np.array([0.6, 0.0, 0.8])
    points = np.array([[1.0, 2.0, 3.0], [0.0, 1.0, 0.0]])
    at = np.array([0.5, 0.0, 0.5])
    images = reflected(points, at, normal)
    assert np.allclose((images - at) @ normal, -((points - at) @ normal))
    assert np.allclose(reflected(images, at, normal), points)

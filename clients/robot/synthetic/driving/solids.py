"""Boxes and flat faces at any angle, and how a camera sees them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clients.robot.synthetic.camera import Camera, Image, Labels

Floats = npt.NDArray[np.float64]
Box = tuple[float, float, float, float, float, float, float]
"""Centre (right, up, ahead), size in the same order, and turn in radians, in its owner's coordinates; metres."""

EDGE_ON = 1e-9
_CORNERS = np.array([[r, u, a] for r in (-0.5, 0.5) for u in (-0.5, 0.5) for a in (-0.5, 0.5)])
_SIDES = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """Convex faces of four corners (n, 4, 3: right, up, ahead), a point behind each (n, 3) and its label (n,)."""

    corners: Floats
    backs: Floats
    labels: Labels


def box_between(x: tuple[float, float], up: tuple[float, float], z: tuple[float, float]) -> Box:
    """Return a box that lies along the axes of the world, for `place_boxes` at the origin."""
    return (sum(x) / 2, sum(up) / 2, -sum(z) / 2, x[1] - x[0], up[1] - up[0], z[1] - z[0], 0.0)


def place_boxes(
    boxes: Sequence[Box], x: float = 0.0, z: float = 0.0, heading: float = 0.0, up_m: float = 0.0, label: int = 0
) -> Faces:
    """Return the faces of boxes of something that stands at a place and looks along `heading` (0: against z)."""
    table = np.array(boxes, dtype=np.float64).reshape(-1, 7)
    offsets = _CORNERS[None] * table[:, None, 3:6]
    local = table[:, None, :3] + _turned(offsets, table[:, 6, None])
    cos, sin = math.cos(heading), math.sin(heading)
    right, up, ahead = local[..., 0], local[..., 1] + up_m, local[..., 2]
    world = np.stack([x + right * cos + ahead * sin, up, z + right * sin - ahead * cos], axis=-1)
    corners = world[:, _SIDES].reshape(-1, 4, 3)
    backs = np.repeat(world.mean(axis=1), len(_SIDES), axis=0)
    return Faces(corners, backs, np.full(len(corners), label, dtype=np.uint8))


def _turned(points: Floats, angle: Floats) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    right, ahead = points[..., 0], points[..., 2]
    return np.stack([right * cos + ahead * sin, points[..., 1], ahead * cos - right * sin], axis=-1)


def joined_faces(parts: Sequence[Faces]) -> Faces:
    return Faces(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.backs for part in parts]),
        np.concatenate([part.labels for part in parts]),
    )


def reflected(points: Floats, at: Floats, normal: Floats) -> Floats:
    """Return points (..., 3) mirrored in a plane."""
    return points - 2 * ((points - at) @ normal)[..., None] * normal


def draw_faces(camera: Camera, nearness: Image, labels: Labels, faces: Faces) -> None:
    """Draw faces that are seen from in front into `nearness` (1 / depth) and `labels`, where nearest. In place.

    1 / depth of a plane is linear in row and column, so each row of a face is one run of pixels.
    """
    corners, backs = camera.seen(faces.corners).astype(np.float64), camera.seen(faces.backs).astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    away = (normals * corners[:, 0]).sum(axis=1)
    kept = away * (normals * (backs - corners[:, 0])).sum(axis=1) > 0
    kept &= (np.abs(away) > EDGE_ON) & _in_view(camera, corners)
    corners, normals, away = corners[kept], normals[kept], away[kept]
    starts, stops = _runs(camera, corners)
    rays_x, rays_y = camera.ray_x[0].astype(np.float64), camera.ray_y[:, 0].astype(np.float64)
    columns = np.arange(camera.shape[1], dtype=np.int32)
    for number, label in enumerate(faces.labels[kept]):
        rows = np.flatnonzero(starts[number] < stops[number])
        if not len(rows):
            continue
        top, bottom = int(rows[0]), int(rows[-1]) + 1
        start, stop = starts[number, top:bottom, None], stops[number, top:bottom, None]
        left, right = int(start.min()), int(stop.max())
        x, y, z = normals[number] / away[number]
        by_row = (y * rays_y[top:bottom] + z).astype(np.float32)
        by_column = (x * rays_x[left:right]).astype(np.float32)
        piece = by_row[:, None] + by_column[None]
        box = (slice(top, bottom), slice(left, right))
        nearer = piece > nearness[box]
        if int(start.max()) > left or int(stop.min()) < right:
            nearer &= columns[left:right] >= start
            nearer &= columns[left:right] < stop
        np.copyto(nearness[box], piece, where=nearer)
        np.copyto(labels[box], label, where=nearer)


def _in_view(camera: Camera, corners: Floats) -> npt.NDArray[np.bool_]:
    """Those that are not wholly beyond one side of the picture."""
    right, down, ahead = corners[..., 0], corners[..., 1], corners[..., 2]
    wide, high = float(camera.ray_x.max()), float(camera.ray_y.max())
    beyond = (right > wide * ahead, right < -wide * ahead, down > high * ahead, down < -high * ahead)
    seen = np.ones(len(corners), dtype=bool)
    for side in beyond:
        seen &= ~side.all(axis=1)
    return seen


def _runs(camera: Camera, corners: Floats) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return the first column of each face in each row, and the one behind its last; first = width where there is none.

    By the planes through the lens and a face's edges, which needs no clipping of corners behind the camera.
    """
    width = camera.shape[1]
    edges = np.cross(corners, np.roll(corners, -1, axis=1))
    edges *= np.sign((edges * corners.mean(axis=1)[:, None]).sum(axis=2))[..., None]
    slope = edges[..., 0, None]
    slope = np.where(np.abs(slope) < EDGE_ON, EDGE_ON, slope)
    rest = edges[..., 1, None] * camera.ray_y[:, 0].astype(np.float64) + edges[..., 2, None]
    limit = -rest / slope
    low = np.where(slope > 0, limit, -np.inf).max(axis=1)
    high = np.where(slope < 0, limit, np.inf).min(axis=1)
    focal, centre = float(camera.focal), float(camera.centre[0])
    start = np.ceil(np.clip(low * focal + centre, 0, width)).astype(np.int32)
    stop = np.floor(np.clip(high * focal + centre, -1, width - 1)).astype(np.int32) + 1
    none = start >= stop
    return np.where(none, np.int32(width), start), np.where(none, np.int32(0), stop)

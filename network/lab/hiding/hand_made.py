"""Attacks without learning: difference, holes, edges, bite in the outline, outline itself.

One of them includes the owner's outline, since another person may be inside it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.sensing.sensor_events import Mask
from network.lab.hiding.scenes import View

DIFFERENCE_MIN_MM = 70.0
DIFFERENCE_SHARE = 0.035
EDGE_MIN_MM = 60.0
PIECE_MIN_PX = 60
OWNER_MARGIN_PX = 2

_OPEN = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3)), dtype=np.uint8)
_CLOSE = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7)), dtype=np.uint8)


def by_difference(view: View) -> Mask:
    depth, empty = view.picture.astype(np.float32), view.empty.astype(np.float32)
    near = (depth > 0) & (empty - depth > np.maximum(DIFFERENCE_MIN_MM, DIFFERENCE_SHARE * empty))
    return _solid(near & ~_around(view.owner))


def by_holes(view: View) -> Mask:
    holes = (view.picture == 0) & (view.empty > 0) & ~_around(view.owner)
    return _solid(_morph(holes, cv2.MORPH_CLOSE, _CLOSE))


def by_edges(view: View) -> Mask:
    shown, before = steepness(view.picture), steepness(view.empty)
    edges = (shown > EDGE_MIN_MM) & (shown > 2 * before) & ~_around(view.owner)
    return _filled(_morph(edges, cv2.MORPH_CLOSE, _CLOSE))


def by_bite(view: View) -> Mask:
    if not view.owner.any():
        return np.zeros(view.owner.shape, dtype=bool)
    return largest(_morph((hull_of(view.owner) > 0) & ~view.owner, cv2.MORPH_OPEN, _OPEN))


def by_outline(view: View) -> Mask:
    return view.owner.copy()


Attack = Callable[[View], Mask]
HAND_MADE: Final[dict[str, Attack]] = {
    "difference": by_difference,
    "holes": by_holes,
    "edges": by_edges,
    "bite": by_bite,
    "outline": by_outline,
}


def _around(owner: Mask) -> Mask:
    size = 2 * OWNER_MARGIN_PX + 1
    return np.asarray(cv2.dilate(owner.astype(np.uint8), np.ones((size, size), np.uint8))) > 0


def _morph(mask: Mask, how: int, kernel: npt.NDArray[np.uint8]) -> Mask:
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), how, kernel)) > 0


def _solid(mask: Mask) -> Mask:
    return _pieces(_morph(mask, cv2.MORPH_OPEN, _OPEN))


def _pieces(mask: Mask) -> Mask:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    large = np.asarray(stats)[:, cv2.CC_STAT_AREA] >= PIECE_MIN_PX
    large[0] = False
    return np.asarray(large[np.asarray(labels)], dtype=bool)


def hull_of(owner: Mask) -> npt.NDArray[np.uint8]:
    """1 within the convex hull of a mask that is not empty."""
    hull = np.zeros(owner.shape, dtype=np.uint8)
    points = cv2.findNonZero(owner.astype(np.uint8))
    cv2.fillConvexPoly(hull, np.asarray(cv2.convexHull(points), dtype=np.int32), 1)
    return hull


def largest(mask: Mask) -> Mask:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    if count < 2:
        return np.zeros(mask.shape, dtype=bool)
    best = 1 + int(np.argmax(np.asarray(stats)[1:, cv2.CC_STAT_AREA]))
    return np.asarray(np.asarray(labels) == best, dtype=bool)


def _filled(edges: Mask) -> Mask:
    outlines, _ = cv2.findContours(edges.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(edges.shape, dtype=np.uint8)
    for outline in outlines:
        if cv2.contourArea(outline) >= PIECE_MIN_PX:
            cv2.drawContours(filled, [outline], -1, 1, thickness=cv2.FILLED)
    return filled > 0


def steepness(depth: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    smooth = np.asarray(cv2.medianBlur(depth, 5))
    steep = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    return np.asarray(steep, dtype=np.float32)

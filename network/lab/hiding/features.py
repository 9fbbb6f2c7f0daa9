"""Per-pixel features for learned attackers: picture, surroundings, owner's outline."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from network.lab.hiding.hand_made import hull_of, steepness
from network.lab.hiding.scenes import View

Floats = npt.NDArray[np.float32]

NAMES = (
    "difference",
    "depth",
    "empty",
    "hole",
    "difference_5",
    "difference_15",
    "difference_41",
    "rough_7",
    "rough_against_empty",
    "holes_5",
    "holes_21",
    "steep",
    "owner",
    "owner_distance",
    "owner_9",
    "owner_31",
    "owner_depth",
    "x",
    "y",
    "from_owner_x",
    "from_owner_y",
    "row_left",
    "row_right",
    "mirrored",
    "hull",
    "nearest_owner_depth",
)


def features(view: View) -> Floats:
    """Shape (height, width, len(NAMES))."""
    depth, empty = _metres(view.picture), _metres(view.empty)
    hole = (view.picture == 0).astype(np.float32)
    known = (1 - hole) * (view.empty > 0)
    difference = (empty - depth) * known
    parts = [difference, depth, empty, hole]
    parts += [_mean(difference, known, size) for size in (5, 15, 41)]
    rough = _roughness(difference, known)
    parts += [rough, rough / (0.002 + 0.002 * empty * empty)]
    parts += [_box(hole, 5), _box(hole, 21), _metres(steepness(view.picture))]
    parts += _of_owner(view, depth)
    return np.stack(parts, axis=-1).astype(np.float32, copy=False)


def _of_owner(view: View, depth: Floats) -> list[Floats]:
    height, width = depth.shape
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    owner = view.owner.astype(np.uint8)
    share = owner.astype(np.float32)
    if not owner.any():
        flat = np.full(depth.shape, -1, dtype=np.float32)
        return [share, flat, share, share, flat, xs, ys, flat, flat, flat, flat, share, share, flat]
    outside = np.asarray(cv2.distanceTransform(1 - owner, cv2.DIST_L2, 5), dtype=np.float32)
    inside = np.asarray(cv2.distanceTransform(owner, cv2.DIST_L2, 5), dtype=np.float32)
    rows, columns = np.nonzero(owner)
    own_depth = float(np.median(depth[view.owner]))
    middle_x, tall = float(np.median(columns)), float(rows.max() - rows.min() + 1)
    left, right = _row_ends(view.owner)
    mirrored = _mirrored(share, middle_x)
    around = _mean(depth * share, share, 31)
    return [
        share,
        outside - inside,
        _box(share, 9),
        _box(share, 31),
        np.full(depth.shape, own_depth, dtype=np.float32),
        xs,
        ys,
        (xs - middle_x) / tall,
        (ys - float(rows.min())) / tall,
        (xs - left[:, None]) / tall,
        (right[:, None] - xs) / tall,
        mirrored - share,
        hull_of(view.owner).astype(np.float32) - share,
        around,
    ]


def _row_ends(owner: npt.NDArray[np.bool_]) -> tuple[Floats, Floats]:
    some = owner.any(axis=1)
    left = owner.argmax(axis=1).astype(np.float32)
    right = (owner.shape[1] - 1 - owner[:, ::-1].argmax(axis=1)).astype(np.float32)
    columns = np.flatnonzero(owner.any(axis=0))
    left[~some] = right[~some] = float(columns.mean())
    return left, right


def _mirrored(share: Floats, middle_x: float) -> Floats:
    columns = np.rint(2 * middle_x - np.arange(share.shape[1])).astype(np.int64)
    valid = (columns >= 0) & (columns < share.shape[1])
    turned = np.zeros_like(share)
    turned[:, valid] = share[:, columns[valid]]
    return turned


def _box(image: Floats, size: int) -> Floats:
    return np.asarray(cv2.blur(image, (size, size)), dtype=np.float32)


def _mean(image: Floats, weight: Floats, size: int) -> Floats:
    return np.asarray(_box(image * weight, size) / np.maximum(_box(weight, size), np.float32(1e-3)), dtype=np.float32)


def _roughness(difference: Floats, known: Floats) -> Floats:
    mean = _mean(difference, known, 7)
    square = _mean(difference * difference, known, 7)
    return np.sqrt(np.maximum(square - mean * mean, 0))


def _metres(depth: npt.NDArray[np.uint16] | Floats) -> Floats:
    return np.asarray(depth, dtype=np.float32) * np.float32(0.001)

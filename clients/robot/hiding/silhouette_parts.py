"""Cuts a silhouette at its steps of depth: somebody hidden right behind shows as slivers, or as a hand before."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.sensing.sensor_events import Depth, Mask

STEP_MIN_M, STEP_PER_M2 = 0.07, 0.012  # a larger step of depth between neighbours separates parts; noise grows so
PART_MIN_PX, PART_MIN_SHARE = 4, 0.002
HEADS_M = 0.35  # below the top
FARTHEST_SHARE = 0.98  # of the largest part's pixels are as near; the others may be stray
BEHIND_MIN_MM = 100  # what is so far behind a person's largest part may be of somebody else

PART_CUES = (
    "parts_count",
    "behind_share",
    "before_share",
    "behind_head_share",
    "behind_area_m2",
    "behind_gap_m",
    "behind_aside_m",
    "behind_lower_m",
    "behind_height_m",
    "before_area_m2",
    "before_gap_m",
    "before_lower_m",
    "before_width_m",
)


def measure_parts(inside: Mask, depth: Depth, focal_px: float) -> list[float]:
    """Return PART_CUES of a non-empty silhouette; zeros where it is one part."""
    z = depth.astype(np.float32) / np.float32(1000)
    total = int(np.count_nonzero(inside))
    middle = float(np.median(z[inside]))
    pixel = middle / focal_px
    count, labels, boxes, centres = cv2.connectedComponentsWithStats(_cut_at_steps(inside, z, middle), connectivity=4)
    if count < 3:  # the rest, and one part at most
        return [0.0] * len(PART_CUES)
    sizes = boxes[:, cv2.CC_STAT_AREA].astype(np.float64)
    sizes[0] = 0.0
    away = np.bincount(labels.ravel(), weights=z.ravel(), minlength=count) / np.maximum(sizes, 1.0)
    largest = int(sizes.argmax())
    gaps = away - away[largest]
    is_part = sizes >= max(PART_MIN_PX, PART_MIN_SHARE * total)
    is_part[largest] = False
    behind, before = is_part & (gaps > 0), is_part & (gaps < 0)
    heads = labels[: max(1, round(HEADS_M / pixel))]
    in_heads = np.bincount(heads.ravel(), minlength=count)
    cues = [
        float(np.count_nonzero(is_part)),
        float(sizes[behind].sum()) / total,
        float(sizes[before].sum()) / total,
        float(in_heads[behind].sum()) / max(1, int(in_heads[1:].sum())),
    ]
    one = int(np.where(behind, sizes, 0.0).argmax())
    aside_px = abs(float(centres[one, 0] - centres[largest, 0]))
    lower_px, tall_px = boxes[one, cv2.CC_STAT_TOP], boxes[one, cv2.CC_STAT_HEIGHT]
    shape = (sizes[one] * pixel**2, gaps[one], aside_px * pixel, lower_px * pixel, tall_px * pixel)
    cues += shape if one else (0.0,) * 5
    one = int(np.where(before, sizes, 0.0).argmax())
    lower_px, wide_px = boxes[one, cv2.CC_STAT_TOP], boxes[one, cv2.CC_STAT_WIDTH]
    cues += (sizes[one] * pixel**2, -gaps[one], lower_px * pixel, wide_px * pixel) if one else (0.0,) * 4
    return [float(cue) for cue in cues]


def shows_head_behind(inside: Mask, depth: Depth, focal_px: float) -> bool:
    """Tell whether beside the head of a non-empty silhouette something is seen that lies behind all of the person."""
    pixel = float(np.median(depth[inside])) / 1000 / focal_px
    heads = slice(0, max(1, round(HEADS_M / pixel)))
    return int(np.count_nonzero(inside[heads] & (depth[heads] > find_behind_mm(inside, depth)))) >= PART_MIN_PX


def find_behind_mm(inside: Mask, depth: Depth) -> int:
    """Return how far away what is not of the largest part of a non-empty silhouette, but behind it, begins."""
    z = depth.astype(np.float32) / np.float32(1000)
    joined = _cut_at_steps(inside, z, float(np.median(z[inside])))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(joined, connectivity=4)
    largest = labels == 1 + int(boxes[1:, cv2.CC_STAT_AREA].argmax()) if len(boxes) > 1 else inside
    return int(np.quantile(depth[largest], FARTHEST_SHARE)) + BEHIND_MIN_MM


def _cut_at_steps(inside: Mask, z: npt.NDArray[np.float32], middle_m: float) -> npt.NDArray[np.uint8]:
    joined = inside.astype(np.uint8)
    joined[_nearer_side_of_steps(inside, z, max(STEP_MIN_M, STEP_PER_M2 * middle_m**2))] = 0
    return joined


def _nearer_side_of_steps(inside: Mask, z: npt.NDArray[np.float32], step_m: float) -> Mask:
    """Only the nearer side is taken away, so that slivers stay."""
    edge = np.zeros_like(inside)
    for one, next_one in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step = np.where(inside[one] & inside[next_one], z[next_one] - z[one], np.float32(0))
        edge[one] |= step > step_m
        edge[next_one] |= step < -step_m
    return edge

"""Finds and judges half-resolution silhouettes; ambiguity is merged, contact or occluded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.background import Background
from clients.robot.hiding.companion import CUES, Floats, measure, shipped_model
from clients.robot.hiding.withhold_reason import MergedBy, MergedEvidence
from clients.robot.sensing.sensor_events import Depth

Bytes2D = npt.NDArray[np.uint8]
Labels = npt.NDArray[np.int32]

MEASURED_MIN_MM, MEASURED_MAX_MM = 1, 65_535
EMPTY_MAX_PX = 120  # half-resolution foreground pixels below which nobody is there
PIECE_MIN_PX = 14
PIECES_MAX_COUNT = 256  # the largest; whatever else is there is near nobody, or keeps them from being shown
DEPTH_EDGE_MM = 260
PIECE_GAP_M, PIECE_DEPTH_M = 0.14, 0.45
AID_AREA_MAX_M2, AID_TOP_SHARE, AID_GAP_M, AID_AHEAD_M = 0.17, 0.40, 0.12, 0.85
ALONE_M = 1.2
PERSON_AREA_MIN_M2, PERSON_HEIGHT_MIN_M = 0.12, 0.55
TOUCH_HALF_PX = 4  # 8 px of the full frame
TOUCH_MIN_PX = 4
CRUMBS_MIN_PX = 60  # crumbs smaller than a piece, the spokes of a wheel, say, touch only if there are many
BEHIND_MM = 350
GROUP_AREA_MIN_M2 = 1.3  # no one person is that large, whatever the model says
LEARNED_MAX_M, FAR_AREA_MAX_M2, FAR_BREADTH_MAX_M = 7.0, 1.05, 0.78
BODY_OFFSET_M = 0.10  # from the skin that the camera sees to the middle of the body

_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_TOUCH = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * TOUCH_HALF_PX + 1, 2 * TOUCH_HALF_PX + 1))


@dataclass(frozen=True, slots=True, eq=False)
class Silhouette:
    """One person-sized blob, by `label` in the label image. `x_m`, `z_m`: its place in plan, before the camera or in the
    odometry's frame; `ahead_m`, `right_m`: how far along the camera's axis, and to the right of it.

    `withhold_reason`: why it is not cut (`merged`, `contact`, `occluded`), or empty. `companion_odds`: log-odds of several
    people; `company`: evidence.
    """

    label: int
    box: tuple[int, int, int, int]  # x, y, width, height in half-resolution pixels
    x_m: float
    z_m: float
    range_m: float
    median_mm: int
    withhold_reason: str
    companion_odds: float = 0.0
    company: MergedEvidence | None = None
    ahead_m: float = field(kw_only=True)
    right_m: float = field(kw_only=True)

    @property
    def bearing_deg(self) -> float:
        return math.degrees(math.atan2(self.right_m, self.ahead_m))


@dataclass(frozen=True, slots=True, eq=False)
class Segmented:
    """Silhouettes; label image 0: background, -1: other foreground."""

    silhouettes: tuple[Silhouette, ...]
    labels: Labels | None


@dataclass(slots=True)
class _Piece:
    labels: list[int]
    left: float
    right: float
    top: float  # metres below the camera
    bottom: float
    z_m: float
    pixels: int


def segment(depth: Depth, background: Background, focal_px: float) -> Segmented:
    half = np.ascontiguousarray(depth[::2, ::2])
    foreground = foreground_of(half, background.half_depth, background.half_threshold)
    foreground = np.asarray(cv2.morphologyEx(foreground, cv2.MORPH_OPEN, _CROSS), dtype=np.uint8)
    if cv2.countNonZero(foreground) < EMPTY_MAX_PX:
        return Segmented((), None)
    _cut_at_edges(foreground, half)
    count, raw, stats, _ = cv2.connectedComponentsWithStats(foreground, connectivity=4, ltype=cv2.CV_32S)
    pieces = _pieces(half, np.asarray(raw, dtype=np.int32), np.asarray(stats), count, focal_px / 2)
    lookup = np.full(count, -1, dtype=np.int32)
    lookup[0] = 0
    for number, piece in enumerate(pieces, start=1):
        lookup[piece.labels] = number
    labels = lookup[np.asarray(raw)]
    found = []
    for number in range(1, len(pieces) + 1):
        silhouette = _measure(labels, half, number, focal_px / 2)
        if silhouette is not None:
            found.append(silhouette)
    return Segmented(tuple(found), labels)


def foreground_of(depth: Depth, background: Depth, threshold: Depth) -> Bytes2D:
    """Return 255 where nearer by over the threshold, else 0."""
    nearer = cv2.compare(cv2.subtract(background, depth), threshold, cv2.CMP_GT)
    return np.asarray(cv2.bitwise_and(nearer, cv2.inRange(depth, MEASURED_MIN_MM, MEASURED_MAX_MM)), dtype=np.uint8)


def _cut_at_edges(foreground: Bytes2D, half: Depth) -> None:
    """At depth jumps, in place."""
    signed = half.astype(np.int32)
    across = np.abs(np.diff(signed, axis=1)) > DEPTH_EDGE_MM
    down = np.abs(np.diff(signed, axis=0)) > DEPTH_EDGE_MM
    across &= (foreground[:, 1:] > 0) & (foreground[:, :-1] > 0)
    down &= (foreground[1:] > 0) & (foreground[:-1] > 0)
    for side in (foreground[:, 1:], foreground[:, :-1]):
        side[across] = 0
    for side in (foreground[1:], foreground[:-1]):
        side[down] = 0


def _pieces(half: Depth, raw: Labels, stats: npt.NDArray[np.int32], count: int, focal: float) -> list[_Piece]:
    middle, horizon = (half.shape[1] - 1) / 2, (half.shape[0] - 1) / 2
    pieces: list[_Piece] = []
    order = sorted(range(1, count), key=lambda number: -int(stats[number][cv2.CC_STAT_AREA]))
    for number in order[:PIECES_MAX_COUNT]:
        left, top, width, height, area = (int(v) for v in stats[number][:5])
        if area < PIECE_MIN_PX:
            break
        box = (slice(top, top + height), slice(left, left + width))
        z_m = float(np.median(half[box][raw[box] == number])) / 1000
        x0, x1 = (left - middle) * z_m / focal, (left + width - middle) * z_m / focal
        y0, y1 = (top - horizon) * z_m / focal, (top + height - horizon) * z_m / focal
        for piece in pieces:
            apart = max(x0 - piece.right, piece.left - x1)
            if abs(z_m - piece.z_m) < PIECE_DEPTH_M and apart < PIECE_GAP_M:
                piece.labels.append(number)
                piece.left, piece.right = min(piece.left, x0), max(piece.right, x1)
                piece.top, piece.bottom = min(piece.top, y0), max(piece.bottom, y1)
                piece.pixels += area
                break
        else:
            pieces.append(_Piece([number], x0, x1, y0, y1, z_m, area))
    return _with_aids(pieces, focal)


def _with_aids(pieces: list[_Piece], focal: float) -> list[_Piece]:
    """Join low small pieces just before a lone body to it (walking frame, knees); near two bodies they stay apart."""
    small = [_is_small(piece, focal) for piece in pieces]
    kept = []
    for piece, is_small in zip(pieces, small, strict=True):
        bodies = [other for other, tiny in zip(pieces, small, strict=True) if not tiny and _is_near(piece, other)]
        if is_small and len(bodies) == 1 and _is_before(piece, bodies[0]):
            bodies[0].labels += piece.labels
            bodies[0].pixels += piece.pixels
        else:
            kept.append(piece)
    return kept


def _is_small(piece: _Piece, focal: float) -> bool:
    return piece.pixels * (piece.z_m / focal) ** 2 < AID_AREA_MAX_M2


def _is_near(piece: _Piece, body: _Piece) -> bool:
    apart = max(piece.left - body.right, body.left - piece.right)
    return abs(piece.z_m - body.z_m) < ALONE_M and apart < ALONE_M


def _is_before(piece: _Piece, body: _Piece) -> bool:
    apart = max(piece.left - body.right, body.left - piece.right)
    low = piece.top > body.top + AID_TOP_SHARE * (body.bottom - body.top)
    return low and apart < AID_GAP_M and 0 < body.z_m - piece.z_m < AID_AHEAD_M


def _measure(labels: Labels, half: Depth, number: int, focal: float) -> Silhouette | None:
    mask = (labels == number).view(np.uint8)
    left, top, width, height = cv2.boundingRect(mask)
    box = (slice(top, top + height), slice(left, left + width))
    inside = mask[box] > 0
    values = half[box][inside]
    median = int(np.median(values))
    scale = median / 1000 / focal
    area, tall = values.size * scale * scale, height * scale
    if area < PERSON_AREA_MIN_M2 or tall < PERSON_HEIGHT_MIN_M:
        return None
    columns = np.flatnonzero(inside.any(axis=0))
    middle_px = left + float(np.mean(columns))
    x_m = (middle_px - (half.shape[1] - 1) / 2) * scale
    y_m = (top + 0.25 * height - (half.shape[0] - 1) / 2) * scale
    z_m = median / 1000 + BODY_OFFSET_M
    company = _judge_company(measure(inside, half[box], left, top, half.shape, focal))
    merged = company.log_odds > shipped_model().suspect
    withhold_reason = "merged" if merged else _touch(labels, half, mask, number, median)
    return Silhouette(
        label=number,
        box=(left, top, width, height),
        x_m=x_m,
        z_m=z_m,
        ahead_m=z_m,
        right_m=x_m,
        range_m=float(np.sqrt(x_m * x_m + y_m * y_m + z_m * z_m)),
        median_mm=median,
        withhold_reason=withhold_reason,
        companion_odds=company.log_odds,
        company=company,
    )


def _judge_company(cues: Floats) -> MergedEvidence:
    """Return log-odds of two people; size alone outside training."""
    model = shipped_model()
    area, breadth, distance = (float(cues[CUES.index(name)]) for name in ("area_m2", "width_3_m", "range_m"))
    if area > GROUP_AREA_MIN_M2:
        by, limit, odds = MergedBy.AREA, GROUP_AREA_MIN_M2, model.certain + 1
    elif distance <= LEARNED_MAX_M:
        by, limit, odds = MergedBy.SHAPE, model.suspect, model.log_odds(cues)
    elif area > FAR_AREA_MAX_M2:
        by, limit, odds = MergedBy.AREA, FAR_AREA_MAX_M2, model.certain + 1
    elif breadth > FAR_BREADTH_MAX_M:
        by, limit, odds = MergedBy.BREADTH, FAR_BREADTH_MAX_M, model.certain + 1
    else:
        by, limit, odds = MergedBy.SHAPE, model.suspect, model.suspect - 1
    return MergedEvidence(by, limit, odds, area, breadth, distance)


def _touch(labels: Labels, half: Depth, mask: Bytes2D, number: int, median: int) -> str:
    """Return `occluded`, `contact` or empty, for others within 8 px."""
    left, top, width, height = cv2.boundingRect(mask)
    top0, left0 = max(0, top - TOUCH_HALF_PX), max(0, left - TOUCH_HALF_PX)
    box = (slice(top0, top + height + TOUCH_HALF_PX), slice(left0, left + width + TOUCH_HALF_PX))
    around = labels[box]
    others = (around != 0) & (around != number)
    if not others.any():
        return ""
    near = others & (np.asarray(cv2.dilate(np.ascontiguousarray(mask[box]), _TOUCH)) > 0)
    if np.count_nonzero(near & (around < 0)) < CRUMBS_MIN_PX:
        near &= around > 0
    if np.count_nonzero(near) < TOUCH_MIN_PX:
        return ""
    theirs = half[box][near].astype(np.int32)
    if np.count_nonzero(theirs < median - BEHIND_MM) >= TOUCH_MIN_PX:
        return "occluded"
    return "contact" if np.count_nonzero(theirs < median + BEHIND_MM) >= TOUCH_MIN_PX else ""

"""Detects a companion within a silhouette, by shape and depth cues and decision trees.

Trained by `network.lab.hiding.companion_training` on synthetic scenes. It never decides identity, only that one blob
may be two people.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.silhouette_parts import PART_CUES, measure_parts
from clients.robot.sensing.sensor_events import Depth, Mask
from consensus.bounded_text import read_json_text

MODEL_FILE = "companion-model.json"
PIXELS_MAX_COUNT = 5_000  # larger silhouettes are looked at with every second pixel
BANDS_M = (0.0, 0.12, 0.26, 0.42, 0.62, 0.85, 1.15, 1.5)  # below the top of the silhouette
CELL_M = 0.06
CELLS_COUNT = 40
HEAD_BAND, CHEST_BANDS = 0, (2, 4)
EDGE_SHARE = 0.04

CUES = (
    "area_m2",
    "height_m",
    "width_m",
    "top_above_camera_m",
    "range_m",
    "fill_share",
    "cut_below",
    "cut_aside",
    *(f"width_{number}_m" for number in range(len(BANDS_M) - 1)),
    *(f"runs_{number}" for number in range(len(BANDS_M) - 1)),
    *(f"depth_{number}_m" for number in range(len(BANDS_M) - 1)),
    "saddle_m",
    "second_head_lower_m",
    "head_distance_m",
    "spread_m",
    "chest_spread_m",
    "head_spread_m",
    "halves_m",
    "footprint_m2",
    "chest_footprint_m2",
    "plan_long_m",
    "plan_short_m",
    "chest_long_m",
    "chest_short_m",
    *PART_CUES,
)

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.floating[Any]]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Trees:
    """Boosted trees, their nodes one after the other; leaves point to themselves."""

    roots: Ints
    feature: Ints
    threshold: Floats
    left: Ints
    right: Ints
    value: Floats
    first: float
    depth: int
    suspect: float
    certain: float

    def log_odds(self, cues: Floats) -> float:
        """Return the log-odds of more than one person."""
        node = self.roots
        for _ in range(self.depth):
            below = cues[self.feature[node]] <= self.threshold[node]
            node = np.where(below, self.left[node], self.right[node])
        return self.first + float(self.value[node].sum())


class Table(msgspec.Struct, kw_only=True):
    """The model's file: the same trees as lists, and the cues that they were made for."""

    cues: list[str]
    depth: int
    first: float
    feature: list[list[int]]
    threshold: list[list[float]]
    left: list[list[int]]
    right: list[list[int]]
    value: list[list[float]]
    suspect: float = 0.0
    certain: float = 0.0


@lru_cache(maxsize=1)
def shipped_model() -> Trees:
    text = (resources.files("clients.robot.hiding") / MODEL_FILE).read_text(encoding="utf-8")
    return trees_of(msgspec.convert(read_json_text(text), Table))


def trees_of(table: Table, cues: Sequence[str] = CUES) -> Trees:
    """Raises ValueError for other cues."""
    if table.cues != list(cues):
        raise ValueError("The model was made for other cues.")
    feature, left, right = (np.array(part, dtype=np.int64) for part in (table.feature, table.left, table.right))
    roots = np.arange(feature.shape[0]) * feature.shape[1]
    return Trees(
        roots=roots,
        feature=feature.ravel(),
        threshold=np.array(table.threshold, dtype=np.float64).ravel(),
        left=(roots[:, None] + left).ravel(),
        right=(roots[:, None] + right).ravel(),
        value=np.array(table.value, dtype=np.float64).ravel(),
        first=table.first,
        depth=table.depth,
        suspect=table.suspect,
        certain=table.certain,
    )


def measure(inside: Mask, depth: Depth, left: int, top: int, shape: tuple[int, int], focal_px: float) -> Floats:
    """Return a non-empty silhouette's cues; `focal_px` of the whole image."""
    cut_below, cut_aside = _cut_off(inside, left, top, shape)
    parts = measure_parts(inside, depth, focal_px)
    step = 2 if np.count_nonzero(inside) > PIXELS_MAX_COUNT else 1
    inside, depth = inside[::step, ::step], depth[::step, ::step]
    rows, columns = np.nonzero(inside)
    z = depth[rows, columns].astype(np.float32) / 1000
    ordered = np.sort(z)
    middle = float(ordered[ordered.size // 2])
    pixel = middle / focal_px * step
    x = (columns * np.float32(step) + np.float32(left - (shape[1] - 1) / 2)) * z / np.float32(focal_px)
    tall, wide = inside.shape[0] * pixel, inside.shape[1] * pixel
    band = np.searchsorted(np.array(BANDS_M[1:-1]), rows * pixel).astype(np.intp)
    counts = np.bincount(band, minlength=len(BANDS_M) - 1)
    means = np.bincount(band, weights=z, minlength=len(BANDS_M) - 1) / np.maximum(counts, 1)
    row_band = np.searchsorted(np.array(BANDS_M[1:-1]), np.arange(inside.shape[0]) * pixel)
    band_rows = np.bincount(row_band, minlength=len(BANDS_M) - 1)
    starts = np.count_nonzero(inside[:, 1:] & ~inside[:, :-1], axis=1) + inside[:, 0]
    runs = np.bincount(row_band, weights=starts, minlength=len(BANDS_M) - 1) / np.maximum(band_rows, 1)
    chest = (band >= CHEST_BANDS[0]) & (band <= CHEST_BANDS[1])
    chest_x, chest_z = x[chest], z[chest]
    return np.array(
        [
            rows.size * pixel * pixel,
            tall,
            wide,
            ((shape[0] - 1) / 2 - top) * middle / focal_px,
            middle,
            rows.size / inside.size,
            cut_below,
            cut_aside,
            *(counts * pixel / np.maximum(band_rows, 1)),
            *runs,
            *np.where(counts > 0, means - middle, 0.0),
            *_heads(inside, pixel),
            _spread(ordered),
            _spread(np.sort(chest_z)),
            _spread(np.sort(z[band == HEAD_BAND])),
            _halves(chest_x, chest_z),
            _footprint(x, z, middle),
            _footprint(chest_x, chest_z, middle),
            *_plan(x, z),
            *_plan(chest_x, chest_z),
            *parts,
        ],
        dtype=np.float64,
    )


def _cut_off(inside: Mask, left: int, top: int, shape: tuple[int, int]) -> tuple[float, float]:
    below = top + inside.shape[0] >= shape[0] - 1
    aside = left <= 1 or left + inside.shape[1] >= shape[1] - 1
    return float(below), float(aside)


def _heads(inside: Mask, pixel: float) -> tuple[float, float, float]:
    """Return saddle depth, height drop and gap of two heads."""
    columns = inside.any(axis=0)
    skyline = np.where(columns, inside.shape[0] - inside.argmax(axis=0), 0) * pixel
    if skyline.size >= 3:  # a lone pixel is no head
        skyline[1:-1] = np.minimum(skyline[1:-1], np.maximum(skyline[:-2], skyline[2:]))
    peak = int(skyline.argmax())
    best = (0.0, 0.0, 0.0)
    for side in (skyline[peak:], skyline[peak::-1]):
        rises = side - np.minimum.accumulate(side)
        second = int(rises.argmax())
        if rises[second] > best[0]:
            best = (float(rises[second]), float(side[0] - side[second]), second * pixel)
    return best


def _spread(ordered: Numbers) -> float:
    if ordered.size < 8:
        return 0.0
    cut = int(EDGE_SHARE * ordered.size)
    return float(ordered[-1 - cut] - ordered[cut])


def _halves(x: Numbers, z: Numbers) -> float:
    if x.size < 8:
        return 0.0
    right = x > x.mean()
    return abs(float(z[right].mean()) - float(z[~right].mean())) if right.any() and not right.all() else 0.0


def _footprint(x: Numbers, z: Numbers, middle: float) -> float:
    if x.size == 0:
        return 0.0
    across = np.clip(((x - x.mean()) / CELL_M + CELLS_COUNT / 2).astype(np.int64), 0, CELLS_COUNT - 1)
    ahead = np.clip(((z - middle) / CELL_M + CELLS_COUNT / 2).astype(np.int64), 0, CELLS_COUNT - 1)
    return float(np.count_nonzero(np.bincount(across * CELLS_COUNT + ahead) > 1)) * CELL_M * CELL_M


def _plan(x: Numbers, z: Numbers) -> tuple[float, float]:
    if x.size < 8:
        return 0.0, 0.0
    dx, dz = x - x.mean(), z - z.mean()
    xx, zz, xz = float(dx @ dx) / x.size, float(dz @ dz) / x.size, float(dx @ dz) / x.size
    half, root = (xx + zz) / 2, float(np.hypot((xx - zz) / 2, xz))
    return float(np.sqrt(half + root)), float(np.sqrt(max(half - root, 0.0)))

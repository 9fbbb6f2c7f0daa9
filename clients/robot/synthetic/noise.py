"""Noise of depth cameras, of structured light or time of flight. Deterministic by seed and index."""

from __future__ import annotations

import cv2
import numpy as np

from clients.robot.sensing.depth_noise import depth_sigma_m
from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.camera import Image, Labels

JITTER_PX = 0.45
BASELINE_M = 0.075
DISPARITY_STEPS_PER_PX = 8
RANGE_MIN_M, RANGE_MAX_M = 0.4, 9.0
EDGE_JUMP_M = 0.12
EDGE_LOSS = 0.55
SHADOW_STEPS_PX = (2, 4, 6, 8, 11)
FLYING_SHARE = 0.3
FLIGHT_FLOOR_M, FLIGHT_SLOPE = 0.004, 0.0015
POOL_COUNT = 6
POOL_MARGIN_PX = 96
HOLE_SIZE_PX = 1.6


class CameraNoise:
    """Structured light: jitter, axial noise, disparity steps, shadows, holes. Random fields are drawn once and shifted
    for each frame, for speed.
    """

    def __init__(self, shape: tuple[int, int], focal_px: float, seed: int, holes: float = 0.0) -> None:
        self._shape = shape
        self._seed = seed
        self._disparity = np.float32(focal_px * BASELINE_M)
        rng = np.random.default_rng([seed, 0xFEED])
        large = (shape[0] + POOL_MARGIN_PX, shape[1] + POOL_MARGIN_PX)
        self._normal = [rng.standard_normal(large, dtype=np.float32) for _ in range(POOL_COUNT)]
        self._uniform = [rng.random(large, dtype=np.float32) for _ in range(POOL_COUNT)]
        self._no_fractions = np.zeros((0,), dtype=np.uint16)
        rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
        self._jitters = []
        for _ in range(POOL_COUNT):
            dx = np.rint(rng.normal(0, JITTER_PX, shape)).astype(np.int16)
            dy = np.rint(rng.normal(0, JITTER_PX, shape)).astype(np.int16)
            x = np.clip(columns + dx, 0, shape[1] - 1).astype(np.int16)
            y = np.clip(rows + dy, 0, shape[0] - 1).astype(np.int16)
            self._jitters.append(np.ascontiguousarray(np.stack([x, y], axis=-1)))
        self._holes = [_blotches(large, holes, rng) for _ in range(POOL_COUNT)] if holes > 0 else []

    def apply(self, depth: Image, labels: Labels | None, index: int) -> tuple[Depth, Labels | None]:
        """Return the noisy frame in millimetres, and `labels` shifted alike."""
        rng = np.random.default_rng([self._seed, 1, index])
        disparity = self._disparity / depth
        lost = self._shadow(disparity)
        edges = cv2.morphologyEx(np.minimum(depth, RANGE_MAX_M + 1), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
        lost |= (edges > EDGE_JUMP_M) & (self._field(self._uniform, rng) < EDGE_LOSS)
        jitter = self._jitters[int(rng.integers(POOL_COUNT))]
        moved = cv2.remap(depth, jitter, self._no_fractions, cv2.INTER_NEAREST).astype(np.float32, copy=False)
        if labels is not None:
            labels = cv2.remap(labels, jitter, self._no_fractions, cv2.INTER_NEAREST).astype(np.uint8, copy=False)
        sigma = depth_sigma_m(moved)
        noisy = moved + sigma * self._field(self._normal, rng)
        scale = self._disparity * DISPARITY_STEPS_PER_PX
        stepped = scale / np.rint(scale / np.maximum(noisy, np.float32(0.2)))
        lost |= (moved > RANGE_MAX_M) | (stepped < RANGE_MIN_M) | (stepped > RANGE_MAX_M)
        millimetres = np.rint(stepped * 1000)
        if self._holes:
            lost |= self._field(self._holes, rng) > 0
        millimetres[lost] = 0
        return millimetres.astype(np.uint16), labels

    def _field(self, pool: list[Image], rng: np.random.Generator) -> Image:
        field = pool[int(rng.integers(POOL_COUNT))]
        top, left = (int(v) for v in rng.integers(POOL_MARGIN_PX, size=2))
        cut = field[top : top + self._shape[0], left : left + self._shape[1]]
        return cut[:, ::-1] if rng.integers(2) else cut

    @staticmethod
    def _shadow(disparity: Image) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        lost = np.zeros(disparity.shape, dtype=bool)
        for step in SHADOW_STEPS_PX:
            lost[:, :-step] |= (disparity[:, step:] - disparity[:, :-step]) > step
        return lost


class FlightNoise(CameraNoise):
    """Time of flight: axial noise, holes, and at edges pixels at a depth in between."""

    def apply(self, depth: Image, labels: Labels | None, index: int) -> tuple[Depth, Labels | None]:
        rng = np.random.default_rng([self._seed, 1, index])
        square = np.ones((3, 3), np.uint8)
        reached = np.minimum(depth, np.float32(RANGE_MAX_M + 1))
        near, far = cv2.erode(reached, square), cv2.dilate(reached, square)
        chance = self._field(self._uniform, rng)
        flying = (far - near > EDGE_JUMP_M) & (chance < FLYING_SHARE)
        flown = np.where(flying, near + (far - near) * (chance / np.float32(FLYING_SHARE)), reached)
        noisy = flown + (np.float32(FLIGHT_FLOOR_M) + np.float32(FLIGHT_SLOPE) * flown) * self._field(self._normal, rng)
        lost = (noisy < RANGE_MIN_M) | (noisy > RANGE_MAX_M)
        if self._holes:
            lost |= self._field(self._holes, rng) > 0
        millimetres = np.rint(noisy * 1000)
        millimetres[lost] = 0
        return millimetres.astype(np.uint16), None if labels is None else labels.copy()


def blur(depth: Image, labels: Labels, shift_px: float, seed: int, index: int) -> tuple[Image, Labels]:
    """Mix the depths at edges that pass a pixel while the shutter is open; the label is of what is nearer."""
    half = round(abs(shift_px) / 2)
    if half == 0:
        return depth, labels
    columns = np.arange(depth.shape[1])
    first, last = np.clip(columns - half, 0, None), np.clip(columns + half, None, depth.shape[1] - 1)
    one, two = depth[:, first], depth[:, last]
    mixed = np.abs(one - two) > EDGE_JUMP_M
    share = np.random.default_rng([seed, 4, index]).random(depth.shape, dtype=np.float32)
    nearer = np.where(one < two, labels[:, first], labels[:, last])
    return np.where(mixed, one + (two - one) * share, depth), np.where(mixed, nearer, labels)


def _blotches(shape: tuple[int, int], share: float, rng: np.random.Generator) -> Image:
    rough = np.asarray(cv2.GaussianBlur(rng.standard_normal(shape, dtype=np.float32), (0, 0), HOLE_SIZE_PX))
    return np.asarray(rough > np.quantile(rough, 1 - share), dtype=np.float32)

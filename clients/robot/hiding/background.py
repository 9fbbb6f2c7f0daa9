"""Empty scene: background model and recorded frames; learning cannot detect people."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from clients.robot.sensing.depth_noise import depth_sigma_m
from clients.robot.sensing.sensor_events import Depth, check_depth
from consensus.errors import BlockRobotError

MODEL_FRAMES_MAX_COUNT = 31
BANK_FRAMES_MAX_COUNT = 64
UNSEEN_MM = 12_000  # where the camera never measured anything, all that it measures is in front
THRESHOLD_MIN_MM = 90.0
SIGMA_FACTOR = 4.5
STEADY_SHARE = 0.3
COLUMN_MIN_SHARE = 0.25  # of what the middle one of all columns measures: with less it is outside, but for stray pixels
PNG_LEVEL = 1
# A person is nearer than the empty scene. Where this share of a frame is farther than it, the scene is another one: the
# robot has moved or was turned. An open door near by reaches 2 %, a mirror-like floor 0.4 %.
BEYOND_SHARE = 0.03
SMALL_WIDTH_PX = 320  # in a smaller picture, edges that waver by a pixel are as large a share
_BESIDE = np.ones((3, 3), dtype=np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """Depth in mm, and required nearness per pixel (uint16)."""

    depth: Depth
    threshold: Depth
    half_depth: Depth
    half_threshold: Depth

    @property
    def shape(self) -> tuple[int, int]:
        return (self.depth.shape[0], self.depth.shape[1])

    @property
    def sides(self) -> tuple[int, int]:
        """The outermost columns that the camera measures: stereo and registered depth leave out some."""
        counts = np.count_nonzero(self.depth != UNSEEN_MM, axis=0)
        measured = np.flatnonzero(counts >= COLUMN_MIN_SHARE * np.median(counts))
        return int(measured[0]), int(measured[-1])


def learn_background(frames: Sequence[Depth]) -> Background:
    """Raises FRAME_INVALID."""
    if not frames:
        raise BlockRobotError("FRAME_INVALID", "A background needs at least one empty frame.")
    shape = (frames[0].shape[0], frames[0].shape[1])
    step = max(1, len(frames) // MODEL_FRAMES_MAX_COUNT)
    stack = np.stack([check_depth(frame, shape=shape) for frame in frames[::step][:MODEL_FRAMES_MAX_COUNT]], axis=-1)
    stack.sort(axis=-1)
    count = stack.shape[-1]
    measured = np.count_nonzero(stack, axis=-1)
    steady = measured >= STEADY_SHARE * count
    place = np.where(steady, count - measured + measured // 2, np.minimum(count - measured, count - 1))
    depth = np.take_along_axis(stack, place[..., None], axis=-1)[..., 0]
    depth[measured == 0] = UNSEEN_MM
    sigma_mm = 1000 * depth_sigma_m(depth.astype(np.float32) / np.float32(1000))
    threshold = np.maximum(THRESHOLD_MIN_MM, SIGMA_FACTOR * sigma_mm).astype(np.uint16)
    return Background(
        depth=depth,
        threshold=threshold,
        half_depth=np.ascontiguousarray(depth[::2, ::2]),
        half_threshold=np.ascontiguousarray(threshold[::2, ::2]),
    )


def fits(background: Background, depth: Depth) -> bool:
    """Return whether an equally shaped frame still shows that scene and viewpoint."""
    half = depth[::4, ::4]
    empty = np.ascontiguousarray(background.half_depth[::2, ::2])
    if depth.shape[1] < SMALL_WIDTH_PX:
        empty = np.asarray(cv2.dilate(empty, _BESIDE), dtype=np.uint16)
    beyond = cv2.compare(
        cv2.subtract(half, empty),
        np.ascontiguousarray(background.half_threshold[::2, ::2]),
        cv2.CMP_GT,
    )
    return bool(cv2.countNonZero(beyond) <= BEYOND_SHARE * half.size)


@dataclass(frozen=True, slots=True)
class EmptyFrame:
    """Empty frame as PNG16; `background_id`: SHA-256 of `png`."""

    background_id: bytes
    png: bytes


def empty_bank(frames: Sequence[Depth]) -> list[EmptyFrame]:
    """Return at most `BANK_FRAMES_MAX_COUNT` PNG frames."""
    bank = []
    for frame in frames[:BANK_FRAMES_MAX_COUNT]:
        done, data = cv2.imencode(".png", check_depth(frame), [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
        if not done:
            raise BlockRobotError("FRAME_INVALID", "An empty frame could not be written as PNG.")
        png = data.tobytes()
        bank.append(EmptyFrame(hashlib.sha256(png).digest(), png))
    return bank

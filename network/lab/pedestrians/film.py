"""The pedestrians' film, with depth derived from feet on flat ground."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.background import Background
from clients.robot.sensing.sensor_events import Depth
from consensus.errors import BlockRobotError

FILM = Path("/usr/share/doc/opencv-doc/examples/data/vtest.avi")
FRAME_RATE = 10
FRAME_MS = 1000 // FRAME_RATE

# Fitted by eye to people of 1.75 m in the film: their height in pixels is 0.229 of the way from the horizon to their feet.
HORIZON_PX, CAMERA_HEIGHT_M, FOCAL_PX = -77.0, 7.6, 1145.0

EMPTY_EVERY = 12  # every twelfth frame makes the empty scene: nobody stands at one place for half of the film
DIFFERENCE_MIN = 28  # of 255, in the channel that differs most
REGION_MIN_PX = 90
FAR_MM = 65_000
NEARER_MM = 90

Colour = npt.NDArray[np.uint8]
_CLOSE = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 9))
_OPEN = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """All frames (uint8, height x width x 3, BGR) and the median empty scene."""

    frames: tuple[Colour, ...]
    empty: Colour

    @property
    def shape(self) -> tuple[int, int]:
        return (self.empty.shape[0], self.empty.shape[1])


def read_film(path: Path = FILM) -> Film:
    """Raises FILE_UNUSABLE."""
    reader = cv2.VideoCapture(str(path)) if path.is_file() else None
    frames: list[Colour] = []
    while reader is not None:
        done, frame = reader.read()
        if not done:
            break
        frames.append(np.asarray(frame, dtype=np.uint8))
    if not frames:
        raise BlockRobotError(
            "FILE_UNUSABLE", f"The film {path} is not there or cannot be read (Debian: apt install opencv-doc)."
        )
    empty = np.median(np.stack(frames[::EMPTY_EVERY]), axis=0).astype(np.uint8)
    return Film(tuple(frames), empty)


def background_of(film: Film) -> Background:
    height, width = film.shape
    depth = np.full((height, width), FAR_MM, dtype=np.uint16)
    threshold = np.full((height, width), NEARER_MM, dtype=np.uint16)
    return Background(
        depth, threshold, np.ascontiguousarray(depth[::2, ::2]), np.ascontiguousarray(threshold[::2, ::2])
    )


def moving(film: Film, frame: Colour) -> Colour:
    differs = cv2.absdiff(frame, film.empty).max(axis=2)
    mask = np.where(differs > DIFFERENCE_MIN, np.uint8(255), np.uint8(0))
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_OPEN, _OPEN), cv2.MORPH_CLOSE, _CLOSE)
    return np.asarray(mask, dtype=np.uint8)


def depth_of(film: Film, frame: Colour) -> Depth:
    """Return a frame's derived depth (mm, 0 where nothing moves), by regions' lowest points."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(moving(film, frame), connectivity=8)
    depth_of_label = np.zeros(count, dtype=np.uint16)
    for number in range(1, count):
        if stats[number, cv2.CC_STAT_AREA] < REGION_MIN_PX:
            continue
        feet_px = float(stats[number, cv2.CC_STAT_TOP] + stats[number, cv2.CC_STAT_HEIGHT])
        away_m = FOCAL_PX * CAMERA_HEIGHT_M / (feet_px - HORIZON_PX)
        depth_of_label[number] = min(FAR_MM - 2 * NEARER_MM, round(away_m * 1000))
    return np.asarray(depth_of_label[labels], dtype=np.uint16)

"""Drops what a time-of-flight camera measures between two surfaces, at their edges."""

from __future__ import annotations

import cv2
import numpy as np

from clients.robot.sensing.sensor_events import Depth

JUMP_MM, JUMP_SHARE = 60, 0.05

_AROUND = np.ones((3, 3), np.uint8)
_FARTHEST_MM = 65_535


def drop_flying_pixels(depth: Depth) -> Depth:
    """Return the frame without pixels whose neighbours differ by more than 6 cm plus 5 % of the distance."""
    farthest = np.asarray(cv2.dilate(depth, _AROUND), dtype=np.uint16)
    known = np.where(depth == 0, np.uint16(_FARTHEST_MM), depth)
    nearest = np.asarray(cv2.erode(known, _AROUND), dtype=np.uint16)
    allowed = cv2.addWeighted(depth, JUMP_SHARE, depth, 0.0, JUMP_MM)
    steep = cv2.compare(cv2.subtract(farthest, nearest), allowed, cv2.CMP_GT)
    return np.where(np.asarray(steep) > 0, np.uint16(0), depth)

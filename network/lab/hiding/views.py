"""An attacker's view per way of hiding: picture, empty scene, owner's outline."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from clients.robot.sensing.sensor_events import Depth, Mask

BLUR_PX = 51  # the Gaussian of the paper's prototype


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A half-resolution picture: depth in mm, median empty frame, owner's pixels.

    Every attacker gets the owner's outline, as a thief may know the owner.
    """

    picture: Depth
    empty: Depth
    owner: Mask


def half_view(picture: Depth, empty: Depth, owner: Mask) -> View:
    return View(
        np.ascontiguousarray(picture[::2, ::2]),
        np.ascontiguousarray(empty[::2, ::2]),
        np.ascontiguousarray(owner[::2, ::2]),
    )


def show_owner_only(kept: Depth, recorded_empty: Depth) -> Depth:
    """Return our rendition as displayed: the owner's non-zero pixels on a recorded empty frame."""
    return np.where(kept > 0, kept, recorded_empty)


def blur_others(picture: Depth, others: Mask) -> Depth:
    blurred = cv2.GaussianBlur(picture.astype(np.float32), (BLUR_PX, BLUR_PX), 0)
    return np.where(others, np.rint(blurred), picture).astype(np.uint16)

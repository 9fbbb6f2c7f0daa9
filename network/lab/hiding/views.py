"""What a thief of a rendition holds, for each way of hiding: the picture, the empty scene and the owner's own outline."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from clients.robot.sensing.sensor_events import Depth, Mask

BLUR_PX = 51  # the Gaussian of the paper's prototype


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One picture at half resolution: depth in millimetres, the median empty frame, and the owner's pixels.

    The owner's outline is given to every attacker: a thief of a record may well know whose it is.
    """

    picture: Depth
    empty: Depth
    owner: Mask


def half_view(picture: Depth, empty: Depth, owner: Mask) -> View:
    """Return the view of a whole picture, at half resolution."""
    return View(
        np.ascontiguousarray(picture[::2, ::2]),
        np.ascontiguousarray(empty[::2, ::2]),
        np.ascontiguousarray(owner[::2, ::2]),
    )


def show_owner_only(kept: Depth, recorded_empty: Depth) -> Depth:
    """Return our rendition as the wallet shows it: the owner's pixels (not 0) on a recorded empty frame."""
    return np.where(kept > 0, kept, recorded_empty)


def blur_others(picture: Depth, others: Mask) -> Depth:
    """Return the picture with everyone else blurred, the mask being the true one: the paper's method at its best."""
    blurred = cv2.GaussianBlur(picture.astype(np.float32), (BLUR_PX, BLUR_PX), 0)
    return np.where(others, np.rint(blurred), picture).astype(np.uint16)

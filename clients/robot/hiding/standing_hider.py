"""Hides before a scene that was learned empty: what is nearer is people; pictures go onto an empty frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clients.robot.hiding.background import Background, fits
from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.cutouts import extract_encoded_cutout
from clients.robot.hiding.hider import FoundPeople, in_odometry
from clients.robot.hiding.own_motion import RobotPlace
from clients.robot.hiding.segmentation import EMPTY_MAX_PX, Segmented, Silhouette, segment
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.sensing.sensor_events import Depth


class StandingHider:
    """Fits while the camera sees the learned scene from where it was learned. `range_max_m`: nobody farther is shown."""

    is_blank = False

    def __init__(self, background: Background, focal_px: float, range_max_m: float = math.inf) -> None:
        self._background = background
        self._focal_px = focal_px
        self._range_max_m = range_max_m
        self._companions = CompanionWatch()

    def find_people(self, depth: Depth, place: RobotPlace | None, at_ms: int) -> FoundPeople | None:
        if not fits(self._background, depth):
            return None
        segmented = segment(depth, self._background, self._focal_px)
        found = tuple(self._in_range(one) for one in self._companions.step(segmented.silhouettes, at_ms))
        if place is not None:
            found = tuple(in_odometry(silhouette, place) for silhouette in found)
        return FoundPeople(
            found,
            _stray_px(segmented) >= EMPTY_MAX_PX,
            lambda silhouette: extract_encoded_cutout(depth, self._background, segmented, silhouette),
        )

    def restart(self) -> None:
        self._companions = CompanionWatch()

    def _in_range(self, silhouette: Silhouette) -> Silhouette:
        if silhouette.range_m <= self._range_max_m or silhouette.withhold_reason:
            return silhouette
        return replace(silhouette, withhold_reason=str(WithholdReason.OUT_OF_RANGE))


def _stray_px(segmented: Segmented) -> int:
    """Half-resolution foreground outside silhouettes."""
    if segmented.labels is None:
        return 0
    counts = np.bincount(segmented.labels.ravel() + 1, minlength=2)  # labels begin with -1
    found = [silhouette.label for silhouette in segmented.silhouettes]
    return int(counts.sum() - counts[[1, *(label + 1 for label in found)]].sum())

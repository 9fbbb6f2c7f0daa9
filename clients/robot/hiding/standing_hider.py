"""Hides before a scene that was learned empty: what is nearer is people; pictures go onto an empty frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clients.robot.hiding.background import Background, fits
from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.cutouts import extract_encoded_cutout
from clients.robot.hiding.hider import DRIVING_RANGE_MAX_M, FoundPeople, in_odometry, is_cut_off
from clients.robot.hiding.own_motion import RobotPlace
from clients.robot.hiding.segmentation import EMPTY_MAX_PX, Segmented, Silhouette, segment
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.sensing.sensor_events import Depth


class StandingHider:
    """Fits while the camera sees the learned scene from where it was learned.

    `drives`: as on the way, nobody is shown who is too far or cut off by the picture's side, where somebody beside them may
    be part of their silhouette.
    """

    is_blank = False

    def __init__(self, background: Background, focal_px: float, *, drives: bool = False) -> None:
        self._background = background
        self._focal_px = focal_px
        self._drives = drives
        self._sides = background.sides
        self._companions = CompanionWatch()

    def find_people(self, depth: Depth, place: RobotPlace | None, at_ms: int) -> FoundPeople | None:
        if not fits(self._background, depth):
            return None
        segmented = segment(depth, self._background, self._focal_px)
        found = self._companions.step(segmented.silhouettes, at_ms)
        if self._drives:
            found = tuple(_as_on_the_way(silhouette, self._sides) for silhouette in found)
        if place is not None:
            found = tuple(in_odometry(silhouette, place) for silhouette in found)
        return FoundPeople(
            found,
            _stray_px(segmented) >= EMPTY_MAX_PX,
            lambda silhouette: extract_encoded_cutout(depth, self._background, segmented, silhouette),
        )

    def restart(self) -> None:
        self._companions = CompanionWatch()


def _as_on_the_way(silhouette: Silhouette, sides: tuple[int, int]) -> Silhouette:
    if silhouette.withhold_reason:
        return silhouette
    if silhouette.range_m > DRIVING_RANGE_MAX_M:
        return replace(silhouette, withhold_reason=str(WithholdReason.OUT_OF_RANGE))
    if is_cut_off(silhouette.box, sides, 2):
        return replace(silhouette, withhold_reason=str(WithholdReason.CUT_OFF))
    return silhouette


def _stray_px(segmented: Segmented) -> int:
    """Half-resolution foreground outside silhouettes."""
    if segmented.labels is None:
        return 0
    counts = np.bincount(segmented.labels.ravel() + 1, minlength=2)  # labels begin with -1
    found = [silhouette.label for silhouette in segmented.silhouettes]
    return int(counts.sum() - counts[[1, *(label + 1 for label in found)]].sum())

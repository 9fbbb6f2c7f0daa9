"""What a way of hiding does: it finds the people of a frame, cuts one out, and decides whether that may be shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.own_motion import RobotPlace
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.sensing.sensor_events import Depth

DRIVING_RANGE_MAX_M = 4.5
"""How far somebody is shown by a robot that drives: beyond, steps of depth are coarse."""

EDGE_PX = 1  # of the reduced picture: so near its side somebody may be cut off


class AskedLater(Protocol):
    """Whether a silhouette may be shown, asked once later frames have been seen too; and why not, empty if it may."""

    def __call__(self) -> bool:
        return not self.why_not()

    def why_not(self) -> str: ...


@dataclass(frozen=True, slots=True, eq=False)
class FoundPeople:
    """The people of one frame, placed in the odometry's frame.

    `stray`: more than noise belongs to none of them. `may_show`: by a silhouette's label; who is missing there may be
    shown at once.
    """

    silhouettes: tuple[Silhouette, ...]
    stray: bool
    cut: Callable[[Silhouette], EncodedCutout]
    may_show: dict[int, AskedLater] = field(default_factory=dict)

    def withhold_all(self, reason: WithholdReason) -> FoundPeople:
        """Who is withheld already keeps their reason."""
        silhouettes = (replace(one, withhold_reason=one.withhold_reason or str(reason)) for one in self.silhouettes)
        return replace(self, silhouettes=tuple(silhouettes))


class Hider(Protocol):
    """One camera's frames, in time order."""

    @property
    def is_blank(self) -> bool:
        """Whether pictures show the owner on nothing, not in the room."""

    def find_people(self, depth: Depth, place: RobotPlace | None, at_ms: int) -> FoundPeople | None:
        """None if this way does not fit the frame. `place`: of the robot, None if it is not known."""

    def restart(self) -> None:
        """Frames that follow have nothing to do with those before."""


def in_odometry(silhouette: Silhouette, place: RobotPlace) -> Silhouette:
    x_m, z_m = place.to_odometry(silhouette.x_m, silhouette.z_m)
    return replace(silhouette, x_m=x_m, z_m=z_m)


def is_cut_off(box: tuple[int, int, int, int], sides: tuple[int, int], step_px: int) -> bool:
    """Tell whether the picture's side may cut somebody off.

    `box`: x, y, width, height where one of `step_px` columns is looked at. `sides`: the outermost measured columns.
    """
    left, _, width, _ = box
    first, last = -(-sides[0] // step_px), sides[1] // step_px
    return left <= first + EDGE_PX or left + width > last - EDGE_PX

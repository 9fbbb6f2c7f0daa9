"""Hides without an empty scene: verified single persons on a blank picture, from a camera that moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources

import cv2
import msgspec
import numpy as np

from clients.robot.hiding.companion import Table, Trees, trees_of
from clients.robot.hiding.cutouts import encode_cutout
from clients.robot.hiding.hider import DRIVING_RANGE_MAX_M, AskedLater, FoundPeople, is_cut_off
from clients.robot.hiding.moving.blank_cutouts import cut_body
from clients.robot.hiding.moving.body_cues import BODY_CUES, Body, measure_bodies
from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.plan_bodies import CELL_M, STEP_PX, LevelView, PlanView
from clients.robot.hiding.moving.release_rule import (
    LOG_ODDS_LIMIT,
    NEAR_MIN_LOG_ODDS,
    TRACK_MIN_LOG_ODDS,
    ReleaseRule,
    Sighted,
)
from clients.robot.hiding.moving.scan_match import ScanMatch
from clients.robot.hiding.own_motion import OwnMotion, RobotPlace
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.sensing.sensor_events import Depth
from consensus.bounded_text import read_json_text

MODEL_FILES = {"person": "person-model.json", "pair": "pair-model.json", "thing": "thing-model.json"}
THING_MIN_LOG_ODDS = 3.0
RANGE_M = (1.0, DRIVING_RANGE_MAX_M)
FREE_M = 0.3  # in plan, around a body that is shown
NEARER_PX = 8
CRUMBS_MIN_PX = 3  # of quarter resolution
BEHIND_MM = 350
GROUND_LOST_MAX_COUNT = 10
SAME_BODY_M = 0.6  # between where two ways of hiding see somebody
ODOMETRY = "odometry"  # why a frame is not shown: the camera saw another motion

_HEAD_BEHIND = BODY_CUES.index("behind_head_share")
_FREE_CELLS = 2 * round(FREE_M / CELL_M) + 1
_FREE = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_FREE_CELLS, _FREE_CELLS))
_NEARER = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * NEARER_PX // STEP_PX + 1, 2 * NEARER_PX // STEP_PX + 1))


@dataclass(frozen=True, slots=True, eq=False)
class DrivingCamera:
    """The camera of a robot that drives. `mount`: how it is fixed; None: it is measured in the empty scene.

    `keeps`: whether people are hidden away from the empty scene, or nothing is kept there. `ahead_m`, `left_m`: from what
    the robot's odometry speaks of.
    """

    mount: Ground | None = None
    keeps: bool = True
    ahead_m: float = 0.0
    left_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Models:
    """Log-odds; `person`: of one person and nothing else; `pair`: of two against one; `thing`: of nobody."""

    person: Trees
    pair: Trees
    thing: Trees


@dataclass(frozen=True, slots=True, eq=False)
class SeenBody:
    """`obstacle`: why it is not shown in this frame, or empty. `followed`: its number in the release rule."""

    body: Body
    followed: int
    sighted: Sighted
    thing_odds: float
    obstacle: str

    @property
    def silhouette(self) -> Silhouette:
        body, merged = self.body, min(self.sighted.person, self.sighted.alone) <= TRACK_MIN_LOG_ODDS
        return Silhouette(
            label=body.label,
            box=body.box,
            x_m=self.sighted.x_m,
            z_m=self.sighted.z_m,
            range_m=body.range_m,
            median_mm=body.median_mm,
            withhold_reason="merged" if merged else self.obstacle,
            ahead_m=body.z_m,
            right_m=body.x_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Later(AskedLater):
    motion: OwnMotion
    rule: ReleaseRule
    followed: int
    at_ms: int
    buffer_ms: int

    def why_not(self) -> str:
        if self.motion.is_doubted(self.at_ms, self.at_ms):
            return ODOMETRY
        return self.rule.why_not(self.followed, self.at_ms, self.buffer_ms) or ""


@dataclass(frozen=True, slots=True, eq=False)
class _SecondLook(AskedLater):
    rule: ReleaseRule
    followed: int
    at_ms: int
    buffer_ms: int

    def why_not(self) -> str:
        return "merged" if self.rule.speaks_for_two(self.followed, self.at_ms, self.buffer_ms) else ""


class _NotFound(AskedLater):
    def why_not(self) -> str:
        return "unverified"


@lru_cache(maxsize=1)
def shipped_models() -> Models:
    def load(name: str) -> Trees:
        text = (resources.files("clients.robot.hiding.moving") / MODEL_FILES[name]).read_text(encoding="utf-8")
        return trees_of(msgspec.convert(read_json_text(text), Table), BODY_CUES)

    return Models(load("person"), load("pair"), load("thing"))


class MovingHider:
    """Fits wherever the robot's place is known. `buffer_ms`: so long before and after, frames speak for and against a
    picture. `sides`: the outermost columns that the camera measures; None: all.
    """

    is_blank = True

    def __init__(
        self,
        shape: tuple[int, int],
        focal_px: float,
        mount: Ground,
        *,
        buffer_ms: int,
        motion: OwnMotion,
        models: Models | None = None,
        sides: tuple[int, int] | None = None,
    ) -> None:
        self._plan = PlanView(shape, focal_px, mount)
        self._focal_px = focal_px
        self._sides = sides or (0, shape[1] - 1)
        self._buffer_ms = buffer_ms
        self._models = models or shipped_models()
        self._rule = ReleaseRule()
        self._motion = motion
        self._scans = ScanMatch(shape[1] / 2 / focal_px, motion)

    def find_people(self, depth: Depth, place: RobotPlace | None, at_ms: int) -> FoundPeople | None:
        if place is None:
            return None
        view, seen = self.look(depth, place, at_ms)
        people = [one for one in seen if one.thing_odds < THING_MIN_LOG_ODDS]
        if not self._scans.agrees(view, [one.body.label for one in people], place):
            return None
        bodies = {one.body.label: one.body for one in people}
        return FoundPeople(
            tuple(one.silhouette for one in people),
            len(people) < len(seen),
            lambda silhouette: encode_cutout(cut_body(depth, view, bodies[silhouette.label], self._focal_px)),
            {one.body.label: _Later(self._motion, self._rule, one.followed, at_ms, self._buffer_ms) for one in people},
        )

    def look_again(self, found: FoundPeople, depth: Depth, place: RobotPlace, at_ms: int) -> FoundPeople:
        """Return whom another way found in that frame; who looks like two people here is not to be shown, nor who is no
        body by itself: they may touch something, and somebody else with it.
        """
        _, seen = self.look(depth, place, at_ms)
        may_show: dict[int, AskedLater] = {}
        for one in found.silhouettes:
            away = [
                (float(np.hypot(body.body.x_m - one.right_m, body.body.z_m - one.ahead_m)), body.followed)
                for body in seen
            ]
            near_m, followed = min(away, default=(np.inf, 0))
            found_too = near_m <= SAME_BODY_M
            look = _SecondLook(self._rule, followed, at_ms, self._buffer_ms) if found_too else _NotFound()
            may_show[one.label] = look
        return replace(found, may_show=may_show)

    def look(self, depth: Depth, place: RobotPlace, at_ms: int) -> tuple[LevelView, list[SeenBody]]:
        """Return every body that could be a person by its size."""
        view = self._plan.look(depth)
        lost = self._plan.frames_without_ground_count > GROUND_LOST_MAX_COUNT
        bodies = measure_bodies(view, self._plan.focal_px)
        sighted = [self._sight(body, view, place) for body in bodies]
        seen = []
        for body, one, number in zip(bodies, sighted, self._rule.step(sighted, at_ms), strict=True):
            obstacle = "no-ground" if lost else _obstacle(view, body, one.person, self._sides)
            seen.append(SeenBody(body, number, one, self._models.thing.log_odds(body.cues), obstacle))
        return view, seen

    def restart(self) -> None:
        self._rule = ReleaseRule()
        self._scans.restart()

    def _sight(self, body: Body, view: LevelView, place: RobotPlace) -> Sighted:
        person, alone = self._models.person.log_odds(body.cues), -self._models.pair.log_odds(body.cues)
        if body.cues[_HEAD_BEHIND] > 0 and body.shows_head_behind(view, self._plan.focal_px):
            alone = -LOG_ODDS_LIMIT  # arms of who stands there may be around the other
        return Sighted(*place.to_odometry(body.x_m, body.z_m), body.z_m, person, alone)


def _obstacle(view: LevelView, body: Body, person_odds: float, sides: tuple[int, int]) -> str:
    if person_odds <= NEAR_MIN_LOG_ODDS:
        return "unverified"
    if not RANGE_M[0] <= body.range_m <= RANGE_M[1] or body.nearest_m < RANGE_M[0] - 0.3:
        return "out-of-range"
    if is_cut_off(body.box, sides, STEP_PX):
        return "cut-off"
    return _beside(view, body)


def _beside(view: LevelView, body: Body) -> str:
    own = view.cells == body.label
    left, top, width, height = cv2.boundingRect(own.view(np.uint8))
    reach = _FREE_CELLS // 2
    rows = slice(max(0, top - reach), top + height + reach)
    columns = slice(max(0, left - reach), left + width + reach)
    near = np.asarray(cv2.dilate(own[rows, columns].view(np.uint8), _FREE)) > 0
    if np.count_nonzero(near & (view.occupied[rows, columns] > 0) & ~own[rows, columns]) >= CRUMBS_MIN_PX:
        return "contact"
    x, y, width, height = body.box
    reach = NEARER_PX // STEP_PX
    rows, columns = slice(max(0, y - reach), y + height + reach), slice(max(0, x - reach), x + width + reach)
    labels = view.labels[rows, columns]
    mine = labels == body.label
    around = np.asarray(cv2.dilate(mine.view(np.uint8), _NEARER)) > 0
    others = around & (labels > 0) & ~mine
    nearer = others & (view.depth[rows, columns] < body.median_mm + BEHIND_MM)
    return "occluded" if np.count_nonzero(nearer) >= CRUMBS_MIN_PX else ""

"""Plays a scene through the robot's redactor; notes releases, owners and costs."""

from __future__ import annotations

import copy
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np

from clients.robot.hiding.background import Background, fits, learn_background
from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.cutouts import Cutout, EncodedCutout, extract_cutout
from clients.robot.hiding.frame_redactor import FrameRedactor, KeptFrame, Output, WithheldFrame
from clients.robot.hiding.segmentation import Segmented, Silhouette, segment
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Tracker
from clients.robot.sensing.antenna_pairs import AntennaBearings
from clients.robot.sensing.sensor_events import Depth, Frame, Mask
from clients.robot.synthetic.camera import Labels
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.tag_readings import readings
from clients.sdk.pictures.rendition_picture import decode_depth_png
from network.lab.hiding.scenes import Scene, View, half_view, sightings

FRAMES_A_SECOND = 5  # of the camera's 30: what the tracks need, at a sixth of the cost
EMPTY_FRAMES_COUNT = 12
VISIBLE_MIN_PX = 600  # of the whole frame; fewer pixels of a person are not a silhouette to recover


# The matcher's reasons: the silhouette itself may well be clean.
DOUBTS = (WithholdReason.AMBIGUOUS, WithholdReason.NO_DISTANCE, WithholdReason.NO_SILHOUETTE)


@dataclass(frozen=True, slots=True)
class Shown:
    """A rendition with others near: frame, owner, gap to the next person (px).

    `kept` is the release; None if only the matcher doubted: the cut alone is judged.
    """

    index: int
    alias: str
    kept: KeptFrame | None
    gap_px: float


@dataclass(slots=True)
class Played:
    """A scene's covered frames per owner, and releases with others in view."""

    covered: int = 0
    visible: int = 0
    withheld: Counter[str] = field(default_factory=Counter)
    kept: int = 0
    wrong: int = 0
    foreign_px: int = 0
    foreign_share: float = 0.0
    shown: list[Shown] = field(default_factory=list)


class Stage:
    """A scene's renderer, its empty frames and the background learned from them."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.renderer = Renderer(scene.scenario)
        self.empty = [self.renderer.empty_frame(i) for i in range(EMPTY_FRAMES_COUNT)]
        self.background: Background = learn_background(self.empty)
        self.focal_px = scene.scenario.focal_px

    def control(self, alias: str) -> Renderer:
        alone = copy.copy(self.renderer)  # with the same camera and the same noise, which take long to draw
        alone.scenario = self.scene.alone(alias)
        return alone

    def frame_indices(self) -> range:
        return range(0, self.scene.scenario.frame_count, max(1, self.scene.scenario.frame_rate // FRAMES_A_SECOND))

    def view(self, picture: Depth, owner: Mask) -> View:
        return half_view(picture, self.background.depth, owner)

    def at_ms(self, index: int) -> int:
        return round(index * 1000 / self.scene.scenario.frame_rate)


def release(stage: Stage, indices: Iterable[int], see: Callable[[int, Depth, Labels], None]) -> list[Output]:
    """Frames and readings go through the robot's redactor as they arrive. `see` receives each frame and its truth before
    the redactor.
    """
    redactor = FrameRedactor(stage.background, focal_px=stage.focal_px, antenna_pairs=stage.scene.antenna_pairs)
    waiting = sightings(readings(stage.scene.scenario))[::-1]
    outputs: list[Output] = []
    for index in indices:
        depth, labels = stage.renderer.frame_with_truth(index)
        see(index, depth, labels)
        at_ms = stage.at_ms(index)
        while waiting and waiting[-1][0] <= at_ms:
            outputs += redactor.push_sighting(*waiting.pop()[1:])
        outputs += redactor.push_frame(Frame(at_ms, index, depth))
    for _, alias, seen in reversed(waiting):
        outputs += redactor.push_sighting(alias, seen)
    outputs += redactor.flush()
    return outputs


def play(stage: Stage, timed: Timed | None = None) -> Played:
    truths: dict[int, Labels] = {}

    def see(index: int, depth: Depth, labels: Labels) -> None:
        truths[index] = labels.copy()
        if timed is not None:
            timed.step(depth, stage.at_ms(index))

    return _judge(stage.scene, release(stage, stage.frame_indices(), see), truths)


def _judge(scene: Scene, outputs: list[Output], truths: dict[int, Labels]) -> Played:
    played = Played()
    owners = scene.owners
    for output in outputs:
        if not isinstance(output, KeptFrame | WithheldFrame):
            continue
        labels, label = truths[output.sequence], owners[output.alias]
        others = (labels != 0) & (labels != label)
        others_px = int(np.count_nonzero(others))
        played.covered += 1
        seen = int(np.count_nonzero(labels == label)) >= VISIBLE_MIN_PX
        played.visible += seen
        if isinstance(output, KeptFrame):
            shown = placed(output, labels.shape) > 0
            foreign = int(np.count_nonzero(shown & others))
            played.kept += 1
            played.wrong += 2 * int(np.count_nonzero(shown & (labels == label))) <= int(np.count_nonzero(shown))
            played.foreign_px = max(played.foreign_px, foreign)
            if others_px >= VISIBLE_MIN_PX:
                played.foreign_share = max(played.foreign_share, foreign / others_px)
        elif seen:
            played.withheld[str(output.reason)] += 1
        if others_px < VISIBLE_MIN_PX:
            continue
        gap = gap_px((labels == label)[::2, ::2], others[::2, ::2])
        if isinstance(output, KeptFrame):  # also where the owner is hardly in view: whom does it show then?
            played.shown.append(Shown(output.sequence, output.alias, output, gap))
        elif seen and output.reason in DOUBTS:
            played.shown.append(Shown(output.sequence, output.alias, None, gap))
    return played


def placed(kept: KeptFrame, shape: tuple[int, ...]) -> Depth:
    return spread_cutout(kept.cutout, shape)


def spread_cutout(out: EncodedCutout, shape: tuple[int, ...]) -> Depth:
    return spread(Cutout(out.x, out.y, decode_depth_png(out.pixels_png)), shape)


def gap_px(owner: Mask, others: Mask) -> float:
    """Between two half-resolution silhouettes; infinite if one is empty."""
    if not owner.any() or not others.any():
        return float("inf")
    away = cv2.distanceTransform((~owner).astype(np.uint8), cv2.DIST_L2, 3)
    return 2 * float(np.asarray(away)[others].min())


def owner_cutout(stage: Stage, depth: Depth, labels: Labels, label: int, *, troubled: bool) -> Depth | None:
    """0 elsewhere; None if the robot would not cut. `troubled`: also accept troubled silhouettes (controls only)."""
    segmented = segment(depth, stage.background, stage.focal_px)
    silhouette = _silhouette_of(segmented, labels, label)
    if silhouette is None or (silhouette.withhold_reason and not troubled):
        return None
    return spread(extract_cutout(depth, stage.background, segmented, silhouette), depth.shape)


def spread(out: Cutout, shape: tuple[int, ...]) -> Depth:
    whole = np.zeros(shape, dtype=np.uint16)
    height, width = out.pixels.shape
    whole[out.y : out.y + height, out.x : out.x + width] = out.pixels
    return whole


def _silhouette_of(segmented: Segmented, labels: Labels, label: int) -> Silhouette | None:
    if segmented.labels is None:
        return None
    own = labels[::2, ::2] == label
    best, best_count = None, 0
    for silhouette in segmented.silhouettes:
        inside = segmented.labels == silhouette.label
        count = int(np.count_nonzero(inside & own))
        if count > best_count and 2 * count > int(np.count_nonzero(inside)):
            best, best_count = silhouette, count
    return best


class Timed:
    """A robot's work per frame, in the redactor's order, timed without encoding."""

    def __init__(self, stage: Stage) -> None:
        self.cpu_ms: list[float] = []
        self.wall_ms: list[float] = []
        self._stage = stage
        self._companions, self._tracker, self._matcher = CompanionWatch(), Tracker(), Matcher()
        self._bearings = AntennaBearings(stage.scene.antenna_pairs)
        self._waiting = sightings(readings(stage.scene.scenario))[::-1]

    def step(self, depth: Depth, at_ms: int) -> None:
        """CPU and wall milliseconds; frames come in time order."""
        background = self._stage.background
        cpu, wall = time.thread_time(), time.perf_counter()
        while self._waiting and self._waiting[-1][0] <= at_ms:
            alias, sighting = self._waiting.pop()[1:]
            self._matcher.add_sighting(alias, self._bearings.locate(alias, sighting))
        silhouettes: tuple[Silhouette, ...] = ()
        if fits(background, depth):
            segmented = segment(depth, background, self._stage.focal_px)
            silhouettes = self._companions.step(segmented.silhouettes, at_ms)
            tracks = self._tracker.step(silhouettes, at_ms)
            for silhouette, track in zip(silhouettes, tracks, strict=True):
                if track is None:
                    continue
                self._matcher.add_track(track)
                if not silhouette.withhold_reason:
                    extract_cutout(depth, background, segmented, silhouette)
        self._matcher.advance(at_ms)
        if not silhouettes:
            return
        self.cpu_ms.append(1000 * (time.thread_time() - cpu))
        self.wall_ms.append(1000 * (time.perf_counter() - wall))

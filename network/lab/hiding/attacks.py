"""Runs every attacker on every way of hiding, on released frames of a scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

from clients.robot.sensing.sensor_events import Depth, Mask
from clients.robot.synthetic.camera import Labels
from network.lab.hiding.hand_made import HAND_MADE
from network.lab.hiding.learned import Example, LearnedAttacker
from network.lab.hiding.run_scene import VISIBLE_MIN_PX, Played, Shown, Stage, Timed, owner_cutout, placed, play
from network.lab.hiding.scenes import Scene, blur_others, show_owner_only
from network.lab.hiding.scoring import iou

FRAMES_A_SCENE_COUNT = 3
DOUBTED_A_SCENE_COUNT = 2
EXAMPLES_A_SCENE_COUNT = 3
COARSE_PX = 2  # who learned from raw pictures sees whole people, not edges: every second pixel does
OURS, CONTROL, NONE, BLUR = "ours", "control", "none", "blur"
ON_RAW, ON_OURS = "learned-raw", "learned-ours"
OURS_NOT_CUT, CONTROL_NOT_CUT = "ours-not-cut", "control-not-cut"


@dataclass(slots=True)
class FrameScore:
    """One frame's recovery of others: (way of hiding, attacker) -> IoU.

    `released` is False if the matcher was in doubt: nothing was shown, but the cut is judged.
    """

    released: bool
    gap_px: float
    owner_kept: float
    foreign_px: int
    ious: dict[tuple[str, str], float] = field(default_factory=dict)


@dataclass(slots=True)
class SceneReport:
    """A judged scene, numbers only. `unattacked`: chosen frames without score, and why."""

    seed: int
    number: int
    stratum: str
    played: Played
    frames: list[FrameScore] = field(default_factory=list)
    unattacked: Counter[str] = field(default_factory=Counter)
    cpu_ms: list[float] = field(default_factory=list)
    wall_ms: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Examples:
    """Training views: originals and as we would release them."""

    raw: list[Example]
    ours: list[Example]


def learn_from(scene: Scene) -> Examples:
    stage, rng = Stage(scene), np.random.default_rng([scene.seed, scene.number, 0xE0])
    found = Examples([], [])
    indices = list(stage.frame_indices())
    for index in rng.permutation(indices)[: 6 * EXAMPLES_A_SCENE_COUNT]:
        if len(found.ours) >= EXAMPLES_A_SCENE_COUNT:
            break
        depth, labels = stage.renderer.frame_with_truth(int(index))
        seen = [label for label in scene.owners.values() if (labels == label).any()]
        label = seen[0] if seen else 1  # a person is taken for the owner even where no bearer is in the picture
        others = (labels > 0) & (labels != label)
        if not (labels == label).any() or np.count_nonzero(others) < VISIBLE_MIN_PX:
            continue
        truth = np.ascontiguousarray(others[::2, ::2])
        if len(found.raw) < EXAMPLES_A_SCENE_COUNT:
            found.raw.append(Example(stage.view(depth, labels == label), truth))
        kept = owner_cutout(stage, depth, labels, label, troubled=False)
        if kept is not None:
            shown = show_owner_only(kept, stage.empty[int(rng.integers(len(stage.empty)))])
            found.ours.append(Example(stage.view(shown, kept > 0), truth))
    return found


def judge_scene(scene: Scene, attackers: Mapping[str, LearnedAttacker]) -> SceneReport:
    stage = Stage(scene)
    timed = Timed(stage)
    played = play(stage, timed)
    report = SceneReport(scene.seed, scene.number, scene.stratum, played, cpu_ms=timed.cpu_ms, wall_ms=timed.wall_ms)
    rng = np.random.default_rng([scene.seed, scene.number, 0xA7])
    released = [one for one in played.shown if one.kept is not None]
    doubted = [one for one in played.shown if one.kept is None]
    for shown in [*choose(released, rng, FRAMES_A_SCENE_COUNT), *choose(doubted, rng, DOUBTED_A_SCENE_COUNT)]:
        score = _attack(stage, shown, attackers, rng)
        if isinstance(score, FrameScore):
            report.frames.append(score)
        else:
            report.unattacked[score] += 1
    played.shown = []
    return report


class _HasGap(Protocol):
    @property
    def gap_px(self) -> float: ...


Near = TypeVar("Near", bound=_HasGap)


def choose(shown: list[Near], rng: np.random.Generator, count: int) -> list[Near]:
    """Return the picture to which another person is nearest, and some more."""
    if not shown:
        return []
    nearest = min(range(len(shown)), key=lambda n: shown[n].gap_px)
    rest = [n for n in rng.permutation(len(shown)).tolist() if n != nearest]
    return [shown[n] for n in sorted([nearest, *rest[: count - 1]])]


def _attack(
    stage: Stage,
    shown: Shown,
    attackers: Mapping[str, LearnedAttacker],
    rng: np.random.Generator,
) -> FrameScore | str:
    label = stage.scene.owners[shown.alias]
    depth, labels = stage.renderer.frame_with_truth(shown.index)
    others = (labels > 0) & (labels != label)
    kept = _rendition(stage, shown, depth, labels)
    alone, alone_labels = stage.control(shown.alias).frame_with_truth(shown.index)
    alone_kept = owner_cutout(stage, alone, alone_labels, label, troubled=True)
    if kept is None:
        return OURS_NOT_CUT
    if alone_kept is None:  # nothing to compare with, such as where the owner is not in the picture
        return CONTROL_NOT_CUT
    empty = stage.empty[int(rng.integers(len(stage.empty)))]
    views = {
        OURS: stage.view(show_owner_only(kept, empty), kept > 0),
        CONTROL: stage.view(show_owner_only(alone_kept, empty), alone_kept > 0),
        NONE: stage.view(depth, kept > 0),
        BLUR: stage.view(blur_others(depth, others), kept > 0),
    }
    measured: Mask = (labels == label) & (depth > 0)
    score = FrameScore(
        released=shown.kept is not None,
        gap_px=shown.gap_px,
        owner_kept=int(np.count_nonzero(measured & (kept > 0))) / max(1, int(np.count_nonzero(measured))),
        foreign_px=int(np.count_nonzero(others & (kept > 0))),
    )
    truth = np.ascontiguousarray(others[::2, ::2])
    for way, view in views.items():
        for name, attack in HAND_MADE.items():
            score.ious[way, name] = iou(attack(view), truth)
        for name, attacker in attackers.items():
            if name == ON_RAW or way in {OURS, CONTROL}:
                every = 1 if name == ON_OURS else COARSE_PX
                score.ious[way, name] = iou(attacker.recover(view, every=every), truth)
    return score


def _rendition(stage: Stage, shown: Shown, depth: Depth, labels: Labels) -> Depth | None:
    if shown.kept is not None:
        return placed(shown.kept, depth.shape)
    return owner_cutout(stage, depth, labels, stage.scene.owners[shown.alias], troubled=False)

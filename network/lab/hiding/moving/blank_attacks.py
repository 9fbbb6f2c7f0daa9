"""Attackers on the blank pictures of a drive, each beside its control: the same drive and noise with nobody else there."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import asdict

from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer, DriveTruth
from network.lab.hiding.attacks import CONTROL, CONTROL_NOT_CUT, ON_OURS, OURS, FrameScore, choose
from network.lab.hiding.figures import GOAL_DIFFERENCE, AttackerRow, Leak, by_attacker, leak_of
from network.lab.hiding.hand_made import HAND_MADE
from network.lab.hiding.learned import Example, LearnedAttacker
from network.lab.hiding.moving.run_drive import Rendition, cut_out, others_of, show_everybody, watch
from network.lab.hiding.run_scene import spread_cutout
from network.lab.hiding.scenes import View, half_view
from network.lab.hiding.scoring import iou, mean_of, share_of, upper_bound

RELEASED_A_DRIVE_COUNT = 6
WITHHELD_A_DRIVE_COUNT = 3
EXAMPLES_A_DRIVE_COUNT = 6
WARM_UP_FRAMES_COUNT = 20  # before a control: ground and scans follow from the frames before
BY_HAND = ("bite", "outline")  # the others need the empty scene


@dataclass(slots=True)
class BlankScore(FrameScore):
    """`outline_iou`: of the owner's outline with that of the control; `identical`: every pixel is as in the control."""

    outline_iou: float = 0.0
    identical: bool = False


@dataclass(slots=True)
class BlankReport:
    """The attacked pictures of one drive. `unattacked`: chosen ones without a control."""

    frames: list[BlankScore] = field(default_factory=list)
    unattacked: Counter[str] = field(default_factory=Counter)


class BlankFigures(Leak, kw_only=True):
    """Of released pictures with somebody else in view; `withheld_attackers`: of pictures that only an obstacle withheld,
    which tells whether the attackers find anything at all.

    `identical`: share of pictures that are, pixel by pixel, as if nobody else were there: no attacker tells them apart.
    `found_scenes`: those with a picture from which an attacker gets more than the goal allows beyond its control.
    """

    frames_not_attacked: dict[str, int]
    found_scenes: int
    found_scenes_upper95: float
    identical: float | None
    outline_iou: float | None
    outline_iou_min: float | None
    attackers: dict[str, AttackerRow]
    withheld_frames: int
    withheld_outline_iou: float | None
    withheld_attackers: dict[str, AttackerRow]


def blank_view(kept: Depth) -> View:
    """A picture without surroundings. As the empty scene, attackers get the owner's middle distance in their outline."""
    owner = kept > 0
    middle = np.uint16(np.median(kept[owner])) if owner.any() else np.uint16(0)
    return half_view(kept, np.where(owner, middle, np.uint16(0)), owner)


def learn_from_drive(drive: Drive) -> list[Example]:
    """Of released pictures with somebody else in view."""
    rng, renderer = np.random.default_rng([drive.scenario.seed, 0xE1]), DriveRenderer(drive)
    near = [one for one in show_everybody(drive) if one.released and math.isfinite(one.gap_px)]
    found = []
    for one in choose(near, rng, EXAMPLES_A_DRIVE_COUNT):
        truth = renderer.truth(one.sequence)
        others = np.ascontiguousarray(others_of(truth, one.number)[::2, ::2])
        found.append(Example(blank_view(spread_cutout(one.cutout, truth.depth.shape)), others))
    return found


def attack_drive(drive: Drive, renditions: Sequence[Rendition], attacker: LearnedAttacker) -> BlankReport:
    rng, renderer, report = np.random.default_rng([drive.scenario.seed, 0xA8]), DriveRenderer(drive), BlankReport()
    near = [one for one in renditions if math.isfinite(one.gap_px)]
    chosen = choose([one for one in near if one.released], rng, RELEASED_A_DRIVE_COUNT)
    chosen += choose([one for one in near if not one.released], rng, WITHHELD_A_DRIVE_COUNT)
    controls = _controls(drive, chosen)
    for one in chosen:
        control = controls.get((one.number, one.sequence))
        if control is None:
            report.unattacked[CONTROL_NOT_CUT] += 1
        else:
            report.frames.append(_attack(one, control, renderer.truth(one.sequence), attacker))
    return report


def _controls(drive: Drive, chosen: Sequence[Rendition]) -> dict[tuple[int, int], Depth]:
    """Whatever the moving hider cuts out of these frames where nobody else is there, also what it would withhold."""
    found = {}
    aliases = [person.alias for person in drive.scenario.people]
    for number in sorted({one.number for one in chosen}):
        sequences = {one.sequence for one in chosen if one.number == number}
        alone = drive.without(*(alias for place, alias in enumerate(aliases, start=1) if place != number))
        frames = range(max(0, min(sequences) - WARM_UP_FRAMES_COUNT), max(sequences) + 1)
        for index, truth, seen in watch(alone, frames):
            if index not in sequences or seen is None:
                continue
            cuts = [cut_out(seen, silhouette, truth, index) for silhouette in seen.silhouettes]
            own = [cut for cut in cuts if cut.number == number]
            if own:
                largest = max(own, key=lambda cut: cut.shown.size)
                found[number, index] = spread_cutout(largest.cutout, truth.depth.shape)
    return found


def _attack(one: Rendition, control: Depth, truth: DriveTruth, attacker: LearnedAttacker) -> BlankScore:
    kept = spread_cutout(one.cutout, truth.depth.shape)
    others, measured = others_of(truth, one.number), (truth.labels == one.number) & (truth.depth > 0)
    score = BlankScore(
        released=one.released,
        gap_px=one.gap_px,
        owner_kept=int(np.count_nonzero(measured & (kept > 0))) / max(1, int(np.count_nonzero(measured))),
        foreign_px=int(np.count_nonzero(others & (kept > 0))),
        outline_iou=iou(kept > 0, control > 0),
        identical=bool((kept == control).all()),
    )
    hidden = np.ascontiguousarray(others[::2, ::2])
    for way, picture in ((OURS, kept), (CONTROL, control)):
        view = blank_view(picture)
        score.ious |= {(way, name): iou(HAND_MADE[name](view), hidden) for name in BY_HAND}
        score.ious[way, ON_OURS] = iou(attacker.recover(view), hidden)
    return score


def summarise_attacks(reports: Sequence[BlankReport], seed: int) -> BlankFigures:
    """`reports`: one for each drive; those without a picture to attack count for no bound."""
    released, withheld = (_scenes(reports, released=way) for way in (True, False))
    frames = [frame for scene in released for frame in scene]
    found = sum(any(_is_found(frame) for frame in scene) for scene in released)
    unattacked = sum((report.unattacked for report in reports), Counter[str]())
    return BlankFigures(
        **asdict(leak_of(released, seed)),
        frames_not_attacked=dict(unattacked),
        found_scenes=found,
        found_scenes_upper95=round(upper_bound(found, len(released)), 4),
        identical=share_of(sum(frame.identical for frame in frames), len(frames)),
        outline_iou=mean_of([frame.outline_iou for frame in frames]),
        outline_iou_min=round(min(frame.outline_iou for frame in frames), 4) if frames else None,
        attackers=by_attacker(released, seed),
        withheld_frames=sum(len(scene) for scene in withheld),
        withheld_outline_iou=mean_of([statistics.fmean(frame.outline_iou for frame in scene) for scene in withheld]),
        withheld_attackers=by_attacker(withheld, seed),
    )


def _scenes(reports: Sequence[BlankReport], *, released: bool) -> list[list[BlankScore]]:
    scenes = [[frame for frame in report.frames if frame.released == released] for report in reports]
    return [scene for scene in scenes if scene]


def _is_found(frame: BlankScore) -> bool:
    return any(frame.ious[OURS, name] - frame.ious[CONTROL, name] > GOAL_DIFFERENCE for name in (*BY_HAND, ON_OURS))

"""The judge's figures from per-scene numbers; each stratum is listed, never averaged away."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Sequence

from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import asdict

from network.lab.hiding.attacks import BLUR, CONTROL, NONE, OURS, FrameScore, SceneReport
from network.lab.hiding.gait import GaitReport
from network.lab.hiding.scoring import mean_of, paired_bound, share_of

Scenes = Sequence[Sequence[FrameScore]]

GOAL_DIFFERENCE = 0.02
GOAL_REID = 0.05
GOAL_KEPT = 0.97
GOAL_FRAME_MS = 10.0
GOAL_FOREIGN_SHARE = 0.001  # of the others' visible pixels, in any one rendition


class AttackerRow(Struct, frozen=True, kw_only=True):
    """Mean IoU of one attacker, by what was done to the pictures; null where nothing was attacked."""

    none: float | None
    blur: float | None
    ours: float | None
    control: float | None
    difference: float
    difference_upper95: float


class Leak(Struct, kw_only=True):
    """What attackers recovered from the frames of some scenes; null where nothing was attacked."""

    attacked_scenes: int
    attacked_frames: int
    attacker_iou: float | None
    control_iou: float | None
    difference: float | None
    difference_upper95: float | None
    no_hiding_iou: float | None
    blur_iou: float | None
    owner_pixels_kept: float | None
    foreign_pixels_shown: float | None


class SceneFigures(Leak, kw_only=True):
    """Also what was kept and withheld in them."""

    scenes: int
    cut_attacked_frames: int
    cut_difference_upper95: float | None
    cut_owner_pixels_kept: float | None
    kept: int
    wrong_owner_rate: float | None
    foreign_px_max: int | None
    foreign_share_max: float | None
    scenes_not_attacked: int
    frames_not_attacked: dict[str, int]
    withheld_rate: float | None
    withheld: dict[str, int]


class HidingFigures(SceneFigures, kw_only=True):
    """All scenes and gaits, each attacker and stratum, the goals, and the parts that were asked for."""

    reid_rate: float | None
    chance_rate: float | None
    reid_control: float | None
    reid_no_hiding: float | None
    reid_blur: float | None
    reid_clips: int
    reid_released_rate: float | None
    reid_foreign_share_max: float | None
    reid_nothing_recovered: float | None
    frame_ms: float | None
    frame_wall_ms: float | None
    attackers: dict[str, AttackerRow]
    cut_attackers: dict[str, AttackerRow]
    strata: dict[str, SceneFigures]
    goals: dict[str, bool] = {}
    matcher: dict[str, float] | UnsetType = UNSET
    companions: dict[str, float | None] | UnsetType = UNSET


def summarise(reports: Sequence[SceneReport], gaits: Sequence[GaitReport], *, seed: int) -> HidingFigures:
    cpu = [value for report in reports for value in report.cpu_ms]
    wall = [value for report in reports for value in report.wall_ms]
    clips = sum(report.clips.get(OURS, 0) for report in gaits)
    figures = HidingFigures(
        **asdict(_of(reports, seed)),
        reid_rate=share_of_right(gaits, OURS),
        chance_rate=mean_of([1 / report.people for report in gaits]),
        reid_control=share_of_right(gaits, CONTROL),
        reid_no_hiding=share_of_right(gaits, NONE),
        reid_blur=share_of_right(gaits, BLUR),
        reid_clips=clips,
        reid_released_rate=share_of(sum(r.released for r in gaits), sum(r.frames for r in gaits)),
        reid_foreign_share_max=round(max(r.foreign_share for r in gaits), 5) if gaits else None,
        reid_nothing_recovered=share_of(sum(report.blind.get(OURS, 0) for report in gaits), clips),
        frame_ms=round(statistics.median(cpu), 2) if cpu else None,
        frame_wall_ms=round(statistics.median(wall), 2) if wall else None,
        attackers=by_attacker(_attacked(reports, released=True), seed),
        cut_attackers=by_attacker(_attacked(reports, released=False), seed),
        strata={
            name: _of([report for report in reports if report.stratum == name], seed)
            for name in sorted({report.stratum for report in reports})
        },
    )
    figures.goals = goals(figures)
    return figures


def goals(figures: HidingFigures) -> dict[str, bool]:
    def at_most(value: float | None, limit: float) -> bool:
        return value is not None and value <= limit

    return {
        "difference_upper95 <= 0.02": at_most(figures.difference_upper95, GOAL_DIFFERENCE),
        "reid_rate <= chance_rate + 0.05": at_most(figures.reid_rate, (figures.chance_rate or 0.0) + GOAL_REID),
        "wrong_owner_rate == 0": at_most(figures.wrong_owner_rate, 0.0),
        "foreign_share_max <= 0.001": at_most(figures.foreign_share_max, GOAL_FOREIGN_SHARE),
        "reid_foreign_share_max <= 0.001": at_most(figures.reid_foreign_share_max, GOAL_FOREIGN_SHARE),
        "owner_pixels_kept >= 0.97": (figures.owner_pixels_kept or 0.0) >= GOAL_KEPT,
        "frame_ms <= 10": at_most(figures.frame_ms, GOAL_FRAME_MS),
    }


def by_attacker(scenes: Scenes, seed: int) -> dict[str, AttackerRow]:
    names = sorted({name for frames in scenes for frame in frames for _, name in frame.ious})
    table = {}
    for name in names:
        bound = paired_bound(_differences(scenes, name), seed=seed)
        table[name] = AttackerRow(
            **{way: mean_of(_scene_means(scenes, way, name)) for way in (NONE, BLUR, OURS, CONTROL)},
            difference=round(bound.mean, 4),
            difference_upper95=round(bound.upper, 4),
        )
    return table


def _attacked(reports: Sequence[SceneReport], *, released: bool) -> Scenes:
    scenes = [[frame for frame in report.frames if frame.released or not released] for report in reports]
    return [frames for frames in scenes if frames]


def leak_of(scenes: Scenes, seed: int) -> Leak:
    attackers = by_attacker(scenes, seed).values()
    worst = max(attackers, key=lambda row: (row.difference_upper95, row.ours or 0.0), default=None)
    frames = [frame for some in scenes for frame in some]
    return Leak(
        attacked_scenes=len(scenes),
        attacked_frames=len(frames),
        attacker_iou=worst.ours if worst else None,
        control_iou=worst.control if worst else None,
        difference=worst.difference if worst else None,
        difference_upper95=worst.difference_upper95 if worst else None,
        no_hiding_iou=max((row.none for row in attackers if row.none is not None), default=None),
        blur_iou=max((row.blur for row in attackers if row.blur is not None), default=None),
        owner_pixels_kept=mean_of([frame.owner_kept for frame in frames]),
        foreign_pixels_shown=mean_of([float(frame.foreign_px) for frame in frames]),
    )


def _of(reports: Sequence[SceneReport], seed: int) -> SceneFigures:
    played = [report.played for report in reports]
    kept, wrong = sum(p.kept for p in played), sum(p.wrong for p in played)
    visible = sum(p.visible for p in played)
    reasons = _sum_of(one.withheld for one in played)
    cutouts = leak_of(_attacked(reports, released=False), seed)
    return SceneFigures(
        scenes=len(reports),
        **asdict(leak_of(_attacked(reports, released=True), seed)),
        cut_attacked_frames=cutouts.attacked_frames,
        cut_difference_upper95=cutouts.difference_upper95,
        cut_owner_pixels_kept=cutouts.owner_pixels_kept,
        kept=kept,
        wrong_owner_rate=share_of(wrong, kept),
        foreign_px_max=max((p.foreign_px for p in played), default=0) if kept else None,
        foreign_share_max=round(max((p.foreign_share for p in played), default=0.0), 5) if kept else None,
        scenes_not_attacked=sum(not report.frames for report in reports),
        frames_not_attacked=_sum_of(report.unattacked for report in reports),
        withheld_rate=share_of(sum(reasons.values()), visible),
        withheld=reasons,
    )


def _sum_of(counts: Iterable[Counter[str]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for some in counts:
        total.update(some)
    return dict(sorted(total.items()))


def _scene_means(scenes: Scenes, way: str, name: str) -> list[float]:
    means = []
    for frames in scenes:
        values = [frame.ious[way, name] for frame in frames if (way, name) in frame.ious]
        if values:
            means.append(statistics.fmean(values))
    return means


def _differences(scenes: Scenes, name: str) -> list[float]:
    return [statistics.fmean(frame.ious[OURS, name] - frame.ious[CONTROL, name] for frame in some) for some in scenes]


def share_of_right(gaits: Sequence[GaitReport], way: str) -> float | None:
    clips = sum(report.clips.get(way, 0) for report in gaits)
    return round(sum(report.right.get(way, 0.0) for report in gaits) / clips, 4) if clips else None

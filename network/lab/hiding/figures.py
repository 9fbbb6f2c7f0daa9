"""The judge's figures from per-scene numbers. Pure; each stratum is listed, never averaged away."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from network.lab.hiding.attacks import BLUR, CONTROL, NONE, OURS, FrameScore, SceneReport
from network.lab.hiding.gait import GaitReport
from network.lab.hiding.scoring import mean_of, paired_bound, share_of

Scenes = Sequence[Sequence[FrameScore]]

GOAL_DIFFERENCE = 0.02
GOAL_REID = 0.05
GOAL_KEPT = 0.97
GOAL_FRAME_MS = 10.0
GOAL_FOREIGN_SHARE = 0.001  # of the others' visible pixels, in any one rendition


def summarise(reports: Sequence[SceneReport], gaits: Sequence[GaitReport], *, seed: int) -> dict[str, Any]:
    overall = _of(reports, seed)
    cpu = [value for report in reports for value in report.cpu_ms]
    wall = [value for report in reports for value in report.wall_ms]
    figures: dict[str, Any] = {
        **overall,
        **_reid(gaits),
        "frame_ms": round(statistics.median(cpu), 2) if cpu else None,
        "frame_wall_ms": round(statistics.median(wall), 2) if wall else None,
        "attackers": by_attacker(_attacked(reports, released=True), seed),
        "cut_attackers": by_attacker(_attacked(reports, released=False), seed),
        "strata": {
            name: _of([report for report in reports if report.stratum == name], seed)
            for name in sorted({report.stratum for report in reports})
        },
    }
    figures["goals"] = goals(figures)
    return figures


def goals(figures: dict[str, Any]) -> dict[str, bool]:
    def at_most(name: str, limit: float) -> bool:
        return figures[name] is not None and figures[name] <= limit

    return {
        "difference_upper95 <= 0.02": at_most("difference_upper95", GOAL_DIFFERENCE),
        "reid_rate <= chance_rate + 0.05": at_most("reid_rate", (figures["chance_rate"] or 0.0) + GOAL_REID),
        "wrong_owner_rate == 0": at_most("wrong_owner_rate", 0.0),
        "foreign_share_max <= 0.001": at_most("foreign_share_max", GOAL_FOREIGN_SHARE),
        "reid_foreign_share_max <= 0.001": at_most("reid_foreign_share_max", GOAL_FOREIGN_SHARE),
        "owner_pixels_kept >= 0.97": (figures["owner_pixels_kept"] or 0.0) >= GOAL_KEPT,
        "frame_ms <= 10": at_most("frame_ms", GOAL_FRAME_MS),
    }


def by_attacker(scenes: Scenes, seed: int) -> dict[str, dict[str, Any]]:
    names = sorted({name for frames in scenes for frame in frames for _, name in frame.ious})
    table = {}
    for name in names:
        row: dict[str, Any] = {}
        for way in (NONE, BLUR, OURS, CONTROL):
            row[way] = mean_of(_scene_means(scenes, way, name))
        bound = paired_bound(_differences(scenes, name), seed=seed)
        row |= {"difference": round(bound.mean, 4), "difference_upper95": round(bound.upper, 4)}
        table[name] = row
    return table


def _attacked(reports: Sequence[SceneReport], *, released: bool) -> Scenes:
    scenes = [[frame for frame in report.frames if frame.released or not released] for report in reports]
    return [frames for frames in scenes if frames]


def _leak(scenes: Scenes, seed: int) -> dict[str, Any]:
    attackers = by_attacker(scenes, seed)
    worst = max(attackers.values(), key=lambda row: (row["difference_upper95"], row[OURS] or 0.0), default=None)

    def best(way: str) -> float | None:
        return max((row[way] for row in attackers.values() if row[way] is not None), default=None)

    frames = [frame for some in scenes for frame in some]
    return {
        "attacked_scenes": len(scenes),
        "attacked_frames": len(frames),
        "attacker_iou": worst[OURS] if worst else None,
        "control_iou": worst[CONTROL] if worst else None,
        "difference": worst["difference"] if worst else None,
        "difference_upper95": worst["difference_upper95"] if worst else None,
        "no_hiding_iou": best(NONE),
        "blur_iou": best(BLUR),
        "owner_pixels_kept": mean_of([frame.owner_kept for frame in frames]),
        "foreign_pixels_shown": mean_of([float(frame.foreign_px) for frame in frames]),
    }


def _of(reports: Sequence[SceneReport], seed: int) -> dict[str, Any]:
    played = [report.played for report in reports]
    kept, wrong = sum(p.kept for p in played), sum(p.wrong for p in played)
    visible = sum(p.visible for p in played)
    reasons = _sum_of(one.withheld for one in played)
    cuts = _leak(_attacked(reports, released=False), seed)
    return {
        "scenes": len(reports),
        **_leak(_attacked(reports, released=True), seed),
        "cut_attacked_frames": cuts["attacked_frames"],
        "cut_difference_upper95": cuts["difference_upper95"],
        "cut_owner_pixels_kept": cuts["owner_pixels_kept"],
        "kept": kept,
        "wrong_owner_rate": share_of(wrong, kept),
        "foreign_px_max": max((p.foreign_px for p in played), default=0) if kept else None,
        "foreign_share_max": round(max((p.foreign_share for p in played), default=0.0), 5) if kept else None,
        "scenes_not_attacked": sum(not report.frames for report in reports),
        "frames_not_attacked": _sum_of(report.unattacked for report in reports),
        "withheld_rate": share_of(sum(reasons.values()), visible),
        "withheld": reasons,
    }


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


def _reid(gaits: Sequence[GaitReport]) -> dict[str, Any]:
    def rate(way: str) -> float | None:
        return share_of_right(gaits, way)

    chance = mean_of([1 / report.people for report in gaits])
    clips = sum(report.clips.get(OURS, 0) for report in gaits)
    return {
        "reid_rate": rate(OURS),
        "chance_rate": chance,
        "reid_control": rate(CONTROL),
        "reid_no_hiding": rate(NONE),
        "reid_blur": rate(BLUR),
        "reid_clips": clips,
        "reid_released_rate": share_of(sum(r.released for r in gaits), sum(r.frames for r in gaits)),
        "reid_foreign_share_max": round(max(r.foreign_share for r in gaits), 5) if gaits else None,
        "reid_nothing_recovered": share_of(sum(report.blind.get(OURS, 0) for report in gaits), clips),
    }


def share_of_right(gaits: Sequence[GaitReport], way: str) -> float | None:
    clips = sum(report.clips.get(way, 0) for report in gaits)
    return round(sum(report.right.get(way, 0.0) for report in gaits) / clips, 4) if clips else None

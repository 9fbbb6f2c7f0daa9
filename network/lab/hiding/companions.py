"""Judges the companion cues on scenes unseen in training, by ground truth.

No scene is from training seeds, and every silhouette with a second person counts.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clients.robot.hiding.background import Background, learn_background
from clients.robot.hiding.companion import measure
from clients.robot.hiding.companion_watch import CompanionWatch
from clients.robot.hiding.segmentation import segment
from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.camera import Labels
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Manner, Scenario
from clients.robot.synthetic.scenes import Stratum, draw_scene
from network.bench.conditions import Result, measure_conditions
from network.bench.processes import worker_pool
from network.lab.hiding.scoring import mean_of

BACKGROUND_FRAMES_COUNT = 7
SECOND_PERSON_SHARE = 0.06  # of a silhouette's pixels: from here on it is a companion to learn from
ALONE_SHARE = 0.015  # up to here it holds one person; from here on it is judged as two
SEED_STRIDE = 1_000_000  # the bench's seed 0 draws scenes from 1,000,000 on; training stays below
SEEDS_A_KIND = 100_000
SINGLE_FACTOR = 4  # a rate of 1 % asks for more of them
TRACK_FRAMES_COUNT, TRACK_STEP_FRAMES = 8, 2
SCENES_DEFAULT_COUNT = 12

# What is judged: name, stratum, manner and whether the companion is a child.
COMPANIONS: tuple[tuple[str, Stratum, Manner | None, bool | None], ...] = (
    ("arm in arm", "companion", "arm-in-arm", False),
    ("embrace", "companion", "embrace", False),
    ("pushing", "companion", "pushing", False),
    ("close behind", "companion", "close-behind", False),
    ("child by the hand", "companion", "arm-in-arm", True),
)
SINGLES: tuple[tuple[str, Stratum, Manner | None, bool | None], ...] = (
    ("single", "single", None, None),
    ("wheelchair", "wheelchair", None, None),
    ("rollator", "rollator", None, None),
    ("stick", "stick", None, None),
    ("iv pole", "iv-pole", None, None),
    ("child alone", "child", None, None),
)
Rates = Mapping[str, Mapping[str, float | None]]
GOAL_FOUND, GOAL_FALSE, GOAL_AIDS = 0.90, 0.01, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """One silhouette: cues, owner (label of most pixels), second person's share."""

    frame: int
    person: int
    second_share: float
    withhold_reason: str
    cues: npt.NDArray[np.float64]


def observe(scenario: Scenario, frames: Iterable[int], watch: CompanionWatch | None = None) -> Iterator[Observed]:
    """Yield a scene's silhouettes, without those of no person; `watch` needs time order."""
    renderer = Renderer(scenario)
    background = learn_background([renderer.empty_frame(i) for i in range(BACKGROUND_FRAMES_COUNT)])
    for index in frames:
        truth = renderer.truth(index)
        yield from observe_frame(
            index,
            truth.depth,
            truth.labels,
            background,
            focal_px=scenario.focal_px,
            watch=watch,
            at_ms=round(index * 1000 / scenario.frame_rate),
        )


def observe_frame(
    index: int,
    depth: Depth,
    labels: Labels,
    background: Background,
    *,
    focal_px: float,
    watch: CompanionWatch | None = None,
    at_ms: int = 0,
) -> Iterator[Observed]:
    found = segment(depth, background, focal_px)
    half, people_of = np.ascontiguousarray(depth[::2, ::2]), labels[::2, ::2]
    seen = found.silhouettes if watch is None else watch.step(found.silhouettes, at_ms)
    for silhouette in seen:
        assert found.labels is not None
        left, top, width, height = silhouette.box
        box = (slice(top, top + height), slice(left, left + width))
        inside = found.labels[box] == silhouette.label
        whose = np.bincount(people_of[box][inside], minlength=3)
        people = np.sort(whose[1:])[::-1]
        if 2 * people.sum() < whose.sum():
            continue
        cues = measure(inside, half[box], left, top, half.shape, focal_px / 2)
        share = float(people[1] / whose.sum())
        yield Observed(index, int(whose[1:].argmax()) + 1, share, silhouette.withhold_reason, cues)


def _look(job: tuple[str, Stratum, Manner | None, bool | None, int]) -> tuple[str, int, list[Observed]]:
    name, stratum, manner, child, seed = job
    scenario = draw_scene(seed, stratum, manner=manner, child=child, third=False)
    rng = np.random.default_rng([seed, 0x10CC])
    first = int(rng.integers(scenario.frame_count - TRACK_FRAMES_COUNT * TRACK_STEP_FRAMES))
    frames = range(first, first + TRACK_FRAMES_COUNT * TRACK_STEP_FRAMES, TRACK_STEP_FRAMES)
    return name, seed, list(observe(scenario, frames, CompanionWatch()))


class CompanionsResult(Result[dict[str, float | None]], kw_only=True):
    """`strata`: more of each kind."""

    strata: dict[str, dict[str, float | None]]


def judge_companions(
    seed: int = 1, *, scenes: int = SCENES_DEFAULT_COUNT, workers: int | None = None, on: str = ""
) -> CompanionsResult:
    """Return how often companions are found and single people taken for two.

    `scenes` per kind, four times as many of single people without aid. Per stratum: `merged_frames` and `merged_tracks`
    are withheld shares, `shown_share` is two people shown (`faint_shown`: second below 6 %), `split_share` one person
    after all.
    """
    conditions = measure_conditions(nodes=0, seed=seed, scenes_a_kind=scenes, frames_a_scene=TRACK_FRAMES_COUNT)
    jobs = [
        (*kind, SEED_STRIDE * (seed + 1) + SEEDS_A_KIND * number + scene)
        for number, kind in enumerate((*COMPANIONS, *SINGLES))
        for scene in range(scenes * (SINGLE_FACTOR if kind[0] == "single" else 1))
    ]
    with worker_pool(workers or os.cpu_count() or 1, on) as pool:
        seen = list(pool.map(_look, jobs, chunksize=4))
    companions = {kind[0]: rates(kind[0], seen, pairs=True) for kind in COMPANIONS}
    singles = {kind[0]: rates(kind[0], seen, pairs=False) for kind in SINGLES}
    met = goals_met(companions, singles)
    every = {**companions, **singles}
    figures = {f"{name.replace(' ', '_')}_merged": kind["merged_frames"] for name, kind in every.items()}
    return CompanionsResult(
        name="companions",
        ok=all(met.values()),
        figures={**figures, **met},
        conditions=conditions,
        strata=every,
    )


def rates(name: str, seen: list[tuple[str, int, list[Observed]]], *, pairs: bool) -> dict[str, float | None]:
    tracks: dict[tuple[int, int], list[Observed]] = {}
    split = total = 0
    for kind, seed, observed in seen:
        if kind != name:
            continue
        for one in observed:
            total += 1
            if (one.second_share >= ALONE_SHARE) if pairs else (one.second_share <= ALONE_SHARE):
                tracks.setdefault((seed, one.person), []).append(one)
            else:
                split += 1
    frames = [one for track in tracks.values() for one in track]
    merged = [one.withhold_reason == "merged" for one in frames]
    figures: dict[str, float | None] = {
        "frames": len(frames),
        "tracks": len(tracks),
        "merged_frames": mean_of(merged),
        "merged_tracks": mean_of([any(one.withhold_reason == "merged" for one in track) for track in tracks.values()]),
    }
    if pairs:
        figures["split_share"] = round(split / total, 4) if total else None
        figures["shown_share"] = mean_of([one.withhold_reason == "" for one in frames])
        figures["faint_shown"] = sum(
            one.withhold_reason == "" and one.second_share < SECOND_PERSON_SHARE for one in frames
        )
    else:
        figures["withheld_frames"] = mean_of([one.withhold_reason != "" for one in frames])
    return figures


def goals_met(companions: Rates, singles: Rates) -> dict[str, bool]:
    wanted = [companions[name]["merged_frames"] for name in ("arm in arm", "embrace", "pushing")]
    alone = singles["single"]["merged_frames"]
    aids = [singles[name]["merged_frames"] for name in ("wheelchair", "rollator")]
    return {
        "companions_found": all(rate is not None and rate >= GOAL_FOUND for rate in wanted),
        "single_false_alarms": alone is not None and alone <= GOAL_FALSE,
        "aids_not_taken_for_companions": all(rate is not None and rate <= GOAL_AIDS for rate in aids),
    }

"""Trains the companion model on synthetic scenes and drives and writes the robot's model file.

A scene has one room; of a drive the frames before the robot sets off count: furniture, a camera that leans, flying pixels.
Thresholds are set by scenes.

    python -m network.lab.hiding.companion_training --out clients/robot/hiding/companion-model.json

Needs `[attack]` (scikit-learn); deterministic. Its seeds lie below those of `network.lab.hiding.companions`, and its drives
are not drawn as judged ones are, so that nothing judged is trained on.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec.structs import replace as with_fields

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.companion import CUES, Table, trees_of
from clients.robot.synthetic.driving.draws import DriveStratum, draw_drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer
from clients.robot.synthetic.scenes import Stratum, draw_scene
from network.bench.processes import worker_pool
from network.lab.hiding.companions import (
    ALONE_SHARE,
    SECOND_PERSON_SHARE,
    SEED_STRIDE,
    Observed,
    observe,
    observe_frame,
)
from network.lab.hiding.moving.run_drive import EMPTY_FRAMES_COUNT, whom
from network.lab.hiding.moving.samples import depth_of

TRAINING_SEED, THRESHOLD_SEED = 100_000, 500_000
DRIVES_SEED = 700_000
SCENES_DEFAULT_COUNT, DRIVES_DEFAULT_COUNT = 1_000, 2_000
FRAMES_COUNT = 6
STANDS_S, STANDING_FRAMES_COUNT = 8.0, 8
NOISE_SEED = 1
TREES_COUNT, TREE_DEPTH, LEARNING_RATE, LEAF_MIN_COUNT = 400, 4, 0.08, 10
SCENE_WEIGHT = 3.0  # there are three times as many silhouettes of drives
SUSPECT_FALSE_SHARE, CERTAIN_FALSE_SHARE = 0.004, 0.001
AID_STRATA = ("wheelchair", "rollator")
AID_FALSE_SHARE = 0.04
DIGITS = 6
# One round of strata; the scene's number chooses.
ROUND: tuple[Stratum, ...] = (
    "companion",
    "single",
    "wheelchair",
    "companion",
    "single",
    "rollator",
    "companion",
    "single",
    "iv-pole",
    "companion",
    "single",
    "child",
    "apart",
    "companion",
    "single",
    "rollator",
    "companion",
    "single",
    "iv-pole",
    "stick",
    "crossing",
    "single",
    "touching",
    "rollator",
    "wheelchair",
)

# The same of drives; places follow those of scenes.
DRIVES_ROUND: tuple[DriveStratum, ...] = (
    "companions",
    "companions",
    "straight",
    "companions",
    "aids",
    "companions",
    "bed",
    "companions",
    "glass",
    "companions",
    "crowd",
    "aids",
    "companions",
    "time-of-flight",
    "companions",
    "past",
    "curve",
    "companions",
    "aids",
    "companions",
)

Floats = npt.NDArray[np.float64]
Sampled = list[tuple[int, bool, Floats]]
Collected = tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], Floats]
"""The place of each silhouette's stratum, whether it is two people, and its cues."""


def sample(seed: int) -> Sampled:
    stratum = ROUND[seed % len(ROUND)]
    scenario = replace(draw_scene(seed, stratum), seed=NOISE_SEED)  # one camera's noise, made once
    rng = np.random.default_rng([seed, 0x7A1E])
    frames = sorted(int(i) for i in rng.choice(scenario.frame_count, FRAMES_COUNT, replace=False))
    return _told_apart(seed % len(ROUND), observe(scenario, frames))


def sample_drive(seed: int) -> Sampled:
    place = seed % len(DRIVES_ROUND)
    drive = draw_drive(seed, DRIVES_ROUND[place], judging=False, stands_s=STANDS_S)
    renderer, scenario = DriveRenderer(drive), drive.scenario
    background = learn_background([renderer.empty_frame(number) for number in range(1, EMPTY_FRAMES_COUNT + 1)])
    rng = np.random.default_rng([seed, 0x7A1F])
    rows: Sampled = []
    for index in sorted(
        int(i) for i in rng.choice(round(STANDS_S * scenario.frame_rate), STANDING_FRAMES_COUNT, replace=False)
    ):
        truth = renderer.truth(index)
        found = observe_frame(index, depth_of(drive, truth), whom(truth), background, focal_px=scenario.focal_px)
        rows += _told_apart(len(ROUND) + place, found)
    return rows


def _told_apart(place: int, observed: Iterable[Observed]) -> Sampled:
    return [
        (place, one.second_share >= SECOND_PERSON_SHARE, one.cues)
        for one in observed
        if not ALONE_SHARE < one.second_share < SECOND_PERSON_SHARE
    ]


def collect(look: Callable[[int], Sampled], first: int, count: int, workers: int) -> Collected:
    with worker_pool(workers) as pool:
        rows = [row for made in pool.map(look, range(first, first + count), chunksize=8) for row in made]
    return (
        np.array([row[0] for row in rows], dtype=np.int64),
        np.array([row[1] for row in rows], dtype=np.bool_),
        np.array([row[2] for row in rows], dtype=np.float64).round(DIGITS),
    )


def train(scenes: Collected, drives: Collected) -> Table:
    labels, cues = np.concatenate([scenes[1], drives[1]]), np.concatenate([scenes[2], drives[2]])
    weights = np.where(np.arange(labels.size) < scenes[1].size, SCENE_WEIGHT, 1.0)
    return boost(labels, cues, CUES, weights)


def boost(
    labels: npt.NDArray[np.bool_], cues: Floats, names: Sequence[str], weights: Floats | None = None, **options: float
) -> Table:
    """Boosted trees that tell log-odds of a label; `options` change the learner's."""
    from sklearn.ensemble import GradientBoostingClassifier  # noqa: PLC0415 - the optional extra, only when used

    chosen = {"n_estimators": TREES_COUNT, "min_samples_leaf": LEAF_MIN_COUNT, "subsample": 0.7, "max_features": 0.4}
    model = GradientBoostingClassifier(
        max_depth=TREE_DEPTH, learning_rate=LEARNING_RATE, random_state=1, **{**chosen, **options}
    ).fit(cues.astype(np.float32), labels, sample_weight=weights)
    trees = [estimator.tree_ for estimator in model.estimators_[:, 0]]
    width = max(tree.node_count for tree in trees)
    prior = float(np.average(labels, weights=weights))
    first = round(float(np.log(prior / (1 - prior))), DIGITS)
    table = Table(
        cues=list(names), depth=TREE_DEPTH, first=first, feature=[], threshold=[], left=[], right=[], value=[]
    )
    for tree in trees:
        leaf = tree.children_left < 0
        own = np.arange(tree.node_count)
        rows = {
            "feature": np.where(leaf, 0, tree.feature),
            "threshold": np.where(leaf, 0.0, tree.threshold).round(DIGITS),
            "left": np.where(leaf, own, tree.children_left),
            "right": np.where(leaf, own, tree.children_right),
            "value": (LEARNING_RATE * tree.value[:, 0, 0] * leaf).round(DIGITS),
        }
        for name, row in rows.items():
            getattr(table, name).append([*row.tolist(), *[0] * (width - tree.node_count)])
    return table


def with_thresholds(table: Table, strata: npt.NDArray[np.int64], labels: npt.NDArray[np.bool_], cues: Floats) -> Table:
    trees = trees_of(table)
    odds = np.array([trees.log_odds(row) for row in cues])
    suspect = max(
        _reached_by(odds[~labels], strata[~labels], ("single",), SUSPECT_FALSE_SHARE),
        *(_reached_by(odds[~labels], strata[~labels], (name,), AID_FALSE_SHARE) for name in AID_STRATA),
    )
    certain = max(np.quantile(odds[~labels], 1 - CERTAIN_FALSE_SHARE), suspect)
    return with_fields(table, suspect=round(float(suspect), 3), certain=round(float(certain), 3))


def _reached_by(odds: Floats, strata: npt.NDArray[np.int64], names: Sequence[str], share: float) -> float:
    chosen = odds[np.isin(strata, [i for i, name in enumerate(ROUND) if name in names])]
    return float(np.quantile(chosen, 1 - share)) if chosen.size else -math.inf


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Train the model that tells companions in one silhouette.")
    parser.add_argument("--out", type=Path, required=True, help="the model file to write")
    parser.add_argument("--scenes", type=int, default=SCENES_DEFAULT_COUNT, help="scenes to learn from")
    parser.add_argument("--drives", type=int, default=DRIVES_DEFAULT_COUNT, help="drives to learn from")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes that render")
    options = parser.parse_args(arguments)
    if not TRAINING_SEED + options.scenes <= THRESHOLD_SEED <= SEED_STRIDE - options.scenes:
        parser.error("that many scenes would reach into the seeds that are judged")
    scenes = collect(sample, TRAINING_SEED, options.scenes, options.workers)
    drives = collect(sample_drive, DRIVES_SEED, options.drives, options.workers)
    held = collect(sample, THRESHOLD_SEED, options.scenes // 2, options.workers)
    table = with_thresholds(train(scenes, drives), *held)
    options.out.write_bytes(msgspec.json.encode(table) + b"\n")
    count, pairs = scenes[1].size + drives[1].size, int(np.sum(scenes[1]) + np.sum(drives[1]))
    sys.stdout.write(f"{count} silhouettes, {pairs} with companions; {len(held[1])} others.\n")


if __name__ == "__main__":
    main()

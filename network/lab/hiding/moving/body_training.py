"""Trains the models of the moving hider on drawn drives and writes the robot's model files.

    python -m network.lab.hiding.moving.body_training --out clients/robot/hiding/moving

Needs `[attack]` (scikit-learn); deterministic. Drives to learn from share no draw and no noise with those that are judged.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.companion import Floats
from clients.robot.hiding.moving.body_cues import BODY_CUES
from clients.robot.hiding.moving.moving_hider import MODEL_FILES
from clients.robot.synthetic.driving.draws import DRIVE_STRATA, DriveStratum, draw_drive
from network.bench.processes import worker_pool
from network.lab.hiding.companion_training import boost
from network.lab.hiding.moving.samples import Kind, draw_samples

TRAINING_SEED, DRIVES_DEFAULT_COUNT = 6_000, 2_400
EVERY_FRAMES = 3
DIGITS = 5
# What is hardest to tell is drawn more often.
_HARD: tuple[DriveStratum, ...] = ("companions", "companions", "companions", "aids", "aids", "aids", "crowd")
ROUND = DRIVE_STRATA + _HARD
KINDS: tuple[Kind, ...] = ("person", "people", "part", "thing")
PEOPLE_WEIGHT, PAIR_WEIGHT = 3.0, 2.0
LEARNER: dict[str, float] = {"n_estimators": 240, "min_samples_leaf": 15, "subsample": 0.5, "max_features": 0.3}


def collect(drives: int, workers: int) -> tuple[npt.NDArray[np.int64], Floats]:
    """Kinds are places in KINDS; unclear bodies are left out."""
    with worker_pool(workers) as pool:
        rows = [row for made in pool.map(_sample, range(drives), chunksize=2) for row in made]
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows]).round(DIGITS)


def train_all(kinds: npt.NDArray[np.int64], cues: Floats) -> dict[str, bytes]:
    """By file name."""
    person, people, thing = (KINDS.index(kind) for kind in ("person", "people", "thing"))
    pairs = np.isin(kinds, (person, people))
    trained = {
        "person": (kinds == person, cues, np.where(kinds == people, PEOPLE_WEIGHT, 1.0)),
        "pair": (kinds[pairs] == people, cues[pairs], np.where(kinds[pairs] == people, PAIR_WEIGHT, 1.0)),
        "thing": (kinds == thing, cues, np.ones(kinds.size)),
    }
    return {
        MODEL_FILES[name]: msgspec.json.encode(boost(labels, table, BODY_CUES, weights, **LEARNER)) + b"\n"
        for name, (labels, table, weights) in trained.items()
    }


def _sample(number: int) -> list[tuple[int, Floats]]:
    drive = draw_drive(TRAINING_SEED + number, ROUND[number % len(ROUND)], judging=False)
    found = draw_samples(drive, EVERY_FRAMES)
    return [(KINDS.index(kind), one.cues) for one in found if (kind := one.kind) in KINDS]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description="Train the models by which a driving robot tells people from all else."
    )
    parser.add_argument("--out", type=Path, required=True, help="the folder of the model files")
    parser.add_argument("--drives", type=int, default=DRIVES_DEFAULT_COUNT, help="drives to learn from")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes that render")
    options = parser.parse_args(arguments)
    kinds, cues = collect(options.drives, options.workers)
    for name, data in train_all(kinds, cues).items():
        (options.out / name).write_bytes(data)
    counts = ", ".join(f"{int(np.sum(kinds == place))} {kind}" for place, kind in enumerate(KINDS))
    sys.stdout.write(f"{kinds.size} bodies: {counts}.\n")


if __name__ == "__main__":
    main()

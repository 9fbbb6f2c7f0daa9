"""A pixel classifier trained to find hidden people. Needs scikit-learn (`[attack]`)."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from clients.robot.sensing.sensor_events import Mask
from consensus.errors import BlockRobotError
from network.lab.hiding.features import NAMES, Floats, features
from network.lab.hiding.scenes import View
from network.lab.hiding.scoring import iou

PIXELS_A_VIEW_COUNT = 2_400
TREES_COUNT = 40
LEAVES_COUNT = 31
LEARNING_RATE = 0.2
THRESHOLDS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
VALIDATION_EVERY = 4  # every fourth training view chooses the threshold and is not learned from


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A view with the true silhouette of everyone but the owner, at view resolution."""

    view: View
    others: Mask


@dataclass(frozen=True, slots=True, eq=False)
class LearnedAttacker:
    """A trained classifier and its probability threshold for another person."""

    model: Any
    threshold: float

    def probability(self, view: View, *, every: int = 1) -> Floats:
        """Each pixel's (or every n-th's) of hiding someone."""
        table = features(view)[::every, ::every]
        with _one_thread():
            likely = self.model.predict_proba(table.reshape(-1, table.shape[-1]))[:, 1]
        return np.asarray(likely, dtype=np.float32).reshape(table.shape[:2])

    def recover(self, view: View, *, every: int = 1) -> Mask:
        found = self.probability(view, every=every) > self.threshold
        if every == 1:
            return found
        return np.repeat(np.repeat(found, every, axis=0), every, axis=1)[: view.owner.shape[0], : view.owner.shape[1]]


def require_learning() -> None:
    """Raises EXTRA_MISSING."""
    if importlib.util.find_spec("sklearn") is None:
        raise BlockRobotError("EXTRA_MISSING", "The learned attackers need scikit-learn.", extra="attack")


def train(examples: Sequence[Example], *, seed: int, trees: int = TREES_COUNT) -> LearnedAttacker:
    """Raises EXTRA_MISSING."""
    require_learning()
    from sklearn.ensemble import HistGradientBoostingClassifier  # noqa: PLC0415 - the optional extra, only when used

    learning = [example for number, example in enumerate(examples) if number % VALIDATION_EVERY]
    judging = [example for number, example in enumerate(examples) if number % VALIDATION_EVERY == 0]
    rng = np.random.default_rng([seed, 0x1EA2])
    sampled = [_sample(example, rng) for example in learning]
    model = HistGradientBoostingClassifier(
        max_iter=trees,
        max_leaf_nodes=LEAVES_COUNT,
        learning_rate=LEARNING_RATE,
        early_stopping=False,
        random_state=seed,
    )
    with _one_thread():
        model.fit(np.concatenate([table for table, _ in sampled]), np.concatenate([truth for _, truth in sampled]))
    candidate = LearnedAttacker(model, THRESHOLDS[0])
    scores = np.zeros(len(THRESHOLDS))
    for example in judging:
        likely = candidate.probability(example.view)
        scores += [iou(likely > threshold, example.others) for threshold in THRESHOLDS]
    return LearnedAttacker(model, THRESHOLDS[int(np.argmax(scores))])


def _one_thread() -> AbstractContextManager[Any]:
    limits: AbstractContextManager[Any] = _threads().limit(limits=1)
    return limits


@lru_cache(maxsize=1)
def _threads() -> Any:
    import sklearn.ensemble  # noqa: F401, PLC0415 - what is not loaded yet cannot be controlled
    from threadpoolctl import ThreadpoolController  # noqa: PLC0415 - comes with the optional extra

    return ThreadpoolController()


def _sample(example: Example, rng: np.random.Generator) -> tuple[Floats, npt.NDArray[np.bool_]]:
    table = features(example.view).reshape(-1, len(NAMES))
    truth = example.others.reshape(-1)
    chosen = []
    for side in (np.flatnonzero(truth), np.flatnonzero(~truth)):
        count = min(side.size, PIXELS_A_VIEW_COUNT // 2)
        chosen.append(rng.choice(side, size=count, replace=False) if count else side)
    places = np.concatenate(chosen)
    return table[places], truth[places]

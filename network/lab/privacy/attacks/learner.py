"""Learned linking of two visits, trained on pairs of known people."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Scorer = Callable[[Floats], Floats]

_TREES_COUNT, _LEAVES_COUNT, _LEARNING_RATE = 60, 8, 0.1
_STEPS_COUNT, _STEP, _DECAY = 400, 0.5, 1e-3
_CHOOSING_SHARE = 4  # every fourth known person chooses the scorer and is not learned from


def has_boosting() -> bool:
    return importlib.util.find_spec("sklearn") is not None


def learn(same: Floats, other: Floats, people: npt.NDArray[np.int64], *, seed: int, boosting: bool) -> Scorer:
    """Return a scorer of pairs, larger for the same person.

    `same`, `other`: (trials, features) of true and false pairs; `people`: each trial's person. Ties prefer single
    features.
    """
    known = np.unique(people)
    choosing = np.isin(people, known[::_CHOOSING_SHARE])
    table = np.concatenate([same[~choosing], other[~choosing]])
    labels = np.concatenate([np.ones(np.count_nonzero(~choosing)), np.zeros(np.count_nonzero(~choosing))])
    scorers = [_column(place, sign) for place in range(same.shape[1]) for sign in (1.0, -1.0)]
    rates = [_rate(score(same), score(other)) for score in scorers]
    if len(table):
        learned = _boost(table, labels, seed) if boosting else _regress(table, labels)
        scorers.append(learned)
        rates.append(_rate(learned(same[choosing]), learned(other[choosing])))
    return scorers[int(np.argmax(rates))]


def compare(same: Floats, other: Floats) -> Floats:
    return np.asarray((same > other) + 0.5 * (same == other), dtype=np.float64)


def _rate(same: Floats, other: Floats) -> float:
    return float(np.mean(compare(same, other))) if same.size else 0.0


def _column(place: int, sign: float) -> Scorer:
    return lambda table: np.asarray(sign * table[:, place], dtype=np.float64)


def _boost(table: Floats, labels: Floats, seed: int) -> Scorer:
    from sklearn.ensemble import HistGradientBoostingClassifier  # noqa: PLC0415 - the optional extra, only when used

    model: Any = HistGradientBoostingClassifier(
        max_iter=_TREES_COUNT,
        max_leaf_nodes=_LEAVES_COUNT,
        learning_rate=_LEARNING_RATE,
        early_stopping=False,
        random_state=seed,
    )
    with _one_thread():
        model.fit(table, labels)

    def score(rows: Floats) -> Floats:
        with _one_thread():
            return np.asarray(model.predict_proba(rows)[:, 1], dtype=np.float64)

    return score


def _one_thread() -> AbstractContextManager[Any]:
    limits: AbstractContextManager[Any] = _threads().limit(limits=1)
    return limits


@lru_cache(maxsize=1)
def _threads() -> Any:
    from threadpoolctl import ThreadpoolController  # noqa: PLC0415 - comes with the optional extra

    return ThreadpoolController()


def _regress(table: Floats, labels: Floats) -> Scorer:
    middle, spread = table.mean(axis=0), table.std(axis=0) + 1e-9
    rows = (table - middle) / spread
    weights, bias = np.zeros(table.shape[1]), 0.0
    for _ in range(_STEPS_COUNT):
        wrong = 1 / (1 + np.exp(-np.clip(rows @ weights + bias, -30, 30))) - labels
        weights -= _STEP * (rows.T @ wrong / len(rows) + _DECAY * weights)
        bias -= _STEP * float(wrong.mean())
    return lambda given: np.asarray(((given - middle) / spread) @ weights, dtype=np.float64)

"""Scores of recovery and retention, with confidence bounds; leaks are never rounded away."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from clients.robot.sensing.sensor_events import Mask

BOOTSTRAP_COUNT = 4_000
UPPER_SHARE = 0.95


def iou(found: Mask, true: Mask) -> float:
    """Intersection over union; 0.0 if both are empty."""
    union = int(np.count_nonzero(found | true))
    return int(np.count_nonzero(found & true)) / union if union else 0.0


@dataclass(frozen=True, slots=True)
class Bound:
    """A mean over scenes and its one-sided upper 95 % bootstrap bound."""

    mean: float
    upper: float
    count: int


def upper_bound(count: int, total: int) -> float:
    """One-sided 95 % Clopper-Pearson bound of a share."""
    return 1.0 if count >= total else float(beta.ppf(UPPER_SHARE, count + 1, total - count))


def paired_bound(differences: Sequence[float], *, seed: int) -> Bound:
    """Mean difference per scene and its upper 95 % bound; zeros without scenes."""
    if not differences:
        return Bound(0.0, 0.0, 0)
    values = np.asarray(differences, dtype=np.float64)
    rng = np.random.default_rng([seed, 0xB007])
    draws = rng.integers(values.size, size=(BOOTSTRAP_COUNT, values.size))
    means = values[draws].mean(axis=1)
    return Bound(float(values.mean()), float(np.quantile(means, UPPER_SHARE)), values.size)


def mean_of(values: Sequence[float]) -> float | None:
    """4 decimals; None if nothing was measured."""
    return round(statistics.fmean(values), 4) if values else None


def share_of(count: int, total: int) -> float | None:
    """5 decimals; None if nothing was measured."""
    return round(count / total, 5) if total else None

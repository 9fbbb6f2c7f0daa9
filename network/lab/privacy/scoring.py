"""Attack success rates against guessing, with confidence bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

ALLOWED_EXCESS = 0.05
BOOTSTRAP_COUNT = 2_000
ONE_SIDED = 0.95


@dataclass(frozen=True, slots=True)
class Rate:
    """An attack's success rate, guessing rate, one-sided 95 % bounds."""

    success: float
    guess: float
    low: float
    high: float
    trials: int

    @property
    def excess_bound(self) -> float:
        """Return the maximal distance from guessing; worse than guessing also leaks."""
        return max(self.high - self.guess, self.guess - self.low)

    @property
    def is_guessing(self) -> bool:
        """Return whether it is shown within 0.05 of guessing."""
        return self.trials > 0 and self.excess_bound <= ALLOWED_EXCESS

    def figures(self, name: str) -> dict[str, float | None]:
        return {
            f"{name}_success_rate": round(self.success, 4) if self.trials else None,
            f"{name}_guess_rate": float(f"{self.guess:.3g}"),
            f"{name}_success_upper_bound": round(self.high, 4),
            f"{name}_trials": self.trials,
        }


Rates = dict[str, dict[str, Rate]]
"""By attack and scheme."""


def count_rate(hits: float, trials: int, guess: float) -> Rate:
    """Return independent attempts' rate, Clopper-Pearson bounds. A tie is half a hit."""
    if trials == 0:
        return Rate(0.0, guess, 0.0, 1.0, 0)
    low = float(beta.ppf(1 - ONE_SIDED, hits, trials - hits + 1)) if hits else 0.0
    high = float(beta.ppf(ONE_SIDED, hits + 1, trials - hits)) if hits < trials else 1.0
    return Rate(hits / trials, guess, low, high, trials)


def grouped_rate(hits: Mapping[int, Sequence[float]], guess: float, *, seed: int) -> Rate:
    """Return grouped attempts' rate (by person), with bootstrap bounds over the groups."""
    groups = [np.asarray(found, dtype=np.float64) for found in hits.values() if len(found)]
    trials = sum(map(len, groups))
    if not trials:
        return Rate(0.0, guess, 0.0, 1.0, 0)
    sums = np.array([found.sum() for found in groups])
    sizes = np.array([len(found) for found in groups], dtype=np.float64)
    success = float(sums.sum() / sizes.sum())
    rng = np.random.default_rng([seed, 0xB007])
    drawn = rng.integers(len(groups), size=(BOOTSTRAP_COUNT, len(groups)))
    means = sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    low, high = (float(np.quantile(means, share)) for share in (1 - ONE_SIDED, ONE_SIDED))
    if high - low < 1e-12:
        return count_rate(float(sums.sum()), trials, guess)
    return Rate(success, guess, low, high, trials)


def choice_score(first: float, second: float) -> float:
    if first == second:
        return 0.5
    return 1.0 if first > second else 0.0

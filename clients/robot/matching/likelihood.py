"""Likelihood of a tag's readings, worn by a followed person or by an absent bearer.

Mixtures of Kalman filters, one reading at a time; natural log densities, ms, metres or degrees. State: position (bias if in
view), speed, reader drift (standard deviations). Distances and bearings have filters of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# The stated sigma may be too small: it is marginalised over these factors, each with its weight.
SIGMA_SCALES = ((1.0, 0.55), (1.6, 0.30), (2.5, 0.15))
# Errors may be independent, or drift over seconds as reflections do: (seconds, share of the variance), weight.
ERROR_DRIFTS = ((0.0, 0.0, 0.85), (2.0, 0.9, 0.15))
BIAS_SIGMA_M = 0.15
# An absent bearer: somewhere in range, standing (no acceleration) or walking (m^2/s^3), each with its weight.
ABSENT_MEAN_M, ABSENT_SIGMA_M = 3.0, 2.0
ABSENT_MOTIONS = ((0.0, 0.0, 0.4), (0.7, 0.02, 0.3), (0.7, 0.3, 0.3))
# The same of bearings, in degrees: of a person some 3 m away. Nobody knows on which side an absent bearer is.
BEARING_BIAS_SIGMA_DEG = 3.0
ABSENT_BEARING_DEG, ABSENT_BEARING_SIGMA_DEG = 0.0, 60.0
ABSENT_TURNS = ((0.0, 0.0, 0.4), (13.0, 7.0, 0.3), (13.0, 108.0, 0.3))
# A tag in view is mostly heard by the antenna that faces as the camera does; an absent one mostly by the other,
# but it may also be in front and out of the picture.
VISIBLE_FRONT = ((18.0, 2.0, 1.0),)
ABSENT_FRONT = ((2.0, 18.0, 0.9995), (1.0, 1.0, 0.0005))
_LOG_2PI = math.log(2 * math.pi)
# What is less likely than this, relative to the likeliest, counts as this likely, so that no logarithm is infinite.
_TINY = 1e-300
_TRANSITIONS_KEPT_COUNT = 1024


class Spread(NamedTuple):
    """Last time and covariances (components, 3, 3)."""

    at_ms: int | None
    covariance: Array


class FilterUpdate(NamedTuple):
    """A reading's effect on beliefs of equal spread."""

    after: Spread
    motion: Array
    drifting: Array
    gain: Array
    precision: Array
    constant: Array


class Belief(NamedTuple):
    """Means (components, 3), log densities, spread."""

    mean: Array
    log_density: Array
    spread: Spread


class Filters:
    """Filters of both hypotheses, in-view first; holds no readings.

    `bias_sigma`: of an error that stays. An absent bearer: mean and standard deviation of the place, and motions: standard
    deviation of the speed, spectral density of the acceleration, weight.
    """

    def __init__(
        self, bias_sigma: float, absent_mean: float, absent_sigma: float, motions: Sequence[tuple[float, float, float]]
    ) -> None:
        in_view = [(0.0, bias_sigma, 0.0, 0.0, 1.0)]
        absent = [(absent_mean, absent_sigma, *motion) for motion in motions]
        rows = [
            (mean, place, speed, acceleration, scale, drift_s, share, math.log(weight * scale_weight * drift_weight))
            for mean, place, speed, acceleration, weight in in_view + absent
            for scale, scale_weight in SIGMA_SCALES
            for drift_s, share, drift_weight in ERROR_DRIFTS
        ]
        mean, place, speed, acceleration, scale, drift_s, share, log_weight = np.array(rows).T
        self._count = len(rows)
        self._visible_count = len(SIGMA_SCALES) * len(ERROR_DRIFTS)
        self._in_view = np.arange(self._count) < self._visible_count
        self._acceleration = acceleration
        self._drift_s = drift_s
        self._white = (1 - share) * scale**2
        self._drifting = np.sqrt(share) * scale
        covariance = np.zeros((self._count, 3, 3))
        covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 2, 2] = place**2, speed**2, 1.0
        means = np.zeros((self._count, 3))
        means[:, 0] = mean
        self.start = Belief(means, log_weight, Spread(None, covariance))
        self._transition = lru_cache(_TRANSITIONS_KEPT_COUNT)(self._make_transition)

    def step(self, spread: Spread, at_ms: int, sigma: float) -> FilterUpdate:
        motion, noise = self._transition(max(0, at_ms - (at_ms if spread.at_ms is None else spread.at_ms)))
        covariance = motion @ spread.covariance @ motion.transpose(0, 2, 1) + noise
        # What is measured is the position plus the drifting error: (1, 0, drifting) of the state, and fresh noise.
        drifting = self._drifting * sigma
        across = covariance[:, :, 0] + covariance[:, :, 2] * drifting[:, None]
        variance = across[:, 0] + across[:, 2] * drifting + self._white * (sigma * sigma)
        gain = across / variance[:, None]
        after = covariance - gain[:, :, None] * across[:, None, :]
        constant = -0.5 * (_LOG_2PI + np.log(variance))
        return FilterUpdate(Spread(at_ms, after), motion, drifting, gain, 1 / variance, constant)

    def update(self, belief: Belief, step: FilterUpdate, measured: float, of_person: float) -> Belief:
        """`of_person`: the range, or bearing, of the person at the reading."""
        predicted = (step.motion @ belief.mean[:, :, None])[:, :, 0]
        error = measured - of_person * self._in_view - predicted[:, 0] - step.drifting * predicted[:, 2]
        log_density = belief.log_density + step.constant - 0.5 * error * error * step.precision
        return Belief(predicted + step.gain * error[:, None], log_density, step.after)

    def log_evidence(self, belief: Belief) -> tuple[float, float]:
        """Return log densities: worn by this person; absent."""
        top = belief.log_density.max()
        shares = np.exp(belief.log_density - top)
        visible = float(shares[: self._visible_count].sum())
        absent = float(shares[self._visible_count :].sum())
        return float(top) + math.log(max(visible, _TINY)), float(top) + math.log(max(absent, _TINY))

    def _make_transition(self, elapsed_ms: int) -> tuple[Array, Array]:
        """Both (components, 3, 3)."""
        dt = elapsed_ms / 1000
        kept = np.exp(-dt / np.maximum(self._drift_s, 1e-9))
        motion = np.zeros((self._count, 3, 3))
        motion[:, 0, 0] = motion[:, 1, 1] = 1.0
        motion[:, 0, 1], motion[:, 2, 2] = dt, kept
        noise = np.zeros((self._count, 3, 3))
        noise[:, 0, 0] = self._acceleration * dt**3 / 3
        noise[:, 0, 1] = noise[:, 1, 0] = self._acceleration * dt**2 / 2
        noise[:, 1, 1] = self._acceleration * dt
        noise[:, 2, 2] = 1 - kept**2
        return motion, noise


DISTANCES = Filters(BIAS_SIGMA_M, ABSENT_MEAN_M, ABSENT_SIGMA_M, ABSENT_MOTIONS)
BEARINGS = Filters(BEARING_BIAS_SIGMA_DEG, ABSENT_BEARING_DEG, ABSENT_BEARING_SIGMA_DEG, ABSENT_TURNS)


def log_sum(values: list[float]) -> float:
    top = max(values)
    return top if math.isinf(top) else top + math.log(sum(math.exp(value - top) for value in values))


@lru_cache(maxsize=4096)
def log_antenna(front: int, back: int) -> float:
    """Return antennas' log likelihood ratio, visible to absent."""
    visible = log_sum([math.log(w) + _beta_binomial(front, back, a, b) for a, b, w in VISIBLE_FRONT])
    absent = log_sum([math.log(w) + _beta_binomial(front, back, a, b) for a, b, w in ABSENT_FRONT])
    return visible - absent


def _beta_binomial(front: int, back: int, a: float, b: float) -> float:
    return _log_beta(a + front, b + back) - _log_beta(a, b)


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)

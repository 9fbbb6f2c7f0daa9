"""How likely a tag's readings are if a followed person wears it, or if its bearer is not in the picture. Pure.

Both are mixtures of small Kalman filters that take one reading at a time, so that a new reading costs the same
whether it is the fifth or the five hundredth. All values are natural logarithms of densities; distances in metres,
times in milliseconds. It must never prefer anybody: a reading that says nothing changes nothing.

A filter's state is (position in m, speed in m/s, the reader's drifting error in its standard deviations). For a
person in view the position is the constant bias of the range; for an absent bearer it is where the bearer is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# The stated sigma may be too small: it is marginalised over these factors, each with its weight.
SIGMA_SCALES = ((1.0, 0.55), (1.6, 0.30), (2.5, 0.15))
# Errors may be independent, or drift over seconds as reflections do: (seconds, share of the variance), weight.
ERROR_DRIFTS = ((0.0, 0.0, 0.7), (2.0, 0.9, 0.3))
BIAS_SIGMA_M = 0.15
# An absent bearer: somewhere in range, standing (no acceleration) or walking (m^2/s^3), each with its weight.
ABSENT_MEAN_M, ABSENT_SIGMA_M = 3.0, 2.0
ABSENT_MOTIONS = ((0.0, 0.0, 0.4), (0.7, 0.02, 0.3), (0.7, 0.3, 0.3))
# A tag in view is mostly heard by the antenna that faces as the camera does; an absent one mostly by the other,
# but it may also be in front and out of the picture.
VISIBLE_FRONT = ((18.0, 2.0, 1.0),)
ABSENT_FRONT = ((2.0, 18.0, 0.9995), (1.0, 1.0, 0.0005))
_LOG_2PI = math.log(2 * math.pi)
_TRANSITIONS_KEPT_COUNT = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """How sure a mixture is: when it was last asked, and the covariance of each component, (components, 3, 3)."""

    at_ms: int | None
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What one reading does to every belief of the same spread, whatever was measured."""

    after: Spread
    motion: Array
    seen_as: Array
    gain: Array
    precision: Array
    constant: Array


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """A mixture after some readings: (components, 3) means, log density of the readings by component, its spread."""

    mean: Array
    log_density: Array
    spread: Spread


class Mixture:
    """Filters of one hypothesis, side by side in arrays; holds no readings itself."""

    def __init__(self, mean_m: float, motions: tuple[tuple[float, float, float, float], ...]) -> None:
        """`motions` are (sigma of the position, sigma of the speed, acceleration, weight)."""
        rows = [
            (place, speed, acceleration, scale, drift_s, share, math.log(weight * scale_weight * drift_weight))
            for place, speed, acceleration, weight in motions
            for scale, scale_weight in SIGMA_SCALES
            for drift_s, share, drift_weight in ERROR_DRIFTS
        ]
        place, speed, acceleration, scale, drift_s, share, log_weight = np.array(rows).T
        self._count = len(rows)
        self._acceleration = acceleration
        self._drift_s = drift_s
        self._white = (1 - share) * scale**2
        self._drifting = np.sqrt(share) * scale
        covariance = np.zeros((self._count, 3, 3))
        covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 2, 2] = place**2, speed**2, 1.0
        mean = np.zeros((self._count, 3))
        mean[:, 0] = mean_m
        self.start = Belief(mean, log_weight, Spread(None, covariance))
        self._transition = lru_cache(_TRANSITIONS_KEPT_COUNT)(self._make_transition)

    def step(self, spread: Spread, at_ms: int, sigma_m: float) -> Step:
        """Return what a reading at that time with that sigma does; time never goes back here."""
        motion, noise = self._transition(max(0, at_ms - (at_ms if spread.at_ms is None else spread.at_ms)))
        covariance = motion @ spread.covariance @ motion.transpose(0, 2, 1) + noise
        seen_as = np.zeros((self._count, 3))
        seen_as[:, 0] = 1.0
        seen_as[:, 2] = self._drifting * sigma_m
        across = (covariance @ seen_as[:, :, None])[:, :, 0]
        variance = (across * seen_as).sum(1) + self._white * (sigma_m * sigma_m)
        gain = across / variance[:, None]
        after = covariance - gain[:, :, None] * across[:, None, :]
        constant = -0.5 * (_LOG_2PI + np.log(variance))
        return Step(Spread(at_ms, after), motion, seen_as, gain, 1 / variance, constant)

    def _make_transition(self, elapsed_ms: int) -> tuple[Array, Array]:
        """Return how the state moves in that time, and the noise that this adds; both (components, 3, 3)."""
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


VISIBLE = Mixture(0.0, ((BIAS_SIGMA_M, 0.0, 0.0, 1.0),))
ABSENT = Mixture(ABSENT_MEAN_M, tuple((ABSENT_SIGMA_M, *motion) for motion in ABSENT_MOTIONS))


def take(belief: Belief, step: Step, observed_m: float) -> Belief:
    """Return the belief after a reading: the range itself for an absent bearer, its error for a person in view."""
    predicted = (step.motion @ belief.mean[:, :, None])[:, :, 0]
    error = observed_m - (step.seen_as * predicted).sum(1)
    log_density = belief.log_density + step.constant - 0.5 * error * error * step.precision
    return Belief(predicted + step.gain * error[:, None], log_density, step.after)


def log_evidence(belief: Belief) -> float:
    """Return the log density of all readings taken so far, over all components."""
    top = float(belief.log_density.max())
    return top + math.log(float(np.exp(belief.log_density - top).sum()))


def log_sum(values: list[float]) -> float:
    """Return log(sum(exp(values)))."""
    top = max(values)
    return top if math.isinf(top) else top + math.log(sum(math.exp(value - top) for value in values))


@lru_cache(maxsize=4096)
def log_antenna(front: int, back: int) -> float:
    """Return how much the antennas speak for the bearer being in view: log ratio visible to absent."""
    visible = log_sum([math.log(w) + _beta_binomial(front, back, a, b) for a, b, w in VISIBLE_FRONT])
    absent = log_sum([math.log(w) + _beta_binomial(front, back, a, b) for a, b, w in ABSENT_FRONT])
    return visible - absent


def _beta_binomial(front: int, back: int, a: float, b: float) -> float:
    return _log_beta(a + front, b + back) - _log_beta(a, b)


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)

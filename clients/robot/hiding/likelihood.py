"""How likely a tag's readings are if a followed person wears it, or if its bearer is not in the picture. Pure.

All values are natural logarithms of densities. Distances in metres, times in milliseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

# The stated sigma may be too small: it is marginalised over these factors.
SIGMA_SCALES = ((1.0, 0.55), (1.6, 0.30), (2.5, 0.15))
BIAS_SIGMA_M = 0.15
# An absent bearer: somewhere in range, standing (no acceleration) or walking (m^2/s^3), each with its weight.
ABSENT_MEAN_M, ABSENT_SIGMA_M = 3.0, 2.0
ABSENT_MOTIONS = ((0.0, 0.0, 0.4), (0.7, 0.02, 0.3), (0.7, 0.3, 0.3))
# A tag in view is mostly heard by the antenna that faces as the camera does; an absent one mostly by the other,
# but it may also be in front and out of the picture.
VISIBLE_FRONT = ((18.0, 2.0, 1.0),)
ABSENT_FRONT = ((2.0, 18.0, 0.95), (1.0, 1.0, 0.05))
LOG_2PI = math.log(2 * math.pi)


@dataclass(frozen=True, slots=True)
class RangeReading:
    """A tag's measured distance with its sigma, and the range of the person it is compared with."""

    at_ms: int
    distance_m: float
    sigma_m: float
    person_m: float


def log_sum(values: Sequence[float]) -> float:
    """Return log(sum(exp(values)))."""
    top = max(values)
    return top if math.isinf(top) else top + math.log(sum(math.exp(value - top) for value in values))


def log_visible(readings: Sequence[RangeReading]) -> float:
    """Return the log density of the readings if this person wears the tag, with an unknown constant bias."""
    return log_sum([math.log(weight) + _with_bias(readings, scale) for scale, weight in SIGMA_SCALES])


def log_absent(readings: Sequence[RangeReading]) -> float:
    """Return the log density of the readings if the bearer is not in the picture, standing or walking anywhere."""
    terms = []
    for scale, scale_weight in SIGMA_SCALES:
        for speed_sigma, acceleration, weight in ABSENT_MOTIONS:
            terms.append(math.log(scale_weight * weight) + _kalman(readings, scale, speed_sigma, acceleration))
    return log_sum(terms)


def log_antenna(front: int, back: int) -> float:
    """Return how much the antennas speak for the bearer being in view: log ratio visible to absent."""
    visible = log_sum([math.log(w) + _beta_binomial(front, back, a, b) for a, b, w in VISIBLE_FRONT])
    absent = log_sum([math.log(w) + _beta_binomial(front, back, a, b) for a, b, w in ABSENT_FRONT])
    return visible - absent


def _with_bias(readings: Sequence[RangeReading], scale: float) -> float:
    """Gaussian errors plus one common bias: the bias is integrated out in closed form."""
    total, precision, weighted = 0.0, 1 / BIAS_SIGMA_M**2, 0.0
    for reading in readings:
        variance = (reading.sigma_m * scale) ** 2
        error = reading.distance_m - reading.person_m
        total -= 0.5 * (LOG_2PI + math.log(variance) + error * error / variance)
        precision += 1 / variance
        weighted += error / variance
    return total + 0.5 * weighted * weighted / precision - 0.5 * math.log(precision * BIAS_SIGMA_M**2)


def _kalman(readings: Sequence[RangeReading], scale: float, speed_sigma: float, acceleration: float) -> float:
    """Log density under a one-dimensional motion with unknown start and white acceleration."""
    position, speed = ABSENT_MEAN_M, 0.0
    p00, p01, p11 = ABSENT_SIGMA_M**2, 0.0, speed_sigma**2
    total, before = 0.0, readings[0].at_ms if readings else 0
    for reading in readings:
        dt = max(0, reading.at_ms - before) / 1000
        before = reading.at_ms
        position += speed * dt
        p00 += dt * (2 * p01 + dt * p11) + acceleration * dt**3 / 3
        p01 += dt * p11 + acceleration * dt**2 / 2
        p11 += acceleration * dt
        variance = p00 + (reading.sigma_m * scale) ** 2
        error = reading.distance_m - position
        total -= 0.5 * (LOG_2PI + math.log(variance) + error * error / variance)
        gain0, gain1 = p00 / variance, p01 / variance
        position += gain0 * error
        speed += gain1 * error
        p00, p01, p11 = p00 * (1 - gain0), p01 * (1 - gain0), p11 - gain1 * p01
    return total


@lru_cache(maxsize=4096)
def _beta_binomial(front: int, back: int, a: float, b: float) -> float:
    return _log_beta(a + front, b + back) - _log_beta(a, b)


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)

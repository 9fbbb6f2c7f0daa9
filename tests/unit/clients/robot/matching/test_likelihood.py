"""The filters say of readings what the dense Gaussian says, and a reading that says nothing changes nothing."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy.stats import betabinom, multivariate_normal

from clients.robot.matching import likelihood
from clients.robot.matching.likelihood import DISTANCES, Belief, log_antenna

READINGS = [(0, 2.6, 0.3), (400, 2.1, 0.3), (400, 2.4, 0.5), (1_900, 3.0, 0.3), (6_000, 2.2, 0.8)]


PERSON_M = 2.4


def filtered(readings: list[tuple[int, float, float]]) -> Belief:
    belief = DISTANCES.start
    for at_ms, observed_m, sigma_m in readings:
        belief = DISTANCES.update(belief, DISTANCES.step(belief.spread, at_ms, sigma_m), observed_m, PERSON_M)
    return belief


def dense(mean_m: float, motions: list[tuple[float, float, float, float]]) -> float:
    """The density of READINGS as one Gaussian for each component: all covariances written out."""
    at = np.array([r[0] for r in READINGS]) / 1000
    observed, sigma = np.array([r[1] for r in READINGS]), np.array([r[2] for r in READINGS])
    terms = []
    for (place, speed, acceleration, w), (scale, ws), (drift_s, share, wd) in product(
        motions, likelihood.SIGMA_SCALES, likelihood.ERROR_DRIFTS
    ):
        since = at - at[0]
        early = np.minimum.outer(since, since)
        late = np.maximum.outer(since, since)
        covariance = place**2 + speed**2 * np.outer(since, since)
        covariance = covariance + acceleration * early**2 * (3 * late - early) / 6
        apart = np.abs(np.subtract.outer(at, at))
        together = np.outer(sigma, sigma) * scale**2
        if share:
            covariance = covariance + share * together * np.exp(-apart / drift_s)
        covariance = covariance + (1 - share) * np.diag(np.diag(together))
        density = multivariate_normal(np.full(at.size, mean_m), covariance).logpdf(observed)
        terms.append(math.log(w * ws * wd) + float(density))
    return float(np.logaddexp.reduce(terms))


def test_bearers_in_view_and_absent_are_weighed_as_the_dense_gaussian_weighs() -> None:
    expected = dense(PERSON_M, [(likelihood.BIAS_SIGMA_M, 0.0, 0.0, 1.0)])
    assert DISTANCES.log_evidence(filtered(READINGS))[0] == pytest.approx(expected, abs=1e-9)
    motions = [(likelihood.ABSENT_SIGMA_M, *motion) for motion in likelihood.ABSENT_MOTIONS]
    expected = dense(likelihood.ABSENT_MEAN_M, motions)
    assert DISTANCES.log_evidence(filtered(READINGS))[1] == pytest.approx(expected, abs=1e-9)


def test_before_any_reading_both_hypotheses_are_as_good_and_the_front_antenna_speaks_for_one() -> None:
    assert DISTANCES.log_evidence(DISTANCES.start) == pytest.approx((0.0, 0.0))
    assert log_antenna(10, 0) > 0 > log_antenna(0, 10)


def test_impossible_or_many_readings_leave_every_figure_finite() -> None:
    visible, absent = DISTANCES.log_evidence(filtered([(100 * i, 60.0, 0.05) for i in range(50)]))
    assert math.isfinite(visible)
    assert visible < absent - 600
    belief = filtered([(0, PERSON_M + 0.1 * (-1) ** i, 0.05) for i in range(300)])
    assert all(math.isfinite(density) for density in DISTANCES.log_evidence(belief))
    assert np.all(np.linalg.eigvalsh(belief.spread.covariance) > -1e-12)
    for parts in (likelihood.SIGMA_SCALES, likelihood.ERROR_DRIFTS, likelihood.ABSENT_MOTIONS):
        assert sum(part[-1] for part in parts) == pytest.approx(1.0)
    assert sum(part[-1] for part in likelihood.ABSENT_FRONT) == pytest.approx(1.0)


@pytest.mark.parametrize(("front", "back"), [(0, 0), (3, 1), (10, 0), (0, 10), (40, 5)])
def test_antennas_are_weighed_as_a_beta_binomial(front: int, back: int) -> None:
    def density(parts: tuple[tuple[float, float, float], ...]) -> float:
        return sum(w * float(betabinom(front + back, a, b).pmf(front)) for a, b, w in parts)

    expected = math.log(density(likelihood.VISIBLE_FRONT) / density(likelihood.ABSENT_FRONT))
    assert log_antenna(front, back) == pytest.approx(expected, abs=1e-8)

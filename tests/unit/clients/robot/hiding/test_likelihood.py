"""The filters say of readings what the dense Gaussian says, and a reading that says nothing changes nothing."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy.stats import betabinom, multivariate_normal

from clients.robot.hiding import likelihood
from clients.robot.hiding.likelihood import ABSENT, VISIBLE, Belief, Mixture, log_antenna, log_evidence, take

READINGS = [(0, 2.6, 0.3), (400, 2.1, 0.3), (400, 2.4, 0.5), (1_900, 3.0, 0.3), (6_000, 2.2, 0.8)]


def filtered(mixture: Mixture, readings: list[tuple[int, float, float]]) -> Belief:
    belief = mixture.start
    for at_ms, observed_m, sigma_m in readings:
        belief = take(belief, mixture.step(belief.spread, at_ms, sigma_m), observed_m)
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


def test_a_person_in_view_is_weighed_as_the_dense_gaussian_weighs() -> None:
    shifted = [(at, observed - 2.4, sigma) for at, observed, sigma in READINGS]
    expected = dense(2.4, [(likelihood.BIAS_SIGMA_M, 0.0, 0.0, 1.0)])
    assert log_evidence(filtered(VISIBLE, shifted)) == pytest.approx(expected, abs=1e-9)


def test_an_absent_bearer_is_weighed_as_the_dense_gaussian_weighs() -> None:
    motions = [(likelihood.ABSENT_SIGMA_M, *motion) for motion in likelihood.ABSENT_MOTIONS]
    expected = dense(likelihood.ABSENT_MEAN_M, motions)
    assert log_evidence(filtered(ABSENT, READINGS)) == pytest.approx(expected, abs=1e-9)


def test_before_any_reading_both_hypotheses_are_certain_of_nothing() -> None:
    assert log_evidence(VISIBLE.start) == pytest.approx(0.0)
    assert log_evidence(ABSENT.start) == pytest.approx(0.0)


def test_many_readings_at_one_instant_stay_finite() -> None:
    belief = filtered(VISIBLE, [(0, 0.1 * (-1) ** i, 0.05) for i in range(300)])
    assert math.isfinite(log_evidence(belief))
    assert np.all(np.linalg.eigvalsh(belief.spread.covariance) > -1e-12)


def test_the_weights_of_each_mixture_sum_to_one() -> None:
    for parts in (likelihood.SIGMA_SCALES, likelihood.ERROR_DRIFTS, likelihood.ABSENT_MOTIONS):
        assert sum(part[-1] for part in parts) == pytest.approx(1.0)
    assert sum(part[-1] for part in likelihood.ABSENT_FRONT) == pytest.approx(1.0)


@pytest.mark.parametrize(("front", "back"), [(0, 0), (3, 1), (10, 0), (0, 10), (40, 5)])
def test_antennas_are_weighed_as_a_beta_binomial(front: int, back: int) -> None:
    def density(parts: tuple[tuple[float, float, float], ...]) -> float:
        return sum(w * float(betabinom(front + back, a, b).pmf(front)) for a, b, w in parts)

    expected = math.log(density(likelihood.VISIBLE_FRONT) / density(likelihood.ABSENT_FRONT))
    assert log_antenna(front, back) == pytest.approx(expected, abs=1e-8)


def test_the_front_antenna_speaks_for_being_in_view_and_the_other_against() -> None:
    assert log_antenna(10, 0) > 0 > log_antenna(0, 10)

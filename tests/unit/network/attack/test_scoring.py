"""Rates, and how sure they are: a maybe is no pass."""

from __future__ import annotations

import numpy as np
import pytest

from network.lab.privacy.scoring import Rate, choice_score, count_rate, grouped_rate


def test_nothing_found_is_guessing_in_a_hundred_attempts_and_shows_nothing_in_fewer() -> None:
    rate = count_rate(0, 100, 0.0)
    assert rate.success == 0.0
    assert rate.high == pytest.approx(0.0295, abs=1e-3)
    assert rate.is_guessing
    assert not count_rate(0, 10, 0.0).is_guessing
    assert not count_rate(0, 0, 0.0).is_guessing
    assert not grouped_rate({}, 0.5, seed=1).is_guessing


def test_an_attack_that_wins_or_is_wrong_too_often_is_not_guessing() -> None:
    assert not count_rate(100, 100, 0.01).is_guessing
    assert not grouped_rate({person: [1.0] * 20 for person in range(50)}, 0.5, seed=1).is_guessing
    assert not grouped_rate({person: [0.0] * 20 for person in range(50)}, 0.5, seed=1).is_guessing


def test_coins_are_guessing_and_people_who_hang_together_make_the_bound_wide() -> None:
    rng = np.random.default_rng(4)
    coins = {person: rng.integers(2, size=48).astype(float).tolist() for person in range(160)}
    rate = grouped_rate(coins, 0.5, seed=1)
    assert rate.is_guessing
    assert rate.low < 0.5 < rate.high
    assert rate.trials == 160 * 48
    # Half of the people always found, half never: that is no information from 48 attempts each, but from one.
    split = {person: [float(person % 2)] * 48 for person in range(40)}
    assert grouped_rate(split, 0.5, seed=1).high > 0.6


@pytest.mark.parametrize("tied", [{1: [0.5]}, {1: [0.5] * 9}, {person: [0.5] for person in range(40)}, {1: [0.0, 1.0]}])
def test_a_few_ties_show_nothing(tied: dict[int, list[float]]) -> None:
    """Where people do not differ there is nothing to draw from, and few attempts stay few."""
    rate = grouped_rate(tied, 0.5, seed=1)
    assert rate.success == 0.5
    assert rate.low < 0.45
    assert rate.high > 0.55
    assert not rate.is_guessing


def test_a_tie_is_half_a_hit_and_many_ties_are_guessing() -> None:
    rate = grouped_rate({person: [0.5] * 4 for person in range(100)}, 0.5, seed=1)
    assert rate.success == 0.5
    assert 0.54 < rate.high < 0.55
    assert rate.is_guessing
    assert [choice_score(2, 1), choice_score(1, 1), choice_score(0, 1)] == [1.0, 0.5, 0.0]
    assert count_rate(0, 0, 0.0).figures("limit_long_stay")["limit_long_stay_success_rate"] is None


def test_figures_come_in_pairs() -> None:
    figures = Rate(0.51234, 0.5, 0.49, 0.53, 100).figures("link_key_ours")
    assert figures == {
        "link_key_ours_success_rate": 0.5123,
        "link_key_ours_guess_rate": 0.5,
        "link_key_ours_success_upper_bound": 0.53,
        "link_key_ours_trials": 100,
    }

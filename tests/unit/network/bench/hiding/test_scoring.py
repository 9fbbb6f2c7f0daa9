"""Scores on masks that a person can check by hand."""

from __future__ import annotations

import numpy as np
import pytest

from network.lab.hiding.scoring import iou, mean_of, paired_bound, share_of


def mask(*rows: str) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.array([[letter == "#" for letter in row] for row in rows])


def test_half_of_a_union_is_a_half_and_nothing_recovered_of_nobody_no_success() -> None:
    assert iou(mask("##..", "...."), mask("#...", "....")) == 0.5
    assert iou(mask("##..", "...."), mask("..##", "....")) == 0.0
    assert iou(mask("##..", "##.."), mask("##..", "##..")) == 1.0
    assert iou(mask("...."), mask("....")) == 0.0


def test_a_leak_is_bounded_from_both_sides_and_by_the_same_seed_alike() -> None:
    bound = paired_bound([0.1, 0.12, 0.08, 0.1, 0.11] * 8, seed=3)
    assert bound.mean == pytest.approx(0.102)
    assert 0.102 < bound.upper < 0.107
    assert bound.count == 40
    bound = paired_bound([0.0] * 39 + [0.8], seed=3)
    assert bound.mean == pytest.approx(0.02)
    assert bound.upper > 0.03
    values = [0.01 * n for n in range(20)]
    assert paired_bound(values, seed=1) == paired_bound(values, seed=1)


def test_what_was_not_measured_is_none_and_not_zero() -> None:
    assert mean_of([]) is None
    assert share_of(0, 0) is None
    assert share_of(1, 8) == 0.125
    assert paired_bound([], seed=1).count == 0

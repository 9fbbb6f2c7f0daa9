"""Figures: percentiles that are values that were seen, and one form for every result."""

from __future__ import annotations

import msgspec
import pytest

from network.bench.conditions import Result, latency_figures, measure_conditions, percentile


def test_a_percentile_was_measured_and_nothing_measured_is_zero() -> None:
    values = [5.0, 1.0, 9.0, 3.0, 7.0]
    assert [percentile(values, share) for share in (0.0, 0.5, 0.95, 1.0)] == [1.0, 5.0, 9.0, 9.0]
    assert latency_figures([]) == {"p50_ms": 0.0, "p95_ms": 0.0, "p99_ms": 0.0, "mean_ms": 0.0}


@pytest.mark.parametrize(("share", "expected"), [(0.5, 50.0), (0.95, 95.0), (0.99, 99.0), (1.0, 100.0)])
def test_percentiles_of_a_hundred(share: float, expected: float) -> None:
    assert percentile([float(value) for value in range(1, 101)], share) == expected


def test_a_result_names_its_units_and_conditions() -> None:
    conditions = measure_conditions(nodes=4, seed=7, batch=2)
    result = Result(name="tx", ok=True, figures=latency_figures([1.0]), conditions=conditions)
    assert list(msgspec.to_builtins(result)) == ["name", "ok", "figures", "conditions"]
    assert {"nodes", "cores", "load", "python", "seed", "batch"} <= set(conditions)
    assert conditions["cores"] >= 1
    assert all(name.endswith("_ms") for name in result.figures)

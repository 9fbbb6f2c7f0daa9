"""A sweep plays all seeds, and cuts the plans of those that broke a promise down. Nothing here plays a network."""

from __future__ import annotations

import pytest

from network.sim import sweep as sweeping
from network.sim.checkers import Violation
from network.sim.plan import Plan
from network.sim.run import RunResult


def test_of_seeds_that_break_a_promise_it_says_which_plans_it_cuts_down(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = (Violation("agreement", 1.0, 0, "two blocks"),)

    def play(plan: Plan) -> RunResult:
        return RunResult(plan.seed, "", broken if plan.seed % 2 else (), 10, 10, 0, 0, 1.0, 0.1)

    monkeypatch.setattr(sweeping, "play", play)
    shrunk: list[int] = []
    plans = [sweeping.plan_of(seed, 4, 20, 0) for seed in range(10)]
    total = sweeping.sweep(plans, workers=1, on_shrink=shrunk.append)
    assert shrunk == [1, 3, 5] == [failure.seed for failure in total.failures]
    assert [result.seed for result in total.failed] == [1, 3, 5, 7, 9]
    assert all(failure.shrunk.faults == () for failure in total.failures)
    assert total.violations == 5

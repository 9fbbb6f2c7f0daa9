"""Budgets of work: they fill with time, hold no more than a burst, and one source's debt is nobody else's."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from node.limits.token_buckets import Allowance, TokenBuckets, over_budget

ALLOWANCE = Allowance(us_per_s=1_000, burst_us=5_000)


class _Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def _budgets(clock: _Clock, max_count: int = 10) -> TokenBuckets[str]:
    return TokenBuckets(lambda _source: ALLOWANCE, clock, max_count)


def test_a_burst_is_there_at_once_and_then_work_goes_on_at_the_steady_rate() -> None:
    clock = _Clock()
    budgets = _budgets(clock)
    assert budgets.take("a", 5_000)
    assert not budgets.take("a", 100)
    assert budgets.wait_s("a", 100) == 0.1
    clock.now_s = 0.1
    assert budgets.take("a", 100)


def test_one_sources_debt_is_no_other_ones_and_a_refusal_says_when_to_try_again() -> None:
    budgets = _budgets(_Clock())
    budgets.charge("a", 50_000)
    assert budgets.wait_s("a") > 40
    assert budgets.take("b", 5_000)
    assert over_budget("peer b", 0.2).context["retry_after_s"] == 1
    assert over_budget("peer b", 1e9).context["retry_after_s"] == 60


def test_what_is_given_back_goes_to_the_bucket_that_paid_and_never_makes_more() -> None:
    clock = _Clock()
    budgets = _budgets(clock)
    charge = budgets.take("a", 4_000)
    assert charge is not None
    charge.give_back(1_000)
    charge.give_back()
    charge.give_back()
    assert budgets.take("a", 5_000)
    late = budgets.take("b", 4_000)
    assert late is not None
    clock.now_s = 100.0
    late.give_back()
    assert budgets.take("b", 5_000)
    assert not budgets.take("b", 100)
    budgets = _budgets(_Clock(), max_count=1)
    charge = budgets.take("a", 4_000)
    assert charge is not None
    budgets.take("b", 5_000)
    charge.give_back()
    assert not budgets.take("b", 100)


def test_one_receipt_gives_nothing_back_of_what_another_paid() -> None:
    budgets = _budgets(_Clock())
    charge, kept = budgets.take("a", 2_000), budgets.take("a", 3_000)
    assert charge is not None
    assert kept is not None
    for _ in range(2):
        charge.give_back()
    assert budgets.take("a", 2_000)
    assert not budgets.take("a", 100)


def test_the_table_stays_bounded_and_forgets_who_was_not_seen_for_longest() -> None:
    budgets = _budgets(_Clock(), max_count=3)
    budgets.take("loud", 5_000)
    for number in range(10):
        budgets.take("loud", 1)
        budgets.take(str(number), 1)
    assert len(budgets) == 3
    assert not budgets.take("loud", 100)


def test_a_clock_that_is_put_back_gives_nothing() -> None:
    clock = _Clock()
    clock.now_s = 100.0
    budgets = _budgets(clock)
    assert budgets.take("a", 5_000)
    clock.now_s = 0.0
    assert not budgets.take("a", 100)


@given(st.lists(st.tuples(st.floats(0, 3), st.integers(1, 6_000)), max_size=60))
def test_nobody_gets_more_than_a_burst_and_the_steady_rate(steps: list[tuple[float, int]]) -> None:
    clock = _Clock()
    budgets = _budgets(clock)
    taken = 0
    for pause_s, cost_us in steps:
        clock.now_s += pause_s
        if budgets.take("a", cost_us):
            taken += cost_us
    assert taken <= ALLOWANCE.burst_us + ALLOWANCE.us_per_s * clock.now_s + len(steps)

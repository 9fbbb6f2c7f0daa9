"""The longest time without finality, out of the moments at which calls became final."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from network.bench.finality_probe import longest_gap_s


def test_both_ends_of_the_window_count_and_nothing_final_is_a_gap_as_long_as_it() -> None:
    assert longest_gap_s([1.0, 1.5], 0.0, 2.0) == 1.0
    assert longest_gap_s([0.25, 1.5], 0.0, 2.0) == 1.25
    assert longest_gap_s([0.1, 0.2], 0.0, 2.0) == 1.8
    assert longest_gap_s([], 3.0, 7.0) == 4.0
    assert longest_gap_s([1.0, 9.0], 3.0, 7.0) == 4.0


@given(st.lists(st.floats(0, 10)), st.floats(0, 10))
def test_one_more_moment_never_makes_the_gap_longer(moments: list[float], more: float) -> None:
    assert longest_gap_s([*moments, more], 0.0, 10.0) <= longest_gap_s(moments, 0.0, 10.0)

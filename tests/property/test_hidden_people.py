"""Whoever stands beside somebody who is seen, and is not seen, counts as hidden: whatever was seen of them before."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from clients.robot.hiding.segmentation import Silhouette
from clients.robot.matching.tracking import LOST_AFTER_MS, UNSEEN_CERTAIN_MS, Tracker

PLACES = st.lists(st.tuples(st.floats(-0.55, 0.55), st.floats(2.6, 3.4)), min_size=2, max_size=4)
STORY = st.lists(st.tuples(st.integers(0, 15), st.integers(1, 25)), max_size=6)


def seen(x_m: float, z_m: float) -> Silhouette:
    return Silhouette(1, (0, 0, 1, 1), x_m, z_m, math.hypot(x_m, z_m), round(z_m * 1000), "", ahead_m=z_m, right_m=x_m)


@given(people=PLACES, story=STORY, last=st.integers(1, 14), step_ms=st.sampled_from([33, 100, 200]))
def test_of_people_close_together_who_is_not_seen_counts_as_hidden(
    people: list[tuple[float, float]], story: list[tuple[int, int]], last: int, step_ms: int
) -> None:
    """`story` has who is seen (bits) for how many frames; at the end some are seen and some are not, for a second."""
    everybody = (1 << len(people)) - 1
    # Where nobody is seen for longer, all may have walked away.
    story = [(who, count) for who, count in story if who & everybody or count * step_ms <= UNSEEN_CERTAIN_MS]
    last &= everybody
    if last in {0, everybody}:
        last = 1
    tracker, at_ms = Tracker(), 0
    for who, count in [(everybody, 1), *story, (last, LOST_AFTER_MS // step_ms + 3)]:
        for _ in range(count):
            tracker.step(tuple(seen(*place) for number, place in enumerate(people) if who >> number & 1), at_ms)
            at_ms += step_ms
    assert tracker.hidden_ranges

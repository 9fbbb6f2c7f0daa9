"""Following people from frame to frame: the same number while it is certain, a new one after any doubt."""

from __future__ import annotations

import math

import pytest

from clients.robot.hiding.segmentation import Silhouette
from clients.robot.hiding.tracking import Tracker


def seen(x_m: float, z_m: float, trouble: str = "") -> Silhouette:
    return Silhouette(1, (0, 0, 1, 1), x_m, z_m, math.hypot(x_m, z_m), round(z_m * 1000), trouble)


def test_tracks_keep_their_numbers_while_people_walk() -> None:
    tracker = Tracker()
    for step in range(60):
        first, second = tracker.step((seen(-1 + step * 0.03, 2.5), seen(1 - step * 0.03, 4.5)), step * 33)
        assert first is not None
        assert second is not None
        assert (first.number, second.number) == (1, 2)


def test_a_merged_blob_is_nobody_and_ends_both_tracks() -> None:
    tracker = Tracker()
    tracker.step((seen(-0.3, 2.5), seen(0.3, 2.5)), 0)
    assert tracker.step((seen(0.0, 2.5, "merged"),), 33) == [None]
    after = tracker.step((seen(-0.3, 2.5), seen(0.3, 2.5)), 66)
    assert {track.number for track in after if track is not None} == {3, 4}


def test_when_one_vanishes_into_the_other_both_begin_anew() -> None:
    tracker = Tracker()
    tracker.step((seen(-0.2, 2.5), seen(0.2, 2.6)), 0)
    (only,) = tracker.step((seen(0.0, 2.5),), 33)
    assert only is not None
    assert only.number == 3


def test_someone_lost_for_a_second_comes_back_as_somebody_new() -> None:
    tracker = Tracker()
    tracker.step((seen(0.0, 2.5),), 0)
    for step in range(1, 40):
        tracker.step((), step * 33)
    (back,) = tracker.step((seen(0.0, 2.5),), 1_400)
    assert back is not None
    assert back.number == 2


@pytest.mark.parametrize("apart_m", [0.3, 0.5])
@pytest.mark.parametrize("gap", range(11, 30, 3))
def test_two_who_cross_while_nobody_is_seen_are_never_exchanged(gap: int, apart_m: float) -> None:
    for crossing in range(1, gap):
        tracker = Tracker()
        numbers: list[set[int]] = [set(), set()]
        for step in range(-20, gap + 10):
            if 0 < step < gap:
                continue
            x = (step - crossing) / 30
            both = tracker.step((seen(x, 3.0), seen(-x, 3.0 + apart_m)), (step + 30) * 33)
            for mine, track in zip(numbers, both, strict=True):
                mine.update([track.number] if track is not None else [])
        assert not numbers[0] & numbers[1]


def test_after_a_gap_someone_who_may_be_either_of_two_is_somebody_new() -> None:
    tracker = Tracker()
    tracker.step((seen(-0.3, 3.0), seen(0.3, 3.0)), 0)
    (only,) = tracker.step((seen(-0.2, 3.0),), 600)
    assert only is not None
    assert only.number == 3


def test_of_two_who_come_back_where_one_was_neither_is_taken_for_the_one() -> None:
    tracker = Tracker()
    tracker.step((seen(0.0, 3.0),), 0)
    back = tracker.step((seen(-0.3, 3.0), seen(0.3, 3.2)), 600)
    assert {track.number for track in back if track is not None} == {2, 3}


def test_a_person_alone_keeps_the_number_over_a_gap_and_so_do_two_far_apart() -> None:
    tracker = Tracker()
    tracker.step((seen(-2.0, 3.0), seen(2.0, 5.0)), 0)
    back = tracker.step((seen(-1.9, 3.0), seen(2.1, 5.0)), 800)
    assert [track.number for track in back if track is not None] == [1, 2]

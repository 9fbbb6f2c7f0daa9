"""Following people from frame to frame: the same number while it is certain, a new one after any doubt."""

from __future__ import annotations

import math

import pytest

from clients.robot.hiding.segmentation import Silhouette
from clients.robot.matching.tracking import GONE_MS, HIDDEN_MS, LOST_AFTER_MS, UNSEEN_BESIDE_MS, Tracker


def seen(x_m: float, z_m: float, withhold_reason: str = "") -> Silhouette:
    return Silhouette(
        1, (0, 0, 1, 1), x_m, z_m, math.hypot(x_m, z_m), round(z_m * 1000), withhold_reason, ahead_m=z_m, right_m=x_m
    )


def test_tracks_keep_their_numbers_while_people_walk() -> None:
    tracker = Tracker()
    for step in range(60):
        first, second = tracker.step((seen(-1 + step * 0.03, 2.5), seen(1 - step * 0.03, 4.5)), step * 33)
        assert first is not None
        assert second is not None
        assert (first.number, second.number) == (1, 2)


def test_who_merges_or_vanishes_into_another_ends_both_tracks() -> None:
    tracker = Tracker()
    tracker.step((seen(-0.3, 2.5), seen(0.3, 2.5)), 0)
    assert tracker.step((seen(0.0, 2.5, "merged"),), 33) == [None]
    after = tracker.step((seen(-0.3, 2.5), seen(0.3, 2.5)), 66)
    assert {track.number for track in after if track is not None} == {3, 4}
    tracker = Tracker()
    tracker.step((seen(-0.2, 2.5), seen(0.2, 2.6)), 0)
    (only,) = tracker.step((seen(0.0, 2.5),), 33)
    assert only is not None
    assert only.number == 3


def test_after_a_gap_only_who_can_be_nobody_else_keeps_the_number() -> None:
    tracker = Tracker()
    tracker.step((seen(0.0, 2.5),), 0)
    for step in range(1, 40):
        tracker.step((), step * 33)
    (back,) = tracker.step((seen(0.0, 2.5),), 1_400)
    assert back is not None
    assert back.number == 2
    tracker = Tracker()
    tracker.step((seen(-0.3, 3.0), seen(0.3, 3.0)), 0)
    (only,) = tracker.step((seen(-0.2, 3.0),), 600)
    assert only is not None
    assert only.number == 3
    tracker = Tracker()
    tracker.step((seen(0.0, 3.0),), 0)
    back = tracker.step((seen(-0.3, 3.0), seen(0.3, 3.2)), 600)
    assert {track.number for track in back if track is not None} == {2, 3}
    tracker = Tracker()
    tracker.step((seen(-2.0, 3.0), seen(2.0, 5.0)), 0)
    back = tracker.step((seen(-1.9, 3.0), seen(2.1, 5.0)), 800)
    assert [track.number for track in back if track is not None] == [1, 2]


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


TWO = (seen(-0.3, 2.5), seen(0.3, 2.5))
MERGED = (seen(0.0, 2.5, "merged"),)


def hidden(tracker: Tracker, silhouettes: tuple[Silhouette, ...], at_ms: int) -> bool:
    tracker.step(silhouettes, at_ms)
    return bool(tracker.hidden_ranges)


def test_of_two_who_went_together_and_one_is_seen_the_other_counts_as_hidden_until_seen() -> None:
    tracker = Tracker()
    assert not hidden(tracker, TWO, 0)
    assert not hidden(tracker, MERGED, 33)
    for at_ms in range(66, 5_000, 33):
        assert hidden(tracker, (seen(0.0, 2.5),), at_ms)
    assert not hidden(tracker, (seen(0.0, 2.5), seen(0.9, 2.7)), 5_000)
    assert not hidden(tracker, (seen(0.0, 2.5),), 5_033)


def test_who_vanished_beside_another_counts_as_hidden_and_who_is_seen_again_does_not() -> None:
    tracker = Tracker()
    assert not hidden(tracker, (seen(-0.2, 2.5), seen(0.2, 2.6)), 0)
    assert hidden(tracker, (seen(0.0, 2.5),), 33)
    tracker = Tracker()
    for silhouettes, at_ms in ((TWO, 0), (MERGED, 33), (MERGED, 66), (TWO, 100)):
        assert not hidden(tracker, silhouettes, at_ms)


def test_who_left_the_other_or_walked_out_alone_is_not_hidden() -> None:
    tracker = Tracker()
    hidden(tracker, TWO, 0)
    hidden(tracker, MERGED, 33)
    leaving = seen(0.9, 2.5)
    for at_ms in range(66, 400, 33):
        hidden(tracker, (seen(-0.2, 2.5, "merged"), leaving), at_ms)
    assert not hidden(tracker, (seen(-0.2, 2.5), leaving), 400)
    tracker = Tracker()
    for step in range(60):
        assert not hidden(tracker, (seen(-0.9, 2.5), seen(0.3 + step * 0.03, 2.5)), step * 33)
    for step in range(60, 120):
        assert not hidden(tracker, (seen(-0.9, 2.5),), step * 33)


def test_nobody_is_hidden_for_ever_nor_by_two_who_left_together() -> None:
    tracker = Tracker()
    hidden(tracker, MERGED, 0)
    hidden(tracker, (seen(0.0, 2.5),), 33)
    for at_ms in range(66, HIDDEN_MS, 200):
        assert hidden(tracker, (seen(0.0, 2.5),), at_ms)
    assert not hidden(tracker, (seen(0.0, 2.5),), HIDDEN_MS + 33)
    gone = Tracker()
    hidden(gone, MERGED, 0)
    hidden(gone, (), GONE_MS)
    assert not hidden(gone, (seen(0.0, 2.5),), GONE_MS + 33)


def test_who_comes_back_alone_still_hides_the_other_and_a_stranger_is_not_the_hidden_one() -> None:
    tracker = Tracker()
    hidden(tracker, MERGED, 0)
    for at_ms in range(33, 8_000, 33):
        assert hidden(tracker, (seen(0.0, 2.5),), at_ms)
    for at_ms in range(8_000, 9_300, 33):
        hidden(tracker, (), at_ms)
    assert hidden(tracker, (seen(0.1, 2.5),), 9_300)
    tracker = Tracker()
    hidden(tracker, MERGED, 0)
    for at_ms in range(33, 5_000, 33):
        hidden(tracker, (seen(0.0, 2.5),), at_ms)
    for at_ms in range(5_000, 8_000, 33):
        assert hidden(tracker, (seen(0.0, 2.5), seen(1.6, 2.5)), at_ms)


def test_of_three_who_went_together_or_two_who_may_have_been_exchanged_the_unseen_counts_as_hidden() -> None:
    tracker = Tracker()
    hidden(tracker, (*TWO, seen(0.0, 2.8)), 0)
    hidden(tracker, MERGED, 33)
    assert hidden(tracker, TWO, 66)
    assert not hidden(tracker, (*TWO, seen(0.0, 3.4)), 500)
    tracker = Tracker()
    tracker.step((seen(-0.3, 2.5), seen(0.3, 2.5)), 0)
    assert hidden(tracker, (seen(0.0, 2.5),), 500)
    assert not hidden(tracker, (seen(0.0, 2.5), seen(0.9, 2.5)), 533)


def test_who_is_lost_from_sight_beside_another_may_stand_just_outside() -> None:
    tracker = Tracker()
    for step in range(60):
        assert not hidden(tracker, (seen(0.0 + step * 0.01, 2.0), seen(1.0 + step * 0.01, 2.1)), step * 33)
    alone = seen(0.6, 2.0)
    for step in range(60, 95):
        hidden(tracker, (alone,), step * 33)
    assert hidden(tracker, (alone,), 95 * 33)
    assert not hidden(tracker, (alone, seen(1.5, 2.1)), 4_000)


@pytest.mark.parametrize("gap_ms", [310, 390, 500])
def test_who_was_exchanged_and_swallowed_in_one_step_counts_once(gap_ms: int) -> None:
    tracker = Tracker()
    tracker.step((seen(-0.2, 3.0), seen(0.2, 3.0)), 0)
    assert hidden(tracker, (seen(0.0, 3.0),), gap_ms)
    assert not hidden(tracker, (seen(-0.4, 3.0), seen(0.4, 3.0)), gap_ms + 33)


@pytest.mark.parametrize("gap_ms", [310, 390])
def test_who_was_swallowed_beside_two_who_were_exchanged_counts_too(gap_ms: int) -> None:
    tracker = Tracker()
    tracker.step((seen(-0.2, 3.0), seen(0.2, 3.0), seen(0.0, 3.4)), 0)
    assert hidden(tracker, (seen(0.0, 3.1),), gap_ms)
    assert hidden(tracker, (seen(-0.4, 3.0), seen(0.4, 3.0)), gap_ms + 33)
    assert not hidden(tracker, (seen(-0.4, 3.0), seen(0.4, 3.0), seen(0.0, 3.6)), gap_ms + 66)


def test_who_is_swallowed_counts_while_two_others_may_have_been_exchanged_in_that_very_step() -> None:
    """Of three, two are found after a gap and may be either; the third is near one of them alone."""
    tracker = Tracker()
    tracker.step((seen(-0.2, 3.0), seen(0.3, 3.0), seen(-0.7, 3.0)), 0)
    found = (seen(-0.2, 3.0), seen(0.3, 3.0))
    for at_ms in range(350, 3_000, 33):
        assert hidden(tracker, found, at_ms)
    assert not hidden(tracker, (*found, seen(-0.8, 3.2)), 3_000)


def test_who_is_lost_beside_two_who_may_have_been_exchanged_counts_though_they_are_followed_anew() -> None:
    tracker = Tracker()
    tracker.step((seen(-0.2, 3.0), seen(0.3, 3.0), seen(-0.65, 3.6)), 0)
    tracker.step((seen(-0.65, 3.6),), 330)
    for at_ms in range(400, 1_340, 33):
        tracker.step((seen(-0.2, 3.0), seen(0.3, 3.0)), at_ms)
    assert hidden(tracker, (seen(-0.2, 3.0), seen(0.3, 3.0)), 1_400)


def test_who_is_followed_anew_beside_somebody_hidden_is_not_taken_for_the_hidden_one() -> None:
    """Two go together and one is seen; in no frame of what follows may the other be forgotten."""
    tracker = Tracker()
    assert not hidden(tracker, TWO, 0)
    assert not hidden(tracker, MERGED, 33)
    assert hidden(tracker, (seen(0.0, 2.5),), 66)
    # A third comes by at once, both are lost for a moment, and the two who are found may be either of the three.
    assert hidden(tracker, (seen(0.0, 2.5), seen(2.0, 2.5)), 99)
    assert hidden(tracker, (seen(0.0, 2.5), seen(1.6, 2.5)), 132)
    assert hidden(tracker, (seen(0.2, 2.5), seen(0.6, 2.5)), 700)


def test_who_are_seen_one_after_the_other_are_not_taken_for_seen_both() -> None:
    tracker = Tracker()
    one, other = seen(0.0, 2.75), seen(0.5, 3.0)
    for silhouettes, at_ms in (((one, other), 0), ((one,), 33), ((other,), 66)):
        tracker.step(silhouettes, at_ms)
    for at_ms in range(99, 1_500, 33):
        tracker.step((one,), at_ms)
    assert hidden(tracker, (one,), 1_500)


@pytest.mark.parametrize(
    ("last_seen", "hidden"), [((0.3, 2.9), True), ((1.4, 2.9), False)], ids=["beside", "further away"]
)
def test_who_was_seen_beside_a_person_and_is_not_seen_now_may_show_through(
    last_seen: tuple[float, float], *, hidden: bool
) -> None:
    tracker = Tracker()
    (before, _) = tracker.step((seen(-0.4, 2.2), seen(*last_seen)), 0)
    (track,) = tracker.step((seen(-0.4, 2.2),), 500)
    assert track is before
    assert track is not None
    assert tracker.may_hide_somebody(track, 500) == hidden
    tracker.step((seen(-0.4, 2.2), seen(*last_seen)), 600)
    assert not tracker.may_hide_somebody(track, 600), "both are seen"


def test_who_has_been_gone_for_long_shows_through_nobody() -> None:
    tracker = Tracker()
    tracker.step((seen(-0.4, 2.2), seen(0.3, 2.9)), 0)
    hiding = set()
    for at_ms in range(100, 2 * UNSEEN_BESIDE_MS, 100):
        (track,) = tracker.step((seen(-0.4, 2.2),), at_ms)
        assert track is not None
        if tracker.may_hide_somebody(track, at_ms):
            hiding.add(at_ms)
    assert hiding >= set(range(100, UNSEEN_BESIDE_MS, 100))
    assert max(hiding) < UNSEEN_BESIDE_MS + LOST_AFTER_MS, "from when they were last seen, or last known to be together"

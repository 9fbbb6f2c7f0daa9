"""Following people from frame to frame: the same number while it is certain, a new one after any doubt."""

from __future__ import annotations

import math

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

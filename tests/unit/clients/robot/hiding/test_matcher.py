"""Binding tags to people by what readers measured: sure when it can be, silent when it cannot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clients.robot.events import Facing, Sighting
from clients.robot.hiding.likelihood import RangeReading, log_absent, log_antenna, log_visible
from clients.robot.hiding.matcher import Matcher
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.hiding.tracking import Track, Tracker

SIGMA_M = 0.3


def walker(number: int, middle_m: float, *, swing_m: float = 0.6, seconds: float = 15.0) -> Track:
    """A person who walks to and fro along the corridor, followed at 10 Hz."""
    times = [round(100 * i) for i in range(round(seconds * 10))]
    ranges = [middle_m + swing_m * math.sin(at / 900) for at in times]
    return Track(number, times[0], times[-1], 0.0, middle_m, times=times, ranges=ranges)


def reading(at_ms: int, distance_m: float | None, facing: Facing = Facing.FRONT) -> Sighting:
    return Sighting(at_ms, at_ms, "", 1, facing, -50.0, distance_m, None if distance_m is None else SIGMA_M)


def worn_by(track: Track, rng: np.random.Generator, *, every_ms: int = 500) -> list[Sighting]:
    ranges = {at: track.range_at(at) for at in range(0, track.seen_ms, every_ms)}
    return [reading(at, r + float(rng.normal(0, SIGMA_M))) for at, r in ranges.items() if r is not None]


def bind(tracks: list[Track], sightings: list[Sighting]) -> Matcher:
    matcher = Matcher()
    for track in tracks:
        matcher.add_track(track)
    for sighting in sightings:
        matcher.add_sighting("tag", sighting)
        matcher.evaluate("tag")
    return matcher


@pytest.mark.parametrize("seed", range(10))
def test_a_walking_bearer_is_told_from_a_rival_further_away(seed: int) -> None:
    mine, rival = walker(1, 2.5), walker(2, 4.2, swing_m=0.4)
    matcher = bind([mine, rival], worn_by(mine, np.random.default_rng(seed)))
    assert matcher.bound_track("tag", [1, 2]) == 1


@pytest.mark.parametrize("seed", range(10))
def test_two_who_walk_side_by_side_are_never_chosen_between(seed: int) -> None:
    mine, rival = walker(1, 2.5), walker(2, 2.55)
    matcher = bind([mine, rival], worn_by(mine, np.random.default_rng(seed)))
    assert matcher.bound_track("tag", [1, 2]) is None


@pytest.mark.parametrize("seed", range(30))
def test_a_bearer_behind_the_robot_binds_to_nobody_even_at_the_same_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen = [reading(at, 2.5 + float(rng.normal(0, SIGMA_M)), Facing.BACK) for at in range(0, 15_000, 500)]
    assert bind([walker(1, 2.5, swing_m=0.1)], seen).bound_track("tag", [1]) is None


def test_readings_without_distance_bind_nothing() -> None:
    matcher = bind([walker(1, 2.5)], [reading(at, None) for at in range(0, 15_000, 200)])
    assert matcher.bound_track("tag", [1]) is None
    assert not matcher.has_distance("tag")


def test_the_same_reading_repeated_is_one_reading() -> None:
    once = [reading(at, 2.5) for at in (0, 500)]
    assert bind([walker(1, 2.5)], once * 50).log_odds("tag") == {}


def test_a_binding_ends_when_the_readings_turn_against_it() -> None:
    track, rng = walker(1, 2.5, seconds=30), np.random.default_rng(1)
    matcher = bind([track], [s for s in worn_by(track, rng) if s.first_seen_ms < 10_000])
    assert matcher.bound_track("tag", [1]) == 1
    for at in range(10_000, 20_000, 250):
        matcher.add_sighting("tag", reading(at, 6.0, Facing.BACK))
        matcher.evaluate("tag")
    assert matcher.bound_track("tag", [1]) is None


def test_old_tracks_and_readings_are_forgotten() -> None:
    track = walker(1, 2.5)
    matcher = bind([track], worn_by(track, np.random.default_rng(2)))
    matcher.forget_before(track.seen_ms + 60_000)
    assert matcher.bound_track("tag", [1]) is None
    assert matcher.log_odds("tag") == {}


def test_likelihoods_prefer_the_truth() -> None:
    follow = [RangeReading(500 * i, 2.5 + 0.5 * math.sin(i), SIGMA_M, 2.5 + 0.5 * math.sin(i)) for i in range(20)]
    contrary = [RangeReading(500 * i, 2.5 + 0.5 * math.sin(i), SIGMA_M, 2.5 - 0.5 * math.sin(i)) for i in range(20)]
    assert log_visible(follow) > log_absent(follow)
    assert log_visible(contrary) < log_absent(contrary)
    assert log_antenna(10, 0) > 0 > log_antenna(0, 10)


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

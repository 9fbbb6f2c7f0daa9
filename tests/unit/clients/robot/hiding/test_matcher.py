"""Binding tags to people by what readers measured: sure when it can be, silent when it cannot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clients.robot.events import Facing, Sighting
from clients.robot.hiding.matcher import Matcher
from clients.robot.hiding.tracking import Track

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
        matcher.advance(sighting.middle_ms)
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
        matcher.advance(at)
    assert matcher.bound_track("tag", [1]) is None


def test_old_tracks_and_readings_are_forgotten() -> None:
    track = walker(1, 2.5)
    matcher = bind([track], worn_by(track, np.random.default_rng(2)))
    matcher.forget_before(track.seen_ms + 60_000)
    assert matcher.bound_track("tag", [1]) is None
    assert matcher.log_odds("tag") == {}

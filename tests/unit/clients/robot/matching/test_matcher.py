"""Binding tags to people by what readers measured: sure when it can be, silent when it cannot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from clients.robot.matching.match_evidence import BIND_LOG_ODDS, DISTANCE_LOG_ODDS_MIN, Obstacle
from clients.robot.matching.matcher import TAGS_MAX_COUNT, Matcher
from clients.robot.matching.tracking import Track
from clients.robot.sensing.sensor_events import DISTANCE_SIGMA_MAX_M as SIGMA_MAX_M
from clients.robot.sensing.sensor_events import Facing, Sighting

SIGMA_M = 0.3


def walker(number: int, middle_m: float, *, swing_m: float = 0.6, seconds: float = 15.0) -> Track:
    """A person who walks to and fro along the corridor, followed at 10 Hz."""
    times = [round(100 * i) for i in range(round(seconds * 10))]
    ranges = [middle_m + swing_m * math.sin(at / 900) for at in times]
    bearings = [0.0] * len(times)
    return Track(number, times[0], times[-1], 0.0, middle_m, times=times, ranges=ranges, bearings=bearings)


def reading(at_ms: int, distance_m: float | None, facing: Facing = Facing.FRONT) -> Sighting:
    return Sighting(at_ms, at_ms, "", 1, facing, -50.0, distance_m, None if distance_m is None else SIGMA_M)


def worn_by(track: Track, rng: np.random.Generator, *, every_ms: int = 500) -> list[Sighting]:
    places = {at: track.place_at(at) for at in range(0, track.seen_ms, every_ms)}
    return [reading(at, place[0] + float(rng.normal(0, SIGMA_M))) for at, place in places.items() if place is not None]


def bind(tracks: list[Track], sightings: list[Sighting], *, drives: bool = False) -> Matcher:
    matcher = Matcher(drives=drives)
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


def test_readings_without_distance_or_against_the_picture_bind_nobody() -> None:
    matcher = bind([walker(1, 2.5)], [reading(at, None) for at in range(0, 15_000, 200)])
    assert matcher.bound_track("tag", [1]) is None
    assert not matcher.has_distance("tag")
    track, noise = walker(1, 2.5, seconds=30), np.random.default_rng(5)
    wild = [reading(at, 2.5 + float(noise.choice([-1.5, 1.5]))) for at in range(0, 20_000, 500)]
    told = bind([track], wild).explain("tag", [1])
    assert told is not None
    assert abs(told.gap_m) < 0.6
    assert told.spread_m > 1.2
    assert (told.obstacle, told.delay_ms) == (Obstacle.OFF, None)


@pytest.mark.parametrize(("factor", "sigma_m"), [(1.0, 50.0), (1.0, 5.0), (1000.0, 100.0), (1000.0, 1.0)])
def test_distances_that_say_nothing_of_where_the_bearer_is_bind_nobody(factor: float, sigma_m: float) -> None:
    """Antennas alone must not bind: that the tag is in front of the robot is true of others, too."""
    track = walker(1, 2.5)
    right = worn_by(track, np.random.default_rng(3))
    seen = [replace(one, distance_m=(one.distance_m or 0) * factor, sigma_m=sigma_m) for one in right]
    assert bind([track], seen).bound_track("tag", [1]) is None


def test_distances_have_to_speak_for_the_bearer_by_themselves() -> None:
    """With the largest error that is taken, one reading in front after another is not enough: distances must fit, too."""
    track = walker(1, 2.5, seconds=40)
    seen = worn_by(track, np.random.default_rng(3))[:6]
    evidence = bind([track], [replace(one, sigma_m=SIGMA_MAX_M) for one in seen])
    told = evidence.explain("tag", [1])
    assert told is not None
    assert told.distance_log_odds < DISTANCE_LOG_ODDS_MIN
    assert told.log_odds >= BIND_LOG_ODDS
    assert told.obstacle is Obstacle.VAGUE
    assert evidence.bound_track("tag", [1]) is None


@pytest.mark.parametrize("late_ms", [3_000, -2_000])
def test_distances_that_come_with_a_delay_are_told_from_bad_ones_by_how_much(late_ms: int) -> None:
    track = walker(1, 2.5, seconds=30)
    track.ranges = [range_m + 0.5 * math.sin(at / 2_700) for at, range_m in zip(track.times, track.ranges, strict=True)]
    right = [one for one in worn_by(track, np.random.default_rng(3)) if 3_000 <= one.first_seen_ms < 25_000]
    late = [
        replace(one, first_seen_ms=one.first_seen_ms + late_ms, last_seen_ms=one.last_seen_ms + late_ms)
        for one in right
    ]
    exact = [replace(one, sigma_m=0.2) for one in late]
    told = bind([track], exact).explain("tag", [1])
    assert told is not None
    assert told.obstacle is Obstacle.DELAYED
    assert told.delay_ms == pytest.approx(late_ms, abs=500)


def test_distances_in_another_unit_are_told_as_that() -> None:
    track = walker(1, 2.5)
    right = worn_by(track, np.random.default_rng(3))
    for factor in (1000.0, 100.0, 0.01):
        told = bind([track], [replace(one, distance_m=(one.distance_m or 0) * factor) for one in right]).explain(
            "tag", [1]
        )
        assert told is not None
        assert told.obstacle is Obstacle.UNIT


def test_a_reading_that_is_repeated_or_part_of_a_storm_counts_as_few() -> None:
    once = [reading(at, 2.5) for at in (0, 500)]
    assert bind([walker(1, 2.5)], once * 50).log_odds("tag") == {}
    matcher = Matcher()
    matcher.add_track(walker(1, 2.5))
    for i in range(10_000):
        matcher.add_sighting("tag", Sighting(i // 10, i // 10, "", 1, Facing.FRONT, -50.0, 2.5 + i % 10 / 10, 0.3))
    assert matcher.held_count == 10


def test_a_binding_ends_when_readings_turn_against_it_however_old_what_spoke_for_it() -> None:
    track, rng = walker(1, 2.5, seconds=30), np.random.default_rng(1)
    matcher = bind([track], [s for s in worn_by(track, rng) if s.first_seen_ms < 10_000])
    assert matcher.bound_track("tag", [1]) == 1
    for at in range(10_000, 20_000, 250):
        matcher.add_sighting("tag", reading(at, 6.0, Facing.BACK))
        matcher.advance(at)
    assert matcher.bound_track("tag", [1]) is None
    track = walker(1, 2.5, seconds=120)
    readings = [s for s in worn_by(track, np.random.default_rng(13)) if s.middle_ms < 80_000]
    elsewhere = [reading(at, 5.0, Facing.BACK) for at in range(80_000, 110_000, 500)]
    assert bind([track], readings).bound_track("tag", [1]) == 1
    assert bind([track], readings + elsewhere).bound_track("tag", [1]) is None


def beside_somebody_unfollowed(matcher: Matcher, readings: list[Sighting], range_m: float = 2.5) -> None:
    for sighting in readings:
        matcher.add_sighting("tag", sighting)
        matcher.note_unfollowed(sighting.middle_ms, [range_m])
        matcher.advance(sighting.middle_ms)


def test_readings_beside_somebody_who_is_not_followed_bind_nobody_and_later_ones_do() -> None:
    track, matcher = walker(1, 2.5, seconds=30), Matcher()
    matcher.add_track(track)
    readings = worn_by(track, np.random.default_rng(12))
    beside_somebody_unfollowed(matcher, readings[:30])
    assert matcher.bound_track("tag", [1]) is None
    for sighting in readings[30:]:
        matcher.add_sighting("tag", sighting)
        matcher.advance(sighting.middle_ms)
    assert matcher.bound_track("tag", [1]) == 1


def test_a_few_readings_beside_nobody_do_not_make_up_for_many_beside_somebody_unfollowed() -> None:
    track, matcher = walker(1, 2.5, seconds=30), Matcher()
    matcher.add_track(track)
    readings = [replace(one, facing=Facing.UNKNOWN) for one in worn_by(track, np.random.default_rng(12))]
    beside_somebody_unfollowed(matcher, readings[:50])
    for sighting in readings[50:56]:
        matcher.add_sighting("tag", sighting)
        matcher.advance(sighting.middle_ms)
    assert matcher.log_odds("tag")[1] > BIND_LOG_ODDS
    assert matcher.bound_track("tag", [1]) is None


def test_who_has_left_or_is_not_followed_is_a_rival_only_near_the_bearer() -> None:
    mine, rival = walker(1, 2.5), walker(2, 2.5)
    matcher = bind([mine, rival], worn_by(mine, np.random.default_rng(3)))
    assert [matcher.bound_track("tag", present) for present in ([1, 2], [1], [2])] == [None] * 3
    track, matcher = walker(1, 2.5, seconds=30), Matcher()
    matcher.add_track(track)
    beside_somebody_unfollowed(matcher, worn_by(track, np.random.default_rng(12)), range_m=5.0)
    assert matcher.bound_track("tag", [1]) == 1


def test_readings_beside_somebody_who_is_not_followed_can_still_end_a_binding() -> None:
    track = walker(1, 2.5, seconds=30)
    matcher = bind([track], [s for s in worn_by(track, np.random.default_rng(1)) if s.first_seen_ms < 10_000])
    beside_somebody_unfollowed(matcher, [reading(at, 2.5) for at in range(10_000, 11_000, 250)])
    assert matcher.bound_track("tag", [1]) == 1
    beside_somebody_unfollowed(matcher, [reading(at, 6.0, Facing.BACK) for at in range(11_000, 20_000, 250)])
    assert matcher.bound_track("tag", [1]) is None


def test_old_tracks_and_readings_are_forgotten() -> None:
    track = walker(1, 2.5)
    matcher = bind([track], worn_by(track, np.random.default_rng(2)))
    matcher.forget_before(track.seen_ms + 60_000)
    assert matcher.bound_track("tag", [1]) is None
    assert matcher.log_odds("tag") == {}


def test_a_tag_heard_by_both_antennas_at_once_counts_for_both() -> None:
    """A body reflects: nine of ten by the front antenna, one by the other, some of them at the same instant."""
    track, rng = walker(1, 2.5), np.random.default_rng(4)
    front = worn_by(track, rng)
    both = front + [replace(s, antenna=2, facing=Facing.BACK) for s in front[::9]]
    matcher = bind([track], both)
    assert matcher.held_count == len(both)
    assert matcher.bound_track("tag", [1]) == 1
    even = [replace(s, antenna=2, facing=Facing.BACK) for s in front]
    assert bind([track], front + even).log_odds("tag")[1] < matcher.log_odds("tag")[1]


def test_a_tag_read_while_two_people_pass_each_other_is_never_given_to_the_other() -> None:
    mine, other = walker(1, 0.0), walker(2, 0.0)
    mine.ranges = [1.5 + 3.0 * at / mine.seen_ms for at in mine.times]
    other.ranges = [4.5 - 3.0 * at / mine.seen_ms for at in mine.times]
    for seed in range(10):
        matcher = Matcher()
        matcher.add_track(mine)
        matcher.add_track(other)
        for sighting in worn_by(mine, np.random.default_rng(seed)):
            matcher.add_sighting("tag", sighting)
            matcher.advance(sighting.middle_ms)
            assert matcher.bound_track("tag", [1, 2]) in (None, 1)
        assert matcher.bound_track("tag", [1, 2]) == 1


def test_two_tags_on_one_person_are_shown_as_neither() -> None:
    track = walker(1, 2.5)
    matcher = Matcher()
    matcher.add_track(track)
    for seed, alias in enumerate(("one", "two")):
        for sighting in worn_by(track, np.random.default_rng(seed)):
            matcher.add_sighting(alias, sighting)
    matcher.advance(track.seen_ms)
    assert matcher.bound_track("one", [1]) is None
    assert matcher.bound_track("two", [1]) is None


def test_somebody_who_comes_into_view_is_a_rival_before_any_reading() -> None:
    track, rng = walker(1, 2.5), np.random.default_rng(6)
    alone = bind([track], worn_by(track, rng))
    newcomer = walker(2, 2.5, seconds=0.4)
    newcomer.began_ms = newcomer.times[0] = 14_000
    again = bind([track, newcomer], worn_by(track, np.random.default_rng(6)))
    assert again.log_odds("tag")[1] <= alone.log_odds("tag")[1]


@pytest.mark.parametrize(
    ("distance_m", "sigma_m"),
    [
        (math.nan, 0.3),
        (math.inf, 0.3),
        (1.1e6, 0.3),
        (1e154, 0.3),
        (1e200, 0.3),
        (2.5, math.nan),
        (2.5, 0.0),
        (2.5, -1.0),
        (-2.5, 0.3),
        (2.5, None),
        (None, 0.3),
    ],
)
def test_a_distance_that_is_none_is_taken_as_no_distance(distance_m: float | None, sigma_m: float | None) -> None:
    bad = [Sighting(at, at, "", 1, Facing.FRONT, -50.0, distance_m, sigma_m) for at in range(0, 15_000, 300)]
    matcher = bind([walker(1, 2.5)], bad)
    assert matcher.log_odds("tag") == {}
    assert not matcher.has_distance("tag")


def test_a_reader_that_claims_to_err_by_a_hair_is_not_believed() -> None:
    track = walker(1, 2.5)
    proud = [replace(s, sigma_m=1e-6) for s in worn_by(track, np.random.default_rng(8))]
    odds = bind([track], proud).log_odds("tag")
    assert all(math.isfinite(value) for value in odds.values())


def test_a_reading_a_day_ahead_or_long_past_is_let_go_and_harms_no_other() -> None:
    track = walker(1, 2.5)
    readings = worn_by(track, np.random.default_rng(9))
    matcher = bind([track], readings[:10])
    for stray_ms in (86_400_000, -86_400_000):
        matcher.add_sighting("tag", reading(stray_ms, 2.5))
    assert matcher.held_count == 10
    for sighting in readings[10:]:
        matcher.add_sighting("tag", sighting)
        matcher.advance(sighting.middle_ms)
    assert matcher.bound_track("tag", [1]) == 1


def test_a_late_reading_weighs_as_if_it_had_come_in_time() -> None:
    track = walker(1, 2.5)
    readings = worn_by(track, np.random.default_rng(10))
    late = readings[:3] + readings[6:] + readings[3:6]
    matcher = Matcher()
    matcher.add_track(track)
    for sighting in late:
        matcher.add_sighting("tag", sighting)
        matcher.advance(track.seen_ms)
    assert matcher.log_odds("tag") == bind([track], readings).log_odds("tag")


def test_a_reading_ahead_of_the_camera_waits_for_it() -> None:
    matcher = Matcher()
    matcher.add_track(walker(1, 2.5))
    for sighting in worn_by(walker(1, 2.5), np.random.default_rng(11)):
        matcher.add_sighting("tag", sighting)
    matcher.advance(0)
    assert matcher.log_odds("tag") == {}
    matcher.finish()
    assert matcher.bound_track("tag", [1]) == 1


def test_who_stands_there_for_minutes_stays_bound_and_old_readings_are_let_go() -> None:
    track = walker(1, 2.5, swing_m=0.05, seconds=150)
    matcher, most = Matcher(), 0
    matcher.add_track(track)
    bound = []
    for sighting in worn_by(track, np.random.default_rng(12)):
        matcher.add_sighting("tag", sighting)
        matcher.advance(sighting.middle_ms)
        most = max(most, matcher.held_count)
        bound.append(matcher.bound_track("tag", [1]))
    first = bound.index(1)
    assert first < 60
    assert set(bound[first:]) == {1}
    assert most <= 2 * 45 + 1


def test_a_storm_of_strangers_pushes_out_those_heard_longest_ago_and_no_tag_of_the_roster() -> None:
    matcher = Matcher()
    for i in range(1_000):
        matcher.add_sighting(f"tag-{i}", reading(i, 2.5))
    assert matcher.held_count == TAGS_MAX_COUNT
    assert matcher.has_distance("tag-999")
    assert not matcher.has_distance("tag-0")
    matcher = Matcher()
    matcher.add_sighting("ann", reading(0, 2.5))
    for i in range(4 * TAGS_MAX_COUNT):
        matcher.add_sighting(f"stranger-{i}", reading(i, 2.5), known=False)
    assert matcher.has_distance("ann")
    assert matcher.has_distance(f"stranger-{4 * TAGS_MAX_COUNT - 1}")
    assert matcher.held_count == TAGS_MAX_COUNT
    matcher = Matcher()
    for i in range(TAGS_MAX_COUNT):
        matcher.add_sighting(f"tag-{i}", reading(i, 2.5))
    matcher.add_sighting("stranger", reading(1_000, 2.5), known=False)
    assert not matcher.has_distance("stranger")
    assert matcher.has_distance("tag-0")


def at_bearing(track: Track, bearing_deg: float) -> Track:
    track.bearings = [bearing_deg] * len(track.times)
    return track


def heard_at(readings: list[Sighting], bearing_deg: float, rng: np.random.Generator) -> list[Sighting]:
    """The same readings, of a reader that tells bearings with an error of 8 degrees."""
    return [
        replace(one, bearing_deg=bearing_deg + float(rng.normal(0, 8.0)), bearing_sigma_deg=8.0) for one in readings
    ]


@pytest.mark.parametrize("seed", range(5))
def test_bearings_tell_two_apart_who_are_as_far_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    left, right = at_bearing(walker(1, 2.5), -18.0), at_bearing(walker(2, 2.5), 18.0)
    readings = worn_by(left, rng)
    assert bind([left, right], readings).bound_track("tag", [1, 2]) is None
    matcher = bind([left, right], heard_at(readings, -18.0, rng))
    assert matcher.bound_track("tag", [1, 2]) == 1
    evidence = matcher.explain("tag", [1, 2])
    assert evidence is not None
    assert evidence.summarise().bearing_log_odds == round(evidence.bearing_log_odds, 1)
    assert evidence.bearings == len(readings)


@pytest.mark.parametrize("seed", range(5))
def test_a_bearer_who_stands_beside_the_picture_binds_nobody_in_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shown = at_bearing(walker(1, 2.5), -10.0)
    readings = worn_by(shown, rng)
    assert bind([shown], readings).bound_track("tag", [1]) == 1, "by the distances alone"
    assert bind([shown], heard_at(readings, 45.0, rng)).bound_track("tag", [1]) is None


@pytest.mark.parametrize("seed", range(10))
def test_a_robot_that_drives_wants_more_than_three_seconds_of_one_equal_distance(seed: int) -> None:
    """Who stands in the picture may be as far away as a bearer beside it; a bearing, or a walk, tells."""
    rng = np.random.default_rng(seed)
    shown = at_bearing(walker(1, 2.5, swing_m=0.0, seconds=3.0), -10.0)
    readings = worn_by(shown, rng)
    assert bind([shown], readings).bound_track("tag", [1]) == 1
    matcher = bind([shown], readings, drives=True)
    assert matcher.bound_track("tag", [1]) is None
    told = matcher.explain("tag", [1])
    assert told is not None
    assert told.is_vague
    assert bind([shown], heard_at(readings, -10.0, rng), drives=True).bound_track("tag", [1]) == 1
    walking = walker(2, 2.5, seconds=30.0)
    assert bind([walking], worn_by(walking, rng), drives=True).bound_track("tag", [2]) == 2


def test_bearings_alone_bind_nobody() -> None:
    rng = np.random.default_rng(1)
    shown = at_bearing(walker(1, 2.5), 5.0)
    readings = heard_at([reading(at, None) for at in range(0, 14_000, 200)], 5.0, rng)
    assert bind([shown], readings).bound_track("tag", [1]) is None


@pytest.mark.parametrize(
    ("bearing_deg", "sigma_deg"),
    [(float("nan"), 8.0), (400.0, 8.0), (5.0, 0.0), (5.0, -1.0), (5.0, 90.0), (5.0, None), (None, 8.0)],
)
def test_a_bearing_that_is_none_counts_as_a_reading_without(bearing_deg: float | None, sigma_deg: float | None) -> None:
    rng = np.random.default_rng(2)
    shown = at_bearing(walker(1, 2.5), 5.0)
    plain = worn_by(shown, rng)
    wrong = [replace(one, bearing_deg=bearing_deg, bearing_sigma_deg=sigma_deg) for one in plain]
    assert bind([shown], wrong).log_odds("tag") == bind([shown], plain).log_odds("tag")


@pytest.mark.parametrize("seed", [1, 4, 5])
def test_a_robot_that_drives_lets_go_of_whom_the_distances_no_longer_speak_for(seed: int) -> None:
    """One odd reading bound the tag of somebody beside the picture, and the next ones took that back in vain."""
    rng, shown = np.random.default_rng(seed), walker(1, 2.5, seconds=120)  # old readings are let go six times
    heard = worn_by(shown, rng)
    matcher = bind([shown], heard[:16], drives=True)
    vague_count = shown_count = 0
    assert matcher.bound_track("tag", [1]) == 1
    for sighting in heard[16:]:
        matcher.add_sighting("tag", replace(sighting, distance_m=2.5 + float(rng.normal(0, 1.2)), sigma_m=0.8))
        matcher.advance(sighting.middle_ms)
        evidence = matcher.explain("tag", [1])
        assert evidence is not None
        if evidence.is_vague:
            shown_count += matcher.bound_track("tag", [1]) is not None
            vague_count += 1
    assert vague_count > 50
    assert shown_count <= 2, "until the next reading: what was decided stands while evidence is weighed anew"


def test_what_was_bound_before_the_robot_drove_on_stays_bound_until_it_is_contradicted() -> None:
    shown = walker(1, 2.5, seconds=30)
    heard = worn_by(shown, np.random.default_rng(1))
    matcher = bind([shown], heard[:24], drives=True)
    matcher.forget_evidence()
    for sighting in heard[24:34]:
        matcher.add_sighting("tag", sighting)
        matcher.advance(sighting.middle_ms)
        assert matcher.bound_track("tag", [1]) == 1
    for sighting in heard[34:50]:
        matcher.add_sighting("tag", replace(sighting, distance_m=9.0))
        matcher.advance(sighting.middle_ms)
    assert matcher.bound_track("tag", [1]) is None


def test_a_robot_that_drives_leaves_it_open_who_is_there_while_two_tags_fit_one_person_alike() -> None:
    """The other's bearer may be behind that person, or beside the picture as far away."""
    rng, shown, other = np.random.default_rng(2), walker(1, 2.5, swing_m=0.1, seconds=40), walker(2, 4.5, seconds=40)
    matcher = bind([shown], worn_by(shown, rng), drives=True)
    assert matcher.bound_track("tag", [1]) == 1
    for sighting in worn_by(shown, rng)[:6]:
        matcher.add_sighting("other", sighting)
    matcher.finish()
    assert matcher.bound_track("tag", [1]) is None
    evidence = matcher.explain("tag", [1])
    assert evidence is not None
    assert evidence.obstacle is Obstacle.OTHER_TAG
    matcher.add_track(other)
    for sighting in worn_by(other, rng)[6:]:
        matcher.add_sighting("other", sighting)
    matcher.finish()
    assert matcher.bound_track("tag", [1, 2]) == 1, "whoever is seen elsewhere is not there"
    assert matcher.bound_track("other", [1, 2]) == 2


def test_of_two_tags_the_one_that_fits_by_far_better_is_bound() -> None:
    rng, shown = np.random.default_rng(0), walker(1, 2.5, swing_m=0.3, seconds=40)
    matcher = bind([shown], worn_by(shown, rng), drives=True)
    for sighting in worn_by(shown, rng)[:10]:
        matcher.add_sighting("other", sighting)
    matcher.finish()
    evidence = matcher.explain("other", [1])
    assert evidence is not None
    assert evidence.log_odds >= BIND_LOG_ODDS
    assert matcher.bound_track("tag", [1]) == 1


def test_whom_two_tags_fitted_alike_is_nobodys_where_the_robot_stops_next_until_the_other_is_told_apart() -> None:
    rng, shown, other = np.random.default_rng(2), walker(1, 2.5, swing_m=0.1, seconds=80), walker(2, 4.5, seconds=80)
    worn, others = worn_by(shown, rng), worn_by(other, rng)
    matcher = bind([shown], worn[:60], drives=True)
    for sighting in worn[:6]:
        matcher.add_sighting("other", sighting)
    matcher.advance(30_000)
    assert matcher.bound_track("tag", [1]) is None
    matcher.forget_evidence()
    for sighting in worn[60:84]:
        matcher.add_sighting("tag", sighting)
    matcher.advance(42_000)
    evidence = matcher.explain("tag", [1])
    assert evidence is not None
    assert not evidence.is_vague
    assert matcher.bound_track("tag", [1]) is None
    for sighting in others[60:130]:
        matcher.add_sighting("other", sighting)
    matcher.advance(66_000)
    assert matcher.bound_track("tag", [1]) == 1, "whoever wears the other is not there"


@pytest.mark.parametrize("seed", [13, 14])
def test_readings_that_come_late_bind_a_robots_tags_as_those_in_time(seed: int) -> None:
    rng, shown = np.random.default_rng(seed), walker(1, 2.5, seconds=90)
    heard = [one for one in worn_by(shown, rng) if one.middle_ms < 84_000]
    heard[16:] = [replace(one, distance_m=2.5 + float(rng.normal(0, 1.0))) for one in heard[16:]]
    late_ms = {one.middle_ms: int(rng.integers(0, 4_000)) for one in heard}
    in_time, late = Matcher(drives=True), Matcher(drives=True)
    for matcher in (in_time, late):
        matcher.add_track(shown)
    for at_ms in range(0, 89_000, 100):
        for one in heard:
            if one.middle_ms == at_ms:
                in_time.add_sighting("tag", one)
            if one.middle_ms + late_ms[one.middle_ms] // 100 * 100 == at_ms:
                late.add_sighting("tag", one)
        in_time.advance(at_ms)
        late.advance(at_ms)
    assert late.log_odds("tag") == pytest.approx(in_time.log_odds("tag"))
    assert late.bound_track("tag", [1]) == in_time.bound_track("tag", [1])

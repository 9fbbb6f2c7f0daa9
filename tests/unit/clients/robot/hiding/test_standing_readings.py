"""Readings of a robot that drives: one stop after the other, in time, late or in a heap, and never too many."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clients.robot.hiding.own_motion import OwnMotion, RobotPlace
from clients.robot.hiding.standing_readings import UNKNOWN_MAX_MS, WAITING_MAX_COUNT, StandingReadings
from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Track
from clients.robot.sensing.sensor_events import Facing, Sighting

FRAME_MS, READING_MS, ENDS_MS = 100, 500, 30_000
# The robot stands at A, for a moment at B, 30 cm on, and at A again.
STOPS = ((0, 0.0), (9_900, 0.0), (10_100, 0.3), (11_400, 0.3), (11_600, 0.0), (ENDS_MS, 0.0))

Heard = tuple[int, str, Sighting, bool]  # when it comes


def robot_z(at_ms: float) -> float:
    return float(np.interp(at_ms, *np.array(STOPS).T))


def bearer_z(at_ms: float) -> float:
    """They walk to and fro."""
    return 2.5 + math.sin(at_ms / 1_500)


def walker() -> Track:
    times = list(range(0, ENDS_MS + 1, FRAME_MS))
    ranges = [bearer_z(at_ms) - robot_z(at_ms) for at_ms in times]
    return Track(1, 0, times[-1], 0.0, ranges[0], times=times, ranges=ranges, bearings=[0.0] * len(times))


def readings_of_bearer() -> list[Sighting]:
    rng = np.random.default_rng(1)
    times = range(0, ENDS_MS - 3_000, READING_MS)
    away = {at_ms: bearer_z(at_ms) - robot_z(at_ms) + float(rng.normal(0, 0.15)) for at_ms in times}
    return [Sighting(at_ms, at_ms, "", 1, Facing.FRONT, -50.0, away[at_ms], 0.2) for at_ms in times]


def play(heard: Iterable[Heard]) -> tuple[Matcher, dict[int, int | None]]:
    """Return the matcher, and to whom the owner's tag was bound at each frame."""
    motion, matcher = OwnMotion(), Matcher(drives=True)
    for at_ms in range(0, ENDS_MS + 1, 50):
        motion.add(RobotPlace(at_ms, 0.0, robot_z(at_ms)))
    matcher.add_track(walker())
    readings, queue, bound = StandingReadings(motion), sorted(heard, key=lambda one: one[0]), {}
    for at_ms in range(0, ENDS_MS, FRAME_MS):
        while queue and queue[0][0] <= at_ms:
            _, alias, sighting, known = queue.pop(0)
            readings.push(alias, sighting, known=known)
        motion.confirm(at_ms)
        readings.weigh(matcher, at_ms)
        matcher.advance(at_ms)
        bound[at_ms] = matcher.bound_track("owner", [1])
    return matcher, bound


def of_owner(sightings: Iterable[Sighting], *, late_ms: int = 0, heap_ms: int | None = None) -> list[Heard]:
    return [(heap_ms or one.middle_ms + late_ms, "owner", one, True) for one in sightings]


def state_of(matcher: Matcher) -> str:
    told = [(alias, matcher.bound_track(alias, [1]), matcher.explain(alias, [1])) for alias in ("owner", "other")]
    return f"{told}, {matcher.held_count} readings"


@pytest.fixture(scope="module")
def in_time() -> str:
    heard = readings_of_bearer()
    both = [*of_owner(heard), *((one.middle_ms, "other", replace(one, distance_m=4.0), False) for one in heard)]
    matcher, bound = play(both)
    assert 1 in bound.values()
    return state_of(matcher)


@settings(max_examples=15, deadline=None)
@given(late=st.lists(st.integers(0, UNKNOWN_MAX_MS), min_size=8, max_size=40))
def test_readings_that_come_two_seconds_late_end_as_if_they_had_come_in_time(in_time: str, late: Sequence[int]) -> None:
    heard: list[Heard] = []
    for number, one in enumerate(readings_of_bearer()):
        owner_ms, other_ms = late[number % len(late)], late[(3 * number + 1) % len(late)]
        heard.append((one.middle_ms + owner_ms, "owner", one, True))
        heard.append((one.middle_ms + other_ms, "other", replace(one, distance_m=4.0), False))
    assert state_of(play(heard)[0]) == in_time


def test_what_contradicts_a_tag_counts_also_if_it_comes_with_the_first_reading_of_the_next_place() -> None:
    heard = readings_of_bearer()
    fits = [one for one in heard if one.middle_ms < 6_000]
    contradicts = [replace(one, distance_m=9.0) for one in heard if 6_000 <= one.middle_ms < 9_000]
    after = [one for one in heard if 10_500 <= one.middle_ms < 11_500]
    for heap_ms in (None, 13_000):
        _, bound = play([*of_owner(fits), *of_owner([*contradicts, *after], heap_ms=heap_ms)])
        assert bound[6_000] == 1
        assert bound[14_000] is None


def test_what_comes_when_its_place_was_left_and_another_weighed_is_dropped() -> None:
    heard = of_owner(readings_of_bearer())
    left = [(20_000, *one[1:]) for one in heard if one[0] == 8_000]
    in_time = [one for one in heard if one[0] != 8_000]
    assert state_of(play([*in_time, *left])[0]) == state_of(play(in_time)[0])


def test_a_stranger_whose_readings_are_late_by_many_seconds_ends_nobodys_evidence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun = []
    forget = Matcher.forget_evidence

    def count(matcher: Matcher) -> None:
        begun.append(1)
        forget(matcher)

    monkeypatch.setattr(Matcher, "forget_evidence", count)
    heard = readings_of_bearer()
    play([*of_owner(heard), *((one.middle_ms + 5_000, "other", one, False) for one in heard)])
    assert len(begun) == 2, "once for each time that the robot went on"


def crowded(known: bool) -> StandingReadings:
    readings = StandingReadings(OwnMotion())
    for number in range(WAITING_MAX_COUNT):
        readings.push("crowd", Sighting(number, number, "", 1), known=known)
    return readings


@pytest.mark.parametrize("known", [True, False])
def test_if_too_many_wait_strangers_readings_are_dropped_first_and_all_that_are_dropped_are_counted(
    *, known: bool
) -> None:
    readings = crowded(known)
    for at_ms in range(100):
        readings.push("owner", Sighting(at_ms, at_ms, "", 1))
        readings.push("stranger", Sighting(at_ms, at_ms, "", 1), known=False)
    assert readings.waiting_count == WAITING_MAX_COUNT
    assert readings.unplaced_count == 200
    assert [one.alias for one in readings._of_roster].count("owner") == 100


def test_readings_stamped_in_the_future_do_not_crowd_out_those_of_now() -> None:
    readings = StandingReadings(OwnMotion())
    for at_ms in range(2 * WAITING_MAX_COUNT):
        readings.push("ahead", Sighting(3_600_000 + at_ms, 3_600_000 + at_ms, "", 1))
    readings.push("owner", Sighting(0, 0, "", 1))
    assert readings._of_roster[0].alias == "owner"


def test_of_thousands_that_wait_only_the_first_is_asked_about(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(OwnMotion, "stands", lambda _, at_ms: asked.append(at_ms))
    readings = crowded(True)
    readings.weigh(Matcher(drives=True), 1_000)
    assert asked == [0]
    assert readings.waiting_count == WAITING_MAX_COUNT

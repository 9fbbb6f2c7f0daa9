"""A device's clock measured from a stream of late messages: found, followed, and found again after it was set."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clients.robot.sensing.sensor_clocks import (
    BIN_MS,
    CONFIRM_COUNT,
    DELAY_MAX_MS,
    HORIZON_MS,
    READERS_MAX_COUNT,
    READING_MAX_MS,
    ClockEstimate,
    ClockEstimator,
    RunClocks,
    TimestampStatus,
)
from clients.robot.sensing.sensor_events import Event, Frame, Sighting

START_MS = 1_579_278_405_650
DAY_MS = 86_400_000
DEPTH = np.zeros((1, 1), dtype=np.uint16)

Delay = Callable[[random.Random], float]
DELAYS: dict[str, Delay] = {
    "none": lambda chance: 0.0,
    "exponential": lambda chance: min(chance.expovariate(1 / 40), DELAY_MAX_MS),
    "even": lambda chance: chance.uniform(0, 900),
    "mostly-slow": lambda chance: 0.0 if chance.random() < 0.05 else chance.uniform(100, 500),
}


class Device:
    """A clock that is `offset_ms` and a growing drift behind the host's, and whose messages are late."""

    def __init__(self, delay: Delay, *, offset_ms: float = -7_200_123.0, drift_ppm: float = 0.0) -> None:
        self.delay = delay
        self.offset_ms = offset_ms
        self.drift_ppm = drift_ppm
        self.now_ms = 0.0
        self.estimator = ClockEstimator()
        self._chance = random.Random(20200117)

    def true_offset_ms(self) -> float:
        return self.offset_ms + self.drift_ppm * 1e-6 * self.now_ms

    def send(self, seconds: float, rate: float = 2.0) -> list[TimestampStatus]:
        standings = []
        for _ in range(int(seconds * rate)):
            self.now_ms += 1000 / rate
            stamp = START_MS + self.now_ms - self.true_offset_ms()
            received = START_MS + self.now_ms + self.delay(self._chance)
            standings.append(self.estimator.observe(int(stamp), int(received)))
        return standings

    def estimate(self) -> ClockEstimate:
        found = self.estimator.estimate(START_MS + int(self.now_ms))
        assert found is not None
        return found

    def error_ms(self) -> float:
        return self.estimate().offset_ms - self.true_offset_ms()


@pytest.mark.parametrize("delay", DELAYS.values(), ids=DELAYS.keys())
@pytest.mark.parametrize("drift_ppm", [0.0, 80.0, -200.0])
def test_offset_and_drift_are_found_within_the_stated_uncertainty(delay: Delay, drift_ppm: float) -> None:
    device = Device(delay, drift_ppm=drift_ppm)
    for _ in range(20):
        assert set(device.send(60)) == {TimestampStatus.FITS}
        assert abs(device.error_ms()) <= device.estimate().uncertainty_ms
    assert abs(device.error_ms()) < 20
    assert device.estimate().drift_ppm == pytest.approx(drift_ppm, abs=60)
    assert device.estimate().started_anew_count == 0


def test_the_first_report_is_placed_at_its_receipt_and_says_how_little_is_known() -> None:
    device = Device(lambda _: 700.0)
    device.send(0.5)
    assert device.error_ms() == pytest.approx(700, abs=1)
    assert device.estimate().uncertainty_ms > 700


def test_uncertainty_shrinks_as_reports_come_and_nothing_is_known_before() -> None:
    device = Device(DELAYS["exponential"])
    assert device.estimator.estimate(START_MS) is None
    assert device.estimator.offset_at(START_MS) is None
    found = []
    for _ in range(4):
        device.send(60)
        found.append(device.estimate().uncertainty_ms)
    assert found == sorted(found, reverse=True)
    assert found[-1] < 30


@pytest.mark.parametrize("jump_ms", [DAY_MS, -DAY_MS, 5_000, -5_000])
def test_a_clock_that_was_set_is_found_after_as_many_reports_as_stated(jump_ms: int) -> None:
    device = Device(DELAYS["exponential"])
    device.send(120)
    device.offset_ms += jump_ms
    expected = [TimestampStatus.DOUBTFUL] * (CONFIRM_COUNT - 1) + [TimestampStatus.CLOCK_SET]
    assert device.send(CONFIRM_COUNT / 2) == expected
    device.send(120)
    assert abs(device.error_ms()) <= device.estimate().uncertainty_ms
    assert device.estimate().started_anew_count == 1


def test_a_small_step_forward_is_found_after_as_many_reports_and_one_back_within_four_bins() -> None:
    ahead = Device(DELAYS["exponential"])
    ahead.send(120)
    ahead.offset_ms -= 800
    assert ahead.send(CONFIRM_COUNT / 2)[-1] is TimestampStatus.CLOCK_SET
    assert abs(ahead.error_ms()) < 100
    assert ahead.estimate().started_anew_count == 1
    behind = Device(DELAYS["exponential"])
    behind.send(120)
    behind.offset_ms += 800
    behind.send(4 * BIN_MS / 1000)
    assert abs(behind.error_ms()) < 100
    assert behind.estimate().started_anew_count == 1


@pytest.mark.parametrize("off_ms", [DAY_MS, -DAY_MS, 3_000, -3_000])
def test_one_wrong_stamp_changes_nothing(off_ms: int) -> None:
    device = Device(DELAYS["exponential"])
    device.send(120)
    before = device.estimate()
    now = START_MS + int(device.now_ms)
    assert device.estimator.observe(now - int(device.offset_ms) - off_ms, now) is TimestampStatus.DOUBTFUL
    assert device.estimate() == before
    assert set(device.send(60)) == {TimestampStatus.FITS}


@pytest.mark.parametrize("rate", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("ahead_ms", [300, 700, 1_500, 1_990])
def test_one_stamp_a_little_ahead_moves_no_clock(ahead_ms: int, rate: float) -> None:
    device = Device(DELAYS["exponential"])
    device.send(120, rate)
    before = device.estimate()
    now = START_MS + int(device.now_ms)
    assert device.estimator.observe(now - int(device.offset_ms) + ahead_ms, now) is TimestampStatus.DOUBTFUL
    assert device.estimate() == before
    assert set(device.send(20, rate)) == {TimestampStatus.FITS}
    assert abs(device.error_ms()) < 50


@pytest.mark.parametrize("rate", [1.0, 2.0, 5.0])
def test_a_stamp_ahead_in_the_first_seconds_is_forgotten_within_twenty(rate: float) -> None:
    device = Device(DELAYS["exponential"])
    device.send(2, rate)
    now = START_MS + int(device.now_ms)
    device.estimator.observe(now - int(device.offset_ms) + 1_500, now)
    device.send(25, rate)
    assert abs(device.error_ms()) < 100


def test_wrong_stamps_that_do_not_agree_with_one_another_are_never_believed() -> None:
    device = Device(DELAYS["none"])
    device.send(60)
    now = START_MS + int(device.now_ms)
    for number in range(50):
        assert device.estimator.observe(now - (number + 2) * DAY_MS, now) is TimestampStatus.DOUBTFUL
    assert device.estimate().started_anew_count == 0


@pytest.mark.parametrize("gap_ms", [HORIZON_MS + BIN_MS, -2 * HORIZON_MS])
def test_after_a_silence_beyond_the_horizon_or_a_host_clock_set_back_it_starts_anew(gap_ms: int) -> None:
    device = Device(DELAYS["none"], drift_ppm=100)
    device.send(300)
    device.now_ms += gap_ms
    device.send(0.5)
    assert device.estimate().sample_count == 1
    assert abs(device.error_ms()) < 2


def test_memory_is_bounded_over_an_hour_and_a_storm() -> None:
    device = Device(DELAYS["exponential"])
    device.send(3_600, rate=1)
    device.send(2, rate=10_000)
    assert len(device.estimator._bins) <= HORIZON_MS // BIN_MS
    assert abs(device.error_ms()) <= device.estimate().uncertainty_ms


def frame(number: int, at_ms: int, received_ms: int | None) -> Frame:
    return Frame(at_ms, number, DEPTH, received_ms)


def sighting(at_ms: int, received_ms: int | None, *, lasting_ms: int = 0) -> Sighting:
    return Sighting(at_ms, at_ms + lasting_ms, "E2", received_at_ms=received_ms)


def sightings(events: list[Event]) -> list[Sighting]:
    return [event for event in events if isinstance(event, Sighting)]


@pytest.mark.parametrize("camera_ms", [0, 3_600_000])
@pytest.mark.parametrize("reader_ms", [0, -DAY_MS, 12_345])
def test_sightings_come_out_on_the_cameras_timeline_and_frames_as_they_are(camera_ms: int, reader_ms: int) -> None:
    clocks = RunClocks()
    for number in range(20):
        at = START_MS + number * 100
        taken = frame(number, at + camera_ms, at)
        assert clocks.admit(taken) == [taken]
        (moved,) = sightings(clocks.admit(sighting(at + reader_ms, at)))
        assert (moved.first_seen_ms, moved.received_at_ms) == (at + camera_ms, at + camera_ms)
    assert {name: found.offset_ms for name, found in clocks.estimates().items()} == {
        "reader": -reader_ms,
        "camera": -camera_ms,
    }


@pytest.mark.parametrize("off_ms", [-DAY_MS, -5_000, -1_500, 1_500, 5_000, DAY_MS])
def test_each_origin_of_readings_has_a_clock_of_its_own(off_ms: int) -> None:
    clocks = RunClocks()
    for number in range(300):
        at = START_MS + number * 100
        clocks.admit(frame(number, at, at))
        for origin, stamp in (("/rfid", at + off_ms), ("10.0.0.7:5084", at)):
            (moved,) = sightings(clocks.admit(replace(sighting(stamp, at), origin=origin)))
            assert (moved.first_seen_ms, moved.origin) == (at, origin)
    clocks.flush()
    assert clocks.refused == {"frame-time": 0, "sighting-time": 0, "odometry-time": 0}
    assert {name: found.offset_ms for name, found in clocks.estimates().items()} == {
        "reader /rfid": -off_ms,
        "reader 10.0.0.7:5084": 0,
        "camera": 0,
    }


def test_what_one_reader_leaves_in_doubt_another_does_not_clear() -> None:
    clocks = RunClocks()
    out = []
    for number in range(40):
        at = START_MS + number * 500
        clocks.admit(replace(sighting(at, at), origin="/other"))
        out += sightings(clocks.admit(replace(sighting(at - (DAY_MS if number >= 20 else 0), at), origin="/rfid")))
    assert [one.first_seen_ms for one in out] == [START_MS + number * 500 for number in range(40)]
    assert clocks.refused["sighting-time"] == 0


def test_so_many_origins_are_remembered_and_the_one_longest_unheard_is_forgotten_first() -> None:
    clocks = RunClocks()
    for number in range(READERS_MAX_COUNT + 5):
        clocks.admit(replace(sighting(START_MS, START_MS), origin="/always"))
        clocks.admit(replace(sighting(START_MS, START_MS), origin=f"/{number}"))
        wrong = replace(sighting(START_MS + DAY_MS, START_MS), origin=f"/{number}")
        assert clocks.admit(wrong) == [], "it waits, in doubt"
    assert len(clocks.estimates()) == READERS_MAX_COUNT
    assert {"reader /always", f"reader /{READERS_MAX_COUNT + 4}"} <= clocks.estimates().keys()
    assert clocks.refused["sighting-time"] == 6, "what waited with a clock that is forgotten is refused"
    clocks.flush()
    assert clocks.refused["sighting-time"] == READERS_MAX_COUNT + 5


def test_where_no_receipt_is_told_stamps_are_taken_at_their_word_and_no_end_before_a_beginning() -> None:
    clocks = RunClocks()
    read, taken = sighting(START_MS, None), frame(0, START_MS, None)
    assert clocks.admit(read) == [read]
    assert clocks.admit(taken) == [taken]
    assert clocks.estimates() == {}
    clocks = RunClocks()
    assert clocks.admit(sighting(START_MS, START_MS, lasting_ms=-1)) == []
    assert clocks.refused["sighting-time"] == 1


def test_readings_that_waited_for_a_set_clock_to_be_confirmed_are_not_lost() -> None:
    clocks = RunClocks()
    out = []
    for number in range(40):
        at = START_MS + number * 500
        out += sightings(clocks.admit(sighting(at - (DAY_MS if number >= 20 else 0), at)))
    assert [one.first_seen_ms for one in out] == [START_MS + number * 500 for number in range(40)]
    assert clocks.refused == {"frame-time": 0, "sighting-time": 0, "odometry-time": 0}


def test_single_wrong_stamps_are_refused_and_counted() -> None:
    clocks = RunClocks()
    for number in range(30):
        at, off = START_MS + number * 500, DAY_MS if number % 10 == 9 else 0
        assert len(clocks.admit(sighting(at + off, at))) == (0 if off else 1)
        assert len(clocks.admit(frame(number, at - off, at))) == (0 if off else 1)
    clocks.flush()
    assert clocks.refused == {"frame-time": 3, "sighting-time": 3, "odometry-time": 0}


def test_messages_that_pile_up_while_the_host_is_busy_are_late_and_not_wrong() -> None:
    clocks = RunClocks()
    for number in range(900):
        at = START_MS + number * 33
        busy_until = START_MS + 16_000  # from 10 s on; then the host works through what has come, in a second
        received = busy_until + (number - 303) * 5 if 303 < number < 520 else at
        taken = frame(number, at, max(at, received))
        assert clocks.admit(taken) == [taken]
    assert clocks.refused["frame-time"] == 0
    estimate = clocks.estimates()["camera"]
    assert (round(estimate.offset_ms), estimate.started_anew_count) == (0, 0)


def test_a_host_clock_set_by_less_than_a_minute_is_followed_after_the_time_to_catch_up() -> None:
    device = Device(DELAYS["none"])
    device.send(120, rate=30)
    device.offset_ms += 30_000
    device.now_ms += 30_000  # the host's clock jumps, the device's stamps go on
    standings = device.send(20, rate=30)
    assert TimestampStatus.CLOCK_SET in standings
    assert set(standings[: 9 * 30]) == {TimestampStatus.FITS}
    assert abs(device.error_ms()) <= device.estimate().uncertainty_ms


@pytest.mark.parametrize("received", [True, False])
def test_of_a_reading_that_began_long_ago_the_end_counts(received: bool) -> None:
    clocks = RunClocks()
    lasts = {0: 0, READING_MAX_MS: READING_MAX_MS, READING_MAX_MS + 1: READING_MAX_MS, START_MS: READING_MAX_MS}
    for told, kept in lasts.items():
        (one,) = sightings(clocks.admit(sighting(START_MS - told, START_MS if received else None, lasting_ms=told)))
        assert (one.first_seen_ms, one.last_seen_ms) == (START_MS - kept, START_MS)
    assert clocks.shortened_count == 2


def test_what_waits_in_doubt_is_bounded() -> None:
    clocks = RunClocks()
    clocks.admit(frame(0, START_MS, START_MS))
    for number in range(1, 100):
        assert clocks.admit(frame(number, START_MS + number * DAY_MS, START_MS + number)) == []
    assert len(clocks._held_frames) < CONFIRM_COUNT
    clocks.flush()
    assert clocks.refused["frame-time"] == 99

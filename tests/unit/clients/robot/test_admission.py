"""A storm of readings at the robot's front door: what gets through, what is only paired, and what is kept of it."""

from __future__ import annotations

import pytest

from clients.robot.pairing.input_throttle import (
    APART_MS,
    KNOWN_MAX_PER_S,
    READINGS_MAX_COUNT,
    STRANGERS_MAX_PER_S,
    TAGS_MAX_COUNT,
    TELL_EVERY_MS,
    InputThrottle,
    PipelineIntake,
)
from clients.robot.pairing.rosters import UnknownTagCounts, UnknownTags
from clients.robot.pairing.tag_pairing import Pairing
from clients.robot.sensing.sensor_events import Sighting

START_MS = 1_579_278_405_000


def reading(at_ms: int, uid: str = "E2", antenna: int = 1) -> Sighting:
    return Sighting(START_MS + at_ms, START_MS + at_ms, uid, antenna, received_at_ms=START_MS + at_ms)


@pytest.mark.parametrize("order", [1, -1])
def test_readings_apart_are_weighed_in_any_order_and_near_ones_only_paired(order: int) -> None:
    admission = InputThrottle()
    assert all(admission.weighs(reading(at), known=True) for at in range(0, 1_000, APART_MS)[::order])
    assert not any(admission.weighs(reading(at), known=True) for at in range(1, 950))
    assert admission.only_paired_count == 949


def test_another_antenna_or_tag_is_another_matter_and_strangers_crowd_nobody_out() -> None:
    admission = InputThrottle()
    assert admission.weighs(reading(0), known=True)
    assert admission.weighs(reading(0, antenna=2), known=True)
    assert admission.weighs(reading(0, uid="E3"), known=True)
    assert not admission.weighs(reading(0), known=True), "the same reading, reported twice"
    admission = InputThrottle()
    weighed = sum(admission.weighs(reading(0, f"stranger-{n}"), known=False) for n in range(1_000))
    assert weighed == STRANGERS_MAX_PER_S
    assert admission.weighs(reading(0), known=True)
    weighed = sum(admission.weighs(reading(0, f"known-{n}"), known=True) for n in range(1_000))
    assert weighed == KNOWN_MAX_PER_S - 1
    assert admission.weighs(reading(1_000, "stranger-x"), known=False), "a new second"
    weighed = sum(admission.weighs(reading(n % 2 * 1_000, f"stranger-{n}"), known=False) for n in range(2_000, 3_000))
    assert weighed == STRANGERS_MAX_PER_S - 1, "readings out of order begin no new second"


def test_what_is_remembered_of_readings_is_bounded_and_forgotten() -> None:
    admission = InputThrottle()
    for number in range(2 * TAGS_MAX_COUNT):
        admission.weighs(reading(number * 5, f"known-{number}"), known=True)
    assert 2_000 < len(admission._known._readings) <= TAGS_MAX_COUNT
    for number in range(2 * READINGS_MAX_COUNT):
        admission.weighs(reading(120_000 + number * APART_MS), known=True)
    assert [len(times) for times in admission._known._readings.values()] == [READINGS_MAX_COUNT]
    assert not admission.weighs(reading(120_000), known=True), "older than what is remembered"


def test_there_is_something_to_tell_every_ten_seconds_of_the_stream() -> None:
    admission = InputThrottle()
    assert not admission.is_time_to_tell()
    told = 0
    for at in range(0, 3 * TELL_EVERY_MS, 500):
        admission.clocks.admit(reading(at))
        told += admission.is_time_to_tell()
    assert told == 3


def test_what_was_turned_away_is_told_once() -> None:
    admission, pairing = InputThrottle(), Pairing()
    assert admission.newly_turned_away(pairing) == []
    admission.clocks.admit(Sighting(5, 1, "E2"))
    assert admission.newly_turned_away(pairing) == [("sighting-time", 1)]
    assert admission.newly_turned_away(pairing) == []


def test_the_summary_counts_every_refusal_once() -> None:
    admission, pairing = InputThrottle(), Pairing()
    pairing.add_frame(0, START_MS)
    pairing.add_sighting("a", 0, 0)
    admission.clocks.admit(Sighting(5, 1, "E2"))
    assert admission.summarise(pairing, UnknownTags()) == PipelineIntake(
        clocks={},
        turned_away={"sighting-time": 2},
        sightings_late=0,
        sightings_shortened=0,
        sightings_only_paired=0,
        timelines=1,
        unknown_tags=UnknownTagCounts(readings=0, tags=0, more_tags=False),
    )

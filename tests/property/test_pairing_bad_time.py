"""Clocks and pairing fed with any times at all: nothing hangs, nothing grows, nobody is paired twice or for nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clients.robot.pairing.tag_pairing import MEMORY_MS, REFUSED_AND_COUNTED, Decision, Pairing
from clients.robot.sensing.sensor_clocks import (
    CONFIRM_COUNT,
    HORIZON_MS,
    LATE_MAX_MS,
    ClockEstimator,
    RunClocks,
    TimestampStatus,
)
from clients.robot.sensing.sensor_events import Event, Frame, Sighting
from consensus.errors import BlockRobotError

START_MS = 1_579_278_405_000
DAY_MS = 86_400_000
DEPTH = np.zeros((1, 1), dtype=np.uint16)
WINDOW_MS = 5_000

wild = st.one_of(
    st.integers(0, 20_000),
    st.integers(-3 * MEMORY_MS, 3 * MEMORY_MS),
    st.integers(-2 * DAY_MS, 2 * DAY_MS),
    st.integers(-START_MS, 2**53),
    st.sampled_from([0, -START_MS, DAY_MS, -DAY_MS, HORIZON_MS, -HORIZON_MS]),
)
told = st.one_of(st.none(), wild)
events = st.lists(st.tuples(st.booleans(), wild, st.integers(-5, 120_000), told, st.sampled_from("abc")), max_size=80)


def made(number: int, row: tuple[bool, int, int, int | None, str]) -> Event:
    is_frame, at, lasting, received, alias = row
    received_ms = None if received is None else START_MS + received
    if is_frame:
        return Frame(START_MS + at, number, DEPTH, received_ms)
    return Sighting(START_MS + at, START_MS + at + lasting, alias, received_at_ms=received_ms)


@given(events)
def test_whatever_the_stamps_every_frame_is_decided_once_or_turned_away_and_counted(
    rows: list[tuple[bool, int, int, int | None, str]],
) -> None:
    clocks, pairing = RunClocks(), Pairing()
    decided: list[Decision] = []
    raised: list[str] = []
    seen: set[str] = set()
    for number, row in enumerate(rows):
        for event in clocks.admit(made(number, row)):
            try:
                if isinstance(event, Frame):
                    vouched = event.received_at_ms is not None
                    decided += pairing.add_frame(event.sequence, event.captured_at_ms, vouched=vouched)
                elif isinstance(event, Sighting):
                    seen.add(event.uid)
                    first, last = event.first_seen_ms, event.last_seen_ms
                    decided += pairing.add_sighting(event.uid, first, last, received_at_ms=event.received_at_ms)
            except BlockRobotError as error:
                raised.append(error.code)
    clocks.flush()
    decided += pairing.flush()
    numbers = [decision.sequence for decision in decided]
    assert len(numbers) == len(set(numbers))
    frame_count = sum(row[0] for row in rows)
    assert set(raised) <= REFUSED_AND_COUNTED
    assert len(numbers) + len(raised) + clocks.refused["frame-time"] == frame_count
    assert len(raised) == pairing.refused.get("frame-time", 0) + pairing.refused.get("frames-full", 0)
    assert pairing.waiting_count == 0
    assert {owner for decision in decided for owner in decision.owners} <= seen


@given(st.lists(st.tuples(wild, wild), min_size=1, max_size=120))
def test_an_estimator_believes_no_jump_that_was_not_confirmed_and_stays_small(rows: list[tuple[int, int]]) -> None:
    estimator = ClockEstimator()
    doubts = 0
    for at, received in rows:
        before = estimator.offset_at(START_MS + received)
        restarts = estimator.started_anew_count
        standing = estimator.observe(START_MS + at, START_MS + received)
        after = estimator.offset_at(START_MS + received)
        assert after is not None
        if standing is TimestampStatus.DOUBTFUL:
            doubts += 1
            assert after == before
        elif standing is TimestampStatus.CLOCK_SET:
            assert doubts >= CONFIRM_COUNT - 1
            assert estimator.started_anew_count == restarts + 1
        if standing is not TimestampStatus.DOUBTFUL:
            doubts = 0
            assert -1 <= received - at - after <= LATE_MAX_MS + 300, "no message came before it was sent, nor very late"
        assert len(estimator._bins) <= HORIZON_MS // 5_000
        estimate = estimator.estimate(START_MS + received)
        assert estimate is not None
        assert estimate.uncertainty_ms >= 1


@given(st.lists(st.integers(-DAY_MS, DAY_MS), max_size=40))
def test_single_stamps_a_minute_or_more_off_never_cost_another_frame_its_owner(offs: list[int]) -> None:
    """Every second frame is stamped wrongly; no two in a row are, so that none of them is ever believed."""
    pairing = Pairing()
    pairing.add_sighting("a", START_MS, START_MS)
    pairing.add_frame(0, START_MS)
    decided: list[Decision] = []
    for number, off in enumerate(offs, 1):
        at = START_MS + number
        wrong = at + off + (2 * MEMORY_MS if off >= 0 else -2 * MEMORY_MS)
        with pytest.raises(BlockRobotError, match="FRAME_TIME_WRONG"):
            pairing.add_frame(1_000 + number, wrong)
        decided += pairing.add_frame(number, at)
    decided += pairing.flush()
    assert [decision.sequence for decision in decided] == list(range(len(offs) + 1))
    assert {decision.owners for decision in decided} == {("a",)}

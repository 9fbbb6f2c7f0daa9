"""Pairing at its edges: the window's ends, strangers' tags, old frames, and time that passes without frames."""

from __future__ import annotations

import pytest

from clients.robot.pairing.tag_pairing import (
    CONFIRM_COUNT,
    FRAMES_WAITING_MAX_COUNT,
    INTERVALS_MAX_COUNT,
    MEMORY_MS,
    NOT_PAIRED_NO_TAG,
    NOT_PAIRED_UNKNOWN_TAG,
    REFUSED_FRAME_TIME,
    REFUSED_FRAMES_FULL,
    REFUSED_INTERVALS_FULL,
    REFUSED_SIGHTING_TIME,
    REFUSED_TAGS_FULL,
    TAGS_MAX_COUNT,
    Pairing,
)
from consensus.errors import BlockRobotError

START_MS = 1_579_278_405_650
DAY_MS = 86_400_000


def test_the_window_is_closed_at_both_ends_and_at_the_last_instant() -> None:
    pairing = Pairing()
    pairing.add_sighting("a", 10_000, 10_000)
    decided = [d for i, at in enumerate((4_999, 5_000, 15_000, 15_001)) for d in pairing.add_frame(i, at)]
    assert [d.owners for d in decided + pairing.flush()] == [(), ("a",), ("a",), ()]
    pairing = Pairing()
    assert pairing.add_frame(0, 0) == []
    assert pairing.advance(6_000) == []
    pairing.add_sighting("a", 5_000, 5_000)
    (decision,) = pairing.advance(6_001)
    assert decision.owners == ("a",)


def test_a_known_tag_outweighs_an_unknown_one_and_only_unknown_ones_are_said_to_be() -> None:
    pairing = Pairing()
    pairing.add_frame(0, 0)
    pairing.add_sighting("x", 0, 0, known=False)
    pairing.add_sighting("b", 0, 0)
    (decision,) = pairing.flush()
    assert (decision.owners, decision.reason) == (("b",), "")
    pairing = Pairing()
    pairing.add_sighting("x", 0, 0, known=False)
    decided = [*pairing.add_frame(0, 0), *pairing.add_frame(1, 20_000), *pairing.flush()]
    assert [d.reason for d in decided] == [NOT_PAIRED_UNKNOWN_TAG, NOT_PAIRED_NO_TAG]


def test_a_sighting_that_ended_is_remembered_for_the_frames_that_wait() -> None:
    pairing = Pairing()
    pairing.add_sighting("a", 5_000, 5_000)
    pairing.add_frame(0, 10_000)
    assert pairing.advance(15_900) == []
    (decision,) = pairing.advance(16_001)
    assert decision.owners == ("a",)


def test_a_frame_older_than_memory_is_refused_and_counted() -> None:
    pairing = Pairing()
    pairing.add_frame(0, MEMORY_MS + 1_000)
    with pytest.raises(BlockRobotError, match="FRAME_TIME_WRONG"):
        pairing.add_frame(1, 999)
    assert pairing.refused == {REFUSED_FRAME_TIME: 1}
    assert pairing.add_frame(2, 1_000) != [], "one millisecond younger is remembered, and long decided"


@pytest.mark.parametrize("off_ms", [DAY_MS, -DAY_MS, 365 * DAY_MS, MEMORY_MS + 1, -MEMORY_MS - 1])
def test_one_stamp_far_off_is_refused_and_nothing_is_forgotten(off_ms: int) -> None:
    pairing = Pairing()
    pairing.add_sighting("a", START_MS, START_MS)
    pairing.add_frame(0, START_MS)
    with pytest.raises(BlockRobotError, match="FRAME_TIME_WRONG"):
        pairing.add_frame(1, START_MS + off_ms)
    assert pairing.add_frame(2, START_MS + 33) == []
    assert [(d.sequence, d.owners) for d in pairing.flush()] == [(0, ("a",)), (2, ("a",))]


def test_scattered_wrong_stamps_never_move_the_time() -> None:
    pairing = Pairing()
    pairing.add_frame(0, START_MS)
    for number in range(1, 50):
        with pytest.raises(BlockRobotError, match="FRAME_TIME_WRONG"):
            pairing.add_frame(number, START_MS + number * DAY_MS)
    assert (pairing.now_ms, pairing.timeline_count) == (START_MS, 1)
    assert pairing.refused == {REFUSED_FRAME_TIME: 49}


@pytest.mark.parametrize("off_ms", [DAY_MS, -DAY_MS])
def test_a_clock_that_was_set_is_followed_once_stamps_agree(off_ms: int) -> None:
    pairing = Pairing()
    pairing.add_sighting("a", START_MS, START_MS)
    decided = pairing.add_frame(0, START_MS)
    for number in range(1, CONFIRM_COUNT):
        with pytest.raises(BlockRobotError, match="FRAME_TIME_WRONG"):
            pairing.add_frame(number, START_MS + off_ms + number * 33)
    after_ms = START_MS + off_ms + 100
    decided += pairing.add_frame(CONFIRM_COUNT, after_ms)
    pairing.add_sighting("b", after_ms, after_ms)
    decided += pairing.flush()
    assert [(d.sequence, d.owners) for d in decided] == [(0, ("a",)), (CONFIRM_COUNT, ("b",))]
    assert pairing.timeline_count == (2 if off_ms < 0 else 1)


@pytest.mark.parametrize("off_ms", [DAY_MS, -DAY_MS])
def test_a_frame_whose_stamp_was_checked_elsewhere_is_followed_at_once(off_ms: int) -> None:
    pairing = Pairing()
    pairing.add_frame(0, START_MS, vouched=True)
    decided = pairing.add_frame(1, START_MS + off_ms, vouched=True)
    assert [d.sequence for d in decided] == [0]
    assert pairing.now_ms == START_MS + off_ms


@pytest.mark.parametrize("known", [True, False])
def test_who_was_there_before_the_clock_was_set_back_owns_nothing_of_the_same_time_after_it(known: bool) -> None:
    pairing = Pairing()
    pairing.add_frame(0, START_MS)
    pairing.add_sighting("a", START_MS, START_MS, known=known)
    for number, at_ms in enumerate((START_MS - DAY_MS, START_MS), 1):
        pairing.add_frame(number, at_ms, vouched=True)
    assert pairing.timeline_count == 2
    (decision,) = pairing.flush()
    assert (decision.captured_at_ms, decision.owners, decision.reason) == (START_MS, (), NOT_PAIRED_NO_TAG)


@pytest.mark.parametrize("off_ms", [DAY_MS, -DAY_MS])
def test_a_sighting_a_day_off_is_counted_and_covers_nothing(off_ms: int) -> None:
    pairing = Pairing()
    pairing.add_frame(0, START_MS)
    assert pairing.add_sighting("a", START_MS + off_ms, START_MS + off_ms) == []
    assert pairing.refused == {REFUSED_SIGHTING_TIME: 1}
    assert [d.owners for d in pairing.flush()] == [()]


def test_frames_of_one_stamp_are_all_decided_and_no_more_wait_than_there_is_room_for() -> None:
    pairing = Pairing()
    for number in range(FRAMES_WAITING_MAX_COUNT):
        pairing.add_frame(number, START_MS)
    with pytest.raises(BlockRobotError, match="PAIRING_FULL"):
        pairing.add_frame(FRAMES_WAITING_MAX_COUNT, START_MS)
    assert pairing.refused == {REFUSED_FRAMES_FULL: 1}
    assert pairing.waiting_count == FRAMES_WAITING_MAX_COUNT
    assert [d.sequence for d in pairing.advance(START_MS + 6_001)] == list(range(FRAMES_WAITING_MAX_COUNT))
    pairing.add_frame(9_999, START_MS + 6_001)


def test_the_receipt_of_a_sighting_moves_time_on_when_the_camera_has_stopped() -> None:
    pairing = Pairing()
    pairing.add_frame(0, START_MS)
    assert pairing.add_sighting("b", START_MS + 6_000, START_MS + 6_000, received_at_ms=START_MS + 6_000) == []
    (decision,) = pairing.add_sighting("b", START_MS + 6_001, START_MS + 6_001, received_at_ms=START_MS + 6_001)
    assert decision.owners == ()


def test_memory_of_sightings_and_room_for_tags_are_bounded_and_what_is_too_many_counted() -> None:
    pairing = Pairing()
    for second in range(1_000):
        pairing.add_sighting(f"tag-{second}", second * 1_000, second * 1_000)
        pairing.add_frame(second, second * 1_000)
    assert len(pairing._known) < 70
    pairing = Pairing()
    for number in range(TAGS_MAX_COUNT + 5):
        pairing.add_sighting(f"tag-{number}", START_MS, START_MS)
    assert pairing.refused == {REFUSED_TAGS_FULL: 5}
    pairing.add_frame(0, START_MS)
    (decision,) = pairing.flush()
    assert len(decision.owners) == TAGS_MAX_COUNT
    pairing = Pairing(window_ms=1)
    for number in range(INTERVALS_MAX_COUNT + 5):
        pairing.add_sighting("a", START_MS + number * 10, START_MS + number * 10)
    assert pairing.refused == {REFUSED_INTERVALS_FULL: 5}
    pairing.add_sighting("a", START_MS, START_MS + 10)
    assert pairing.refused == {REFUSED_INTERVALS_FULL: 5}, "a reading that joins others needs no room"
    pairing = Pairing()
    for number in range(20_000):
        at = START_MS + number // 10
        pairing.add_sighting(f"stranger-{number}", at, at, known=False, received_at_ms=at)
    assert (len(pairing._known), len(pairing._strangers), pairing.refused) == (0, 1, {})
    pairing.add_frame(0, START_MS)
    assert [d.reason for d in pairing.flush()] == [NOT_PAIRED_UNKNOWN_TAG]

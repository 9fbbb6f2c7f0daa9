"""Where the robot was, by what its wheels say: between samples, across gaps and jumps, and whether it stood."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clients.robot.hiding.own_motion import KEPT_MS, SAMPLES_MAX_COUNT, OwnMotion, RobotPlace


def driven(*places: RobotPlace) -> OwnMotion:
    motion = OwnMotion()
    for place in places:
        motion.add(place)
    motion.confirm(60_000)
    return motion


def straight(until_ms: int = 3_000, *, mps: float = 0.5, every_ms: int = 100) -> list[RobotPlace]:
    return [RobotPlace(at_ms, 0.0, mps * at_ms / 1000) for at_ms in range(0, until_ms + 1, every_ms)]


def test_between_two_samples_the_place_is_between_them() -> None:
    place = driven(*straight()).place_at(1_050)
    assert place is not None
    assert place.z_m == pytest.approx(0.525)


def test_a_moment_past_the_newest_sample_the_robot_is_where_its_speed_takes_it() -> None:
    motion = driven(*straight(1_000))
    place = motion.place_at(1_200)
    assert place is not None
    assert place.z_m == pytest.approx(0.6)
    assert motion.place_at(1_201) is None
    assert driven(RobotPlace(0)).place_at(10) is None


@given(st.permutations(straight(1_000)))
def test_the_order_in_which_samples_come_does_not_matter(samples: list[RobotPlace]) -> None:
    motion = driven(*samples)
    assert motion.place_at(450) == driven(*straight(1_000)).place_at(450)
    assert motion.is_continuous(0, 1_000)


def test_before_the_first_after_the_last_and_in_a_gap_the_place_is_not_known() -> None:
    motion = driven(*straight(1_000), *(RobotPlace(at_ms, 0, 0.5) for at_ms in range(1_500, 2_000, 100)))
    assert motion.place_at(-1) is None
    assert motion.place_at(1_200) is None
    assert motion.place_at(2_101) is None
    assert driven().place_at(0) is None
    assert motion.place_at(1_600) is not None


@pytest.mark.parametrize("jump", [RobotPlace(3_100, 0.8, 1.55), RobotPlace(3_100, 0.0, 1.55, 1.0)])
def test_a_jump_breaks_what_was_continuous(jump: RobotPlace) -> None:
    after = [RobotPlace(3_100 + step, jump.x_m, jump.z_m, jump.yaw) for step in range(0, 1_000, 100)]
    motion = driven(*straight(), *after)
    assert motion.is_continuous(0, 3_000)
    assert not motion.is_continuous(2_500, 3_500)
    assert motion.is_continuous(3_100, 3_900)
    assert motion.place_at(3_050) is None
    assert motion.stands(3_000) is None


def test_a_jump_is_noticed_also_by_a_sample_that_comes_late_and_is_older_than_all() -> None:
    motion = driven(RobotPlace(100, 5.0), RobotPlace(200, 5.0), RobotPlace(0, 0.0))
    assert not motion.is_continuous(0, 150)
    assert motion.is_continuous(100, 200)


def test_a_gap_breaks_what_was_continuous_until_a_late_sample_fills_it() -> None:
    motion = driven(*straight(1_000), *(RobotPlace(at_ms, 0.0, 0.5) for at_ms in range(1_400, 2_000, 100)))
    assert not motion.is_continuous(900, 1_400)
    assert motion.is_continuous(500, 1_000)
    assert motion.is_continuous(1_400, 1_900)
    motion.add(RobotPlace(1_200, 0.0, 0.5))
    assert motion.is_continuous(900, 1_400)


def test_what_was_before_all_that_is_still_known_is_not_continuous_with_it() -> None:
    motion = driven(*straight(), *(RobotPlace(at_ms) for at_ms in range(4 * KEPT_MS, 4 * KEPT_MS + 1_000, 100)))
    motion.keep_around(4 * KEPT_MS + 500)
    assert not motion.is_continuous(3_000, 4 * KEPT_MS + 500)
    assert motion.is_continuous(4 * KEPT_MS, 4 * KEPT_MS + 500)


def test_numbers_that_are_none_are_not_taken() -> None:
    motion = driven(RobotPlace(0, math.nan), RobotPlace(0, 0.0, math.inf), *straight())
    place = motion.place_at(0)
    assert place is not None
    assert place.x_m == 0.0


def test_it_stands_only_if_it_did_before_and_after() -> None:
    stop = [RobotPlace(at_ms, 0.0, 1.5) for at_ms in range(3_100, 5_000, 100)]
    motion = driven(*straight(), *stop)
    assert motion.stands(2_000) is False
    assert motion.stands(3_100) is False
    assert motion.stands(4_000) is True
    assert motion.stands(4_900) is None
    turning = driven(*(RobotPlace(at_ms, yaw=at_ms / 5_000) for at_ms in range(0, 2_000, 100)))
    assert turning.stands(1_000) is False


def test_a_place_before_the_robot_is_known_in_the_odometrys_frame() -> None:
    right_of_a_robot_that_looks_right = RobotPlace(0, 1.0, 2.0, math.pi / 2).to_odometry(0.5, 3.0)
    assert right_of_a_robot_that_looks_right == pytest.approx((4.0, 1.5))


def test_a_storm_of_samples_is_held_in_bounded_memory() -> None:
    motion = OwnMotion()
    for at_ms in range(3 * SAMPLES_MAX_COUNT):
        motion.add(RobotPlace(at_ms))
    assert motion.place_at(0) is None
    assert len(motion._places) <= SAMPLES_MAX_COUNT


@pytest.mark.parametrize("first", [True, False])
def test_a_sample_that_is_stamped_far_in_the_future_ends_nothing(*, first: bool) -> None:
    motion, ahead = OwnMotion(), RobotPlace(3_600_000)
    if first:
        motion.add(ahead)
    for at_ms in range(0, 3 * KEPT_MS, 100):
        motion.add(RobotPlace(at_ms))
        if at_ms == 5_000:
            motion.add(ahead)
        motion.confirm(at_ms)
        motion.keep_around(at_ms)
        assert motion.newest_ms == at_ms
        if at_ms >= 1_000:
            assert motion.place_at(at_ms + 30) is not None
            assert motion.stands(at_ms - 400) is True
    assert len(motion._places) <= KEPT_MS // 100 + 1


def test_nobody_is_said_to_stand_before_the_camera_has_agreed_or_while_it_disagrees() -> None:
    motion = driven(*(RobotPlace(at_ms) for at_ms in range(0, 10_000, 100)))
    motion.confirm(3_000)
    assert motion.stands(2_700) is True
    assert motion.stands(2_800) is None
    motion.doubt(4_000, 5_000)
    motion.confirm(9_000)
    assert [motion.stands(at_ms) for at_ms in (3_600, 3_700, 5_300, 5_400)] == [True, False, None, True]
    assert motion.is_continuous(0, 5_000)
    assert not motion.is_continuous(5_000, 5_100)


def test_doubts_are_held_in_bounded_memory() -> None:
    motion = driven(*straight())
    for number in range(5_000):
        motion.doubt(100 * number, 100 * number)
        motion.add(RobotPlace(100 * number))
        motion.keep_around(100 * number)
    assert len(motion._doubts) <= 1_000
    assert len(motion._broken_ms) <= 2 * KEPT_MS // 100 + 1


def test_a_clock_that_is_set_back_leaves_nothing_of_before() -> None:
    motion = driven(*straight())
    motion.doubt(500, 1_000)
    motion.restart()
    assert motion.newest_ms is None
    assert motion.place_at(1_000) is None
    assert not motion.is_doubted(0, 3_000)
    for place in straight(mps=0.0):
        motion.add(place)
    assert motion.stands(1_000) is None, "the camera has not agreed yet"
    motion.confirm(2_000)
    assert motion.stands(1_000) is True


def test_a_robot_that_turns_back_does_not_stand_where_it_does() -> None:
    """A moment before and after it is at the same place."""
    there_and_back = [RobotPlace(at_ms, 0.0, -0.0005 * abs(at_ms - 1_500)) for at_ms in range(0, 3_001, 100)]
    assert driven(*there_and_back).stands(1_500) is False

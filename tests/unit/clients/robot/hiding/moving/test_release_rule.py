"""When a body may be shown: frames before and after speak too, and doubt is taken over by whoever appears beside it."""

from __future__ import annotations

import pytest

from clients.robot.hiding.moving.release_rule import KEPT_MS, Doubt, ReleaseRule, Sighted

BUFFER_MS = 10_000


def body(x_m: float = 0.0, z_m: float = 3.0, person: float = 4.0, alone: float = 4.0) -> Sighted:
    return Sighted(x_m, z_m, z_m, person, alone)


def follow(rule: ReleaseRule, *bodies: Sighted, first_ms: int = 0, every_ms: int = 100) -> list[int]:
    return [rule.step([one], first_ms + place * every_ms)[0] for place, one in enumerate(bodies)]


def allows(rule: ReleaseRule, number: int, at_ms: int, buffer_ms: int) -> bool:
    return rule.why_not(number, at_ms, buffer_ms) is None


def test_a_person_who_is_seen_alone_for_a_while_may_be_shown_at_any_of_these_times() -> None:
    rule = ReleaseRule()
    numbers = follow(rule, *(body(x_m=0.02 * step) for step in range(20)))
    assert set(numbers) == {1}
    assert all(allows(rule, 1, at_ms, BUFFER_MS) for at_ms in range(0, 2_000, 100))


def test_three_frames_or_half_a_second_are_too_little() -> None:
    rule = ReleaseRule()
    follow(rule, *[body()] * 3, every_ms=300)
    assert rule.why_not(1, 300, BUFFER_MS) is Doubt.BRIEF
    rule = ReleaseRule()
    follow(rule, *[body()] * 15, every_ms=33)
    assert rule.why_not(1, 330, BUFFER_MS) is Doubt.BRIEF


def test_one_frame_in_which_two_are_seen_withholds_all_within_the_buffer_before_and_after() -> None:
    for doubt in (body(person=-3.0), body(alone=-3.0)):
        rule = ReleaseRule()
        follow(rule, *[body()] * 50, doubt, *[body()] * 150)
        assert {rule.why_not(1, at_ms, BUFFER_MS) for at_ms in range(0, 15_000, 500)} == {Doubt.IN_BUFFER}
        assert allows(rule, 1, 15_100, BUFFER_MS)


def test_furniture_in_a_body_speaks_for_no_second_person_and_frames_speak_for_two_together() -> None:
    rule = ReleaseRule()
    follow(rule, *[body(person=-5.0)] * 50)
    assert not rule.speaks_for_two(1, 2_500, BUFFER_MS)
    follow(rule, *[body(alone=-3.0)] * 10, first_ms=5_000)
    assert rule.speaks_for_two(1, 5_500, BUFFER_MS)
    assert not rule.speaks_for_two(1, 2_500, BUFFER_MS), "long before, a doubt about others weighs nothing"
    assert rule.speaks_for_two(1, 60_000, BUFFER_MS), "of that time nothing is known"
    assert rule.speaks_for_two(2, 2_500, BUFFER_MS), "of whom nothing is known"


def test_a_frame_of_little_doubt_withholds_its_neighbours_of_a_second() -> None:
    rule = ReleaseRule()
    follow(rule, *[body()] * 30, body(person=-0.5), *[body()] * 30)
    allowed = [at_ms for at_ms in range(0, 6_100, 100) if allows(rule, 1, at_ms, BUFFER_MS)]
    assert allowed == [*range(0, 2_000, 100), *range(4_100, 6_100, 100)]
    assert rule.why_not(1, 2_500, BUFFER_MS) is Doubt.NEARBY


def test_weak_evidence_that_never_adds_up_is_not_enough() -> None:
    rule = ReleaseRule()
    follow(rule, *[body(person=0.9)] * 30)
    assert rule.why_not(1, 1_000, BUFFER_MS) is Doubt.POOLED


def test_who_appears_beside_a_body_of_two_takes_over_its_doubt() -> None:
    rule = ReleaseRule()
    follow(rule, *[body(alone=-4.0)] * 5)
    for step in range(5, 30):
        numbers = rule.step([body(x_m=-0.3), body(x_m=0.35)], step * 100)
    assert len(set(numbers)) == 2
    assert not any(allows(rule, number, 2_000, BUFFER_MS) for number in numbers)
    apart = rule.step([body(x_m=3.0)], 3_000)
    assert apart[0] not in numbers


def test_a_frame_in_which_it_was_not_seen_or_that_is_forgotten_is_not_shown() -> None:
    rule = ReleaseRule()
    follow(rule, *[body()] * 20)
    assert rule.why_not(1, 50, BUFFER_MS) is Doubt.BRIEF
    assert rule.why_not(2, 100, BUFFER_MS) is Doubt.BRIEF
    follow(rule, body(x_m=3.0), first_ms=KEPT_MS + 2_000)
    assert not allows(rule, 1, 100, BUFFER_MS)


@pytest.mark.parametrize("apart_m", [0.6, 0.9])
def test_who_is_seen_close_by_before_or_after_may_be_hidden_behind_in_between(apart_m: float) -> None:
    rule = ReleaseRule()
    for step in range(60):
        other = [] if 20 <= step < 40 else [body(x_m=apart_m)]
        first = rule.step([body(), *other], step * 100)[0]
    allowed = [step for step in range(60) if allows(rule, first, step * 100, BUFFER_MS)]
    assert allowed == [step for step in range(60) if not 20 <= step < 40]
    assert rule.why_not(first, 3_000, BUFFER_MS) is Doubt.HIDDEN


@pytest.mark.parametrize("apart_m", [0.6, 0.9])
def test_who_comes_into_sight_close_by_may_have_been_hidden_behind(apart_m: float) -> None:
    """Also so close that they take over the other's doubts: that does not say that they were seen."""
    rule = ReleaseRule()
    for step in range(60):
        other = [body(x_m=apart_m)] if step >= 40 else []
        first = rule.step([body(), *other], step * 100)[0]
    assert {rule.why_not(first, step * 100, BUFFER_MS) for step in range(20, 34)} == {Doubt.HIDDEN}
    assert all(allows(rule, first, step * 100, BUFFER_MS) for step in (*range(20), *range(40, 60)))


def test_furniture_that_is_passed_close_by_hides_nobody() -> None:
    rule = ReleaseRule()
    for step in range(60):
        other = [] if 20 <= step < 40 else [body(x_m=0.8, z_m=3.4, person=-6.0)]
        first = rule.step([body(), *other], step * 100)[0]
    assert all(allows(rule, first, step * 100, BUFFER_MS) for step in range(60))


def test_furniture_that_comes_into_sight_close_by_hid_nobody() -> None:
    rule = ReleaseRule()
    for step in range(60):
        other = [body(x_m=0.6, person=-6.0)] if step >= 40 else []
        first = rule.step([body(), *other], step * 100)[0]
    assert all(allows(rule, first, step * 100, BUFFER_MS) for step in range(60))


def test_who_walks_towards_a_body_and_is_then_not_seen_may_be_behind_it() -> None:
    for towards, expected in ((True, False), (False, True)):
        rule = ReleaseRule()
        for step in range(60):
            x_m = 3.0 - 0.1 * step if towards else 1.5 + 0.1 * step
            other = [body(x_m=x_m, z_m=3.4)] if step < 16 else []
            first = rule.step([body(), *other], step * 100)[0]
        assert allows(rule, first, 2_700, BUFFER_MS) is expected

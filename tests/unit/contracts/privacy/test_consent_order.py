"""Words that arrive late or in another order than they were said, and since when a consent has held."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person
from tests.unit.contracts.privacy.test_consent import STEP_MS, allowed, code, newcomer, say, steps

CARE: list[Any] = [["care"], ["depth"]]


@pytest.fixture
def ben(hospital: Hospital) -> Person:
    """Registered, and consents to nothing."""
    return newcomer(hospital)


def giving(hospital: Hospital, person: Person, *more: int, what: list[Any] = CARE) -> Any:
    """A giving, signed now; somebody may hold it back."""
    return hospital.sign(
        person.identity, "consent", "give", person.handle, *what, *(more or (0, 0, 0)), hospital.height
    )


def arrive(hospital: Hospital, transaction: Any) -> str:
    (receipt,) = hospital.block([transaction])
    hospital.block([])
    return str(receipt.code)


@pytest.mark.parametrize("no", [("withdraw", [], []), ("withdraw", ["care"], []), ("refuse", ["care"], [])])
def test_a_giving_that_was_held_back_does_not_undo_a_later_no(hospital: Hospital, ben: Person, no: Any) -> None:
    say(hospital, ben, "give", *CARE, 0, 0, 0)
    held_back = giving(hospital, ben)
    say(hospital, ben, *no)
    assert arrive(hospital, held_back) == "WORD_OLDER"
    assert not allowed(hospital, ben)


def test_a_first_giving_that_was_held_back_comes_too_late_after_a_no(hospital: Hospital, ben: Person) -> None:
    """She gave, it was not final in time, she took it back: nothing stood there yet, and nothing comes."""
    held_back = giving(hospital, ben)
    say(hospital, ben, "withdraw", [], [])
    assert arrive(hospital, held_back) == "WORD_OLDER"
    assert not allowed(hospital, ben)


def test_a_leader_who_turns_words_around_gains_nothing(hospital: Hospital, ben: Person) -> None:
    say(hospital, ben, "give", *CARE, 0, 0, 0)
    again, back = giving(hospital, ben), hospital.sign(ben.identity, "consent", "withdraw", ben.handle, [], [])
    assert [receipt.code for receipt in hospital.block([back, again])] == ["OK", "WORD_OLDER"]
    hospital.block([])
    assert not allowed(hospital, ben)


def test_a_giving_of_long_ago_stays_too_late_whatever_was_said_since(hospital: Hospital, ben: Person) -> None:
    """It would widen what she gave later for a shorter time."""
    held_back = giving(hospital, ben, what=[["care", "research"], ["depth"]])
    say(hospital, ben, "withdraw", [], [])
    until = hospital.time_ms - hospital.time_ms % STEP_MS + 2 * STEP_MS
    for _ in range(3):
        say(hospital, ben, "give", *CARE, 0, until, 0)
        hospital.block([])
    assert arrive(hospital, held_back) == "WORD_OLDER"
    assert steps(hospital, ben)[-1][4] == until
    assert not allowed(hospital, ben, "research")


def test_who_has_seen_her_own_no_final_gives_again_at_once(hospital: Hospital, ben: Person) -> None:
    for _ in range(3):
        say(hospital, ben, "give", *CARE, 0, 0, 0)
        say(hospital, ben, "withdraw", [], [])
    hospital.block([giving(hospital, ben)])
    hospital.block([])
    assert allowed(hospital, ben)


def test_the_last_word_of_a_block_counts_and_a_no_that_was_held_back(hospital: Hospital, ben: Person) -> None:
    give, back = giving(hospital, ben), hospital.sign(ben.identity, "consent", "withdraw", ben.handle, [], [])
    assert [receipt.code for receipt in hospital.block([give, back])] == ["OK", "OK"]
    hospital.block([])
    assert not allowed(hospital, ben)
    back = hospital.sign(ben.identity, "consent", "refuse", ben.handle, ["care"], [])
    say(hospital, ben, "give", *CARE, 0, 0, 0)
    assert arrive(hospital, back) == "OK"
    assert not allowed(hospital, ben)


def test_another_persons_words_make_nobodys_giving_older(hospital: Hospital, ben: Person) -> None:
    carl, give = newcomer(hospital, "carl"), giving(hospital, ben)
    say(hospital, carl, "refuse", ["care"], [])
    assert arrive(hospital, give) == "OK"


@pytest.mark.parametrize("seen", [-1, 10**6, 2**53])
def test_a_giving_cannot_name_a_block_that_nobody_knows_yet(hospital: Hospital, ben: Person, seen: int) -> None:
    """Else it could be held back for as long as its signature holds."""
    receipt = hospital.send(ben.identity, "consent", "give", ben.handle, *CARE, 0, 0, 0, seen)
    assert receipt.code == "HEIGHT_WRONG"
    receipt = hospital.send(ben.identity, "consent", "give", ben.handle, *CARE, 0, 0, 0, hospital.height + 1)
    assert receipt.code == "HEIGHT_WRONG"
    assert code(hospital, ben, "give", *CARE, 0, 0, 0) == "OK"


def test_prolonging_what_has_not_begun_does_not_date_it_back(hospital: Hospital, ben: Person) -> None:
    begin = hospital.time_ms - hospital.time_ms % STEP_MS + DAY_MS
    say(hospital, ben, "give", *CARE, begin, 0, 0)
    first_ms = hospital.time_ms
    say(hospital, ben, "give", *CARE, 0, 0, 0)
    assert steps(hospital, ben)[-1][2] == hospital.time_ms > first_ms


def test_a_consent_has_held_since_its_period_began(hospital: Hospital, ben: Person) -> None:
    begin = hospital.time_ms - hospital.time_ms % STEP_MS + STEP_MS
    say(hospital, ben, "give", *CARE, begin, 0, 0)
    hospital.time_ms = begin + 1_000
    say(hospital, ben, "give", *CARE, 0, 0, 0)
    assert steps(hospital, ben)[-1][2] == begin


def test_a_named_height_leaves_no_gap_while_what_holds_is_open(hospital: Hospital, ben: Person) -> None:
    say(hospital, ben, "give", *CARE, 0, 0, 0)
    first_ms = hospital.time_ms
    hospital.block([])
    say(hospital, ben, "give", *CARE, 0, 0, hospital.height + 20)
    assert [step[2] for step in steps(hospital, ben)] == [first_ms, first_ms]


def test_a_named_height_starts_anew_where_what_holds_may_end_before(hospital: Hospital, ben: Person) -> None:
    until = hospital.time_ms - hospital.time_ms % STEP_MS + 2 * STEP_MS
    say(hospital, ben, "give", *CARE, 0, until, 0)
    hospital.block([])
    say(hospital, ben, "give", *CARE, 0, 0, hospital.height + 20)
    assert steps(hospital, ben)[-1][2] == hospital.time_ms


def test_a_no_in_between_is_a_break_at_a_named_height_too(hospital: Hospital, ben: Person) -> None:
    say(hospital, ben, "give", *CARE, 0, 0, 0)
    hospital.block([])
    later = hospital.height + 20
    say(hospital, ben, "give", *CARE, 0, 0, later)
    say(hospital, ben, "withdraw", [], [])
    say(hospital, ben, "give", *CARE, 0, 0, later)
    assert steps(hospital, ben)[-1][2] == hospital.time_ms
    while hospital.height < later - 1:
        hospital.block([])
        assert not allowed(hospital, ben)
    hospital.block([])
    assert allowed(hospital, ben)

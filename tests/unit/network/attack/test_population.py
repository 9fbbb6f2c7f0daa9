"""The people who are attacked: the same for a seed, half of whom never enrol, with habits."""

from __future__ import annotations

import pytest

from network.lab.privacy.hospital.population import ROUND_WINDOW_MS, UID_PREFIX, Population, draw_population, make_uid


@pytest.fixture(scope="module")
def drawn() -> Population:
    return draw_population(5, people=40, days=3, serial_bits=16)


def test_a_seed_draws_the_same_people_half_of_whom_stay_away(drawn: Population) -> None:
    assert draw_population(5, people=40, days=3, serial_bits=16) == drawn
    assert draw_population(6, people=40, days=3, serial_bits=16).stays != drawn.stays
    assert len(drawn.people) == 80
    assert len(drawn.enrolled) == 40
    assert {stay.person for stay in drawn.stays} <= {person.number for person in drawn.enrolled}


def test_everybody_has_a_uid_of_one_delivery_whose_serial_number_fits(drawn: Population) -> None:
    uids = [person.uid for person in drawn.people]
    assert len(set(uids)) == len(uids)
    assert all(len(uid) == 24 and uid.startswith(UID_PREFIX) for uid in uids)
    assert all(int(uid[len(UID_PREFIX) :], 16) < 1 << 16 for uid in uids)
    with pytest.raises(ValueError, match="bits"):
        make_uid(256, 8)


def test_people_come_to_their_own_ward_and_companions_at_the_same_moment(drawn: Population) -> None:
    for stay in drawn.stays:
        assert drawn.people[stay.person].ward == stay.robot
    rounds: dict[tuple[int, int, int], list[int]] = {}
    for stay in drawn.stays:
        rounds.setdefault((stay.robot, stay.day, stay.round), []).append(stay.clips_at_ms[0])
    assert all(max(begins) - min(begins) <= ROUND_WINDOW_MS + 1_000 for begins in rounds.values())
    begins = {(s.day, s.round, s.person): s.clips_at_ms[0] for s in drawn.stays}
    assert drawn.companions
    for (day, number, person), begin in begins.items():
        friend = drawn.companions.get(person)
        if friend is not None:
            assert abs(begins[day, number, friend] - begin) <= 400

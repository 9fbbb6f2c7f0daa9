"""The plan of a hospital's days: the same by a seed, and never of somebody or something that is not there."""

from __future__ import annotations

from collections import Counter

import pytest

from consensus.errors import BlockRobotError
from consensus.records.envelopes import open_data_key, open_metadata, open_sealed
from network.lab.year.people import Visit, make_person, seal_from, seal_record
from network.lab.year.plan import RATES, Event, HospitalPlan, YearOptions

OPTIONS = YearOptions(days=60, members=200, robots=4, custodians=3, seed=5)


def days_of(options: YearOptions) -> list[list[Event]]:
    plan = HospitalPlan(options)
    return [plan.next_day() for _ in range(options.days)]


def test_the_same_options_draw_the_same_days_and_another_seed_others() -> None:
    first = days_of(OPTIONS)
    assert days_of(OPTIONS) == first
    assert days_of(OPTIONS._replace(seed=6)) != first


def test_everything_happens_within_a_month_even_in_a_small_hospital() -> None:
    small = days_of(YearOptions(days=30, members=20, robots=2, custodians=1, seed=1))
    happened = Counter(event.kind for day in small for event in day)
    assert set(happened) == {*RATES, "lift", "revoke_grant"}


def test_nothing_happens_to_a_visit_before_it_or_once_nothing_is_left_of_it() -> None:
    kept_until: dict[int, int] = {}
    held: set[int] = set()
    erased: set[tuple[int, int]] = set()
    for day, events in enumerate(days_of(OPTIONS)):
        for event in events:
            if event.kind == "visit":
                kept_until[event.subject] = day + event.amounts[2]
            elif event.kind in {"look", "share", "erase", "erase_frame", "restrict", "object", "deny"}:
                is_held = event.subject in held
                assert is_held or kept_until[event.subject] > day, (day, event)
                assert not erased & {(event.subject, index) for index in event.records}, (day, event)
                assert not (is_held and event.kind in {"share", "restrict", "deny"}), (day, event)
            if event.kind in {"erase", "deny"}:
                erased |= {(event.subject, index) for index in event.records}
            if event.kind == "restrict":
                held.add(event.subject)
            if event.kind == "lift":
                held.remove(event.subject)


def test_who_left_is_met_no_more_and_who_refuses_is_not_recorded() -> None:
    there, refusing = set(range(OPTIONS.members)), set()
    for events in days_of(OPTIONS):
        for event in events:
            match event.kind:
                case "arrive":
                    assert event.subject not in there
                    there.add(event.subject)
                case "leave" | "revoke_member":
                    there.remove(event.subject)
                case "withdraw":
                    refusing.add(event.subject)
                case "give":
                    refusing.remove(event.subject)
                case "rotate":
                    assert event.subject in there
                case "visit":
                    assert event.amounts[0] in there
                    assert bool(event.amounts[3:]) == (event.amounts[0] not in refusing)


@pytest.mark.parametrize("size", [0, 32, 500])
def test_a_box_sealed_from_a_seed_opens_as_any_other_and_is_the_same_again(size: int) -> None:
    keys, plaintext = make_person(1, "somebody", "subject").keys, bytes(range(256)) * 2
    sealed = seal_from(b"k" * 32, keys.sealing_public, plaintext[:size])
    assert open_sealed(keys.sealing, sealed) == plaintext[:size]
    assert seal_from(b"k" * 32, keys.sealing_public, plaintext[:size]) == sealed
    assert seal_from(b"l" * 32, keys.sealing_public, plaintext[:size]) != sealed


def test_words_and_keys_of_a_person_come_from_the_seed_and_each_era_has_its_own() -> None:
    person, again = make_person(3, "ann", "subject"), make_person(3, "ann", "subject")
    assert person.words == again.words != make_person(4, "ann", "subject").words
    before = person.keys.identity.public_key
    assert person.take_new_keys().identity.public_key != before
    assert len(set(person.words)) == 2


def test_a_clip_of_the_year_opens_with_its_persons_keys_alone() -> None:
    person, other = make_person(3, "ann", "subject"), make_person(3, "bob", "subject")
    visit = Visit(0, person, b"r" * 33, b"o" * 33, person.keys.identity, person.keys.sealing)
    sealed = seal_record(visit, person.keys.sealing_public, 2, 1_000, 0, bytes(32))
    assert seal_record(visit, person.keys.sealing_public, 2, 1_000, 0, bytes(32)) == sealed
    assert open_metadata(person.keys.sealing, sealed.sealed_metadata)
    for key in sealed.upload.sealed_keys:
        open_data_key(person.keys.sealing, key)
        with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
            open_data_key(other.keys.sealing, key)

"""Who is enrolled and who was here: won on the prototype's way, and on planted leaks; guessed on ours."""

from __future__ import annotations

import hashlib

import pytest

from network.lab.privacy.attacks.ledger_view import LedgerView, WordSeen
from network.lab.privacy.attacks.membership import (
    PROBES_COUNT,
    SPEAKING_ENTRIES,
    attack_enrolment,
    attack_presence,
    probe_standing,
)
from network.lab.privacy.attacks.open_limits import (
    attack_addresses,
    attack_consent_words,
    attack_copresence,
    attack_one_frame,
    attack_registration_times,
    attack_request_bursts,
    attack_robot_memory,
    attack_session_times,
    measure_time_error_s,
)
from network.lab.privacy.hospital.attacked_days import MANNERS
from network.lab.privacy.hospital.population import DAY_MS
from network.lab.privacy.hospital.schemes import make_schemes
from tests.unit.network.attack.conftest import SEED, SmallHospital


@pytest.mark.parametrize(("name", "success"), [("prototype", 1.0), ("salted", 1.0), ("pepper_stolen", 1.0)])
def test_a_uid_tells_who_is_in_the_papers_registry(hospital: SmallHospital, name: str, success: float) -> None:
    rate = attack_enrolment(hospital.played, hospital.evidence.marks, make_schemes()[name], seed=SEED)
    assert rate.success == success


def test_a_uid_tells_nothing_of_our_registry_nor_of_the_papers_without_its_pepper(hospital: SmallHospital) -> None:
    rate = attack_enrolment(hospital.played, hospital.evidence.marks, make_schemes()["peppered"], seed=SEED)
    assert rate.success == 0.5
    assert attack_enrolment(hospital.played, hospital.evidence.marks, None, seed=SEED).success == 0.5
    uids = [person.uid for person in hospital.played.population.enrolled]
    planted = hospital.evidence.marks | {hashlib.sha256(uid.encode()).digest() for uid in uids}
    assert attack_enrolment(hospital.played, planted, None, seed=SEED).success == 1.0


@pytest.mark.parametrize("name", ["prototype", "salted", "peppered", "pepper_stolen"])
def test_a_mark_on_each_record_tells_who_was_here(hospital: SmallHospital, name: str) -> None:
    """Also a peppered one, and without the pepper: it is the same each time."""
    rate = attack_presence(hospital.played, hospital.evidence.view, make_schemes()[name], seed=SEED)
    assert rate.trials > 5
    assert rate.success == 1.0


def test_a_handle_does_not_tell_who_was_here(hospital: SmallHospital) -> None:
    assert attack_presence(hospital.played, hospital.evidence.view, None, seed=SEED).success == 0.5


@pytest.mark.parametrize("one_in", [1, 2])
def test_a_robot_that_wrote_something_under_a_handle_would_tell(hospital: SmallHospital, one_in: int) -> None:
    """As it would if it asked the chain for consent one by one, in transactions."""
    played, view = hospital.played, hospital.evidence.view
    words = []
    for number in list(played.truth.stay_of_owner.values())[::one_in]:
        stay = played.population.stays[number]
        holder = played.holders[stay.person]
        at_ms = played.chain.genesis.created_at_ms + 1000 + (stay.day + 1) * DAY_MS + 1
        words.append(WordSeen(holder.handle, holder.keys.identity.public_key, "asked", at_ms))
    told = LedgerView(view.visits, view.registrations, (*view.words, *words))
    rate = attack_presence(played, told, None, seed=SEED)
    assert rate.trials == attack_presence(played, view, None, seed=SEED).trials > 0
    assert rate.success > (0.95 if one_in == 1 else 0.6)
    assert not rate.is_guessing


@pytest.mark.parametrize("entry", SPEAKING_ENTRIES)
def test_whoever_spoke_of_her_consent_is_left_out_and_nobody_else(hospital: SmallHospital, entry: str) -> None:
    played, view = hospital.played, hospital.evidence.view
    at_ms = played.chain.genesis.created_at_ms + 1000 + DAY_MS + 1
    words = tuple(WordSeen(h.handle, h.keys.identity.public_key, entry, at_ms) for h in played.holders.values())
    told = LedgerView(view.visits, view.registrations, words)
    rate = attack_presence(played, told, None, seed=SEED)
    assert 0 < rate.trials < attack_presence(played, told, None, seed=SEED, speaking=True).trials


def test_a_node_answers_an_outsider_the_same_of_members_and_strangers(hospital: SmallHospital) -> None:
    rate = probe_standing(hospital.played, seed=SEED)
    assert rate.trials == PROBES_COUNT
    assert rate.success == 0.5
    assert rate.is_guessing


def test_the_accepted_limits_are_real(hospital: SmallHospital) -> None:
    """Each of these attacks wins: none may be taken for a promise that holds."""
    played, visits, view = hospital.played, hospital.evidence.visits, hospital.evidence.view
    assert attack_copresence(played, visits, seed=SEED).success > 0.9
    assert attack_addresses(played, seed=SEED).success == 1.0
    assert attack_session_times(played, seed=SEED).success > 0.5
    assert attack_registration_times(played, hospital.evidence.view, seed=SEED).trials > 0
    assert attack_consent_words(played, hospital.evidence.view).trials >= 0
    assert attack_one_frame(played, visits).trials > 0
    assert sum(attack_request_bursts(played, view, manner, seed=SEED).trials for manner in MANNERS) > 0
    assert 0 < measure_time_error_s(played, visits) < 2


def test_a_robot_forgets_whose_its_past_visits_were(hospital: SmallHospital) -> None:
    rate = attack_robot_memory(hospital.played, hospital.evidence.visits)
    assert rate.trials > 0
    assert rate.success == 0.0

"""Linking wins wherever something links, and only there: planted leaks of every kind."""

from __future__ import annotations

import secrets
from collections.abc import Callable

import numpy as np
import pytest

from network.lab.privacy.attacks import linking
from network.lab.privacy.attacks.learner import has_boosting
from network.lab.privacy.attacks.ledger_view import RecordSeen, VisitSeen
from network.lab.privacy.attacks.trials import Features, Labelled, attack_pairs, draw_trials, join_pairs, pairs_of
from network.lab.privacy.scoring import Rate

PEOPLE, DAYS, ROUNDS = 24, 4, 2
ROBOT = b"\x02" * 33
DAY_MS = 86_400_000
LEARNERS = [False, True] if has_boosting() else [False]


class Ward:
    """People who come to one robot on every round; nothing links their visits unless it is planted."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(11)
        self.labels = [
            Labelled(number, person, 0, day, turn)
            for number, (day, turn, person) in enumerate(
                (d, t, p) for d in range(DAYS) for t in range(ROUNDS) for p in range(PEOPLE)
            )
        ]
        self.visits = [self.visit(label) for label in self.labels]
        self.sizes = [self.rng.integers(1_000, 9_000, size=6).tolist() for _ in self.labels]

    def visit(self, label: Labelled) -> VisitSeen:
        at_ms = (label.day + 1) * DAY_MS + label.round * 4 * 3_600_000 + int(self.rng.integers(180_000))
        view_tag, height = secrets.randbelow(256), at_ms // 40
        owner, ephemeral = secrets.token_bytes(33), secrets.token_bytes(33)
        visit = VisitSeen(owner, ephemeral, view_tag, ROBOT, at_ms - at_ms % 300_000, at_ms, height, 0)
        for number in range(int(self.rng.integers(2, 8))):
            then = at_ms + 500 * number + int(self.rng.integers(500))
            roots = (secrets.token_bytes(32), secrets.token_bytes(32), secrets.token_bytes(560))
            visit.records.append(RecordSeen(secrets.token_bytes(16), then, then // 40, 0, 900, *roots))
        return visit

    def attack(self, features: Features, *, boosting: bool = False, matched: bool = True) -> Rate:
        pairs = pairs_of(draw_trials(self.labels, matched=matched, seed=2), features)
        return attack_pairs(pairs, seed=2, boosting=boosting)


@pytest.fixture
def ward() -> Ward:
    return Ward()


ATTACKS: dict[str, Callable[[Ward], Features]] = {
    "key": lambda ward: linking.by_key(ward.visits),
    "time": lambda ward: linking.by_time(ward.visits),
    "robot": lambda ward: linking.by_robot(ward.visits),
    "size": lambda ward: linking.by_size(ward.sizes),
    "length": lambda ward: linking.by_length(ward.visits),
}


@pytest.mark.parametrize("boosting", LEARNERS)
@pytest.mark.parametrize("name", ATTACKS)
def test_where_nothing_links_an_attack_guesses(ward: Ward, name: str, boosting: bool) -> None:
    rate = ward.attack(ATTACKS[name](ward), boosting=boosting)
    assert rate.guess == 0.5
    assert 0.42 <= rate.success <= 0.58


@pytest.mark.parametrize("boosting", LEARNERS)
def test_a_key_that_is_used_twice_links(ward: Ward, boosting: bool) -> None:
    for label in ward.labels:
        ward.visits[label.number].ephemeral = bytes([label.person]) * 33
    assert ward.attack(ATTACKS["key"](ward), boosting=boosting).success > 0.95


def test_one_byte_of_a_key_that_is_a_persons_own_links(ward: Ward) -> None:
    for label in ward.labels:
        visit = ward.visits[label.number]
        visit.owner = bytes([label.person]) + visit.owner[1:]
    assert ward.attack(ATTACKS["key"](ward)).success > 0.9


def test_a_view_tag_that_stays_the_same_links(ward: Ward) -> None:
    for label in ward.labels:
        ward.visits[label.number].view_tag = 7 * label.person
    assert ward.attack(ATTACKS["key"](ward)).success > 0.9


def test_a_robot_that_works_through_people_in_one_order_links(ward: Ward) -> None:
    """As it would if it submitted in the order of its roster."""
    for label in ward.labels:
        visit = ward.visits[label.number]
        visit.at_ms = visit.at_ms - visit.at_ms % 300_000 + 40 * label.person
        visit.records = []
    assert ward.attack(ATTACKS["time"](ward)).success > 0.9


def test_a_rhythm_of_ones_own_links(ward: Ward) -> None:
    for label in ward.labels:
        visit = ward.visits[label.number]
        step = 300 + 50 * label.person
        visit.records = [
            RecordSeen(b"", visit.at_ms + step * n, 0, 0, 900, b"", b"", b"") for n in range(1, len(visit.records) + 1)
        ]
    assert ward.attack(ATTACKS["time"](ward)).success > 0.9


@pytest.mark.parametrize("boosting", LEARNERS)
def test_sizes_of_ones_own_link(ward: Ward, boosting: bool) -> None:
    for label in ward.labels:
        ward.sizes[label.number] = [2_000 + 400 * label.person] * 6
    assert ward.attack(ATTACKS["size"](ward), boosting=boosting).success > 0.9


def test_always_staying_equally_long_links(ward: Ward) -> None:
    for label in ward.labels:
        visit = ward.visits[label.number]
        visit.records = [visit.records[0]] * (2 + label.person)
    assert ward.attack(ATTACKS["length"](ward)).success > 0.9


def test_always_coming_in_company_links(ward: Ward) -> None:
    """Two people in three come alone, one in three with somebody: who does is alike in that."""
    visits = ward.visits
    for label in ward.labels:
        if label.person % 6 == 1:
            visits[label.number].at_ms = visits[label.number - 1].at_ms + 20
        else:
            visits[label.number].at_ms += 1_000_000 * label.person
    assert ward.attack(linking.by_company(visits)).success > 0.55


def test_a_robot_of_ones_own_links_only_where_place_is_not_matched(ward: Ward) -> None:
    for label in ward.labels:
        ward.visits[label.number].robot = bytes([label.person % 4]) * 33
    assert ward.attack(ATTACKS["robot"](ward), matched=False).success > 0.8


def test_all_together_are_as_good_as_the_best(ward: Ward) -> None:
    for label in ward.labels:
        ward.visits[label.number].view_tag = 7 * label.person
    trials = draw_trials(ward.labels, matched=True, seed=2)
    every = join_pairs(*(pairs_of(trials, make(ward)) for make in ATTACKS.values()))
    assert attack_pairs(every, seed=2, boosting=False).success > 0.9


def test_a_trial_never_shows_the_anchor_among_its_candidates(ward: Ward) -> None:
    for trial in draw_trials(ward.labels, matched=True, seed=3):
        anchor, same, other = (ward.labels[number] for number in (trial.anchor, trial.same, trial.other))
        assert anchor.person == same.person == trial.person != other.person
        assert anchor.day != same.day
        assert (same.day, same.round) == (other.day, other.round)

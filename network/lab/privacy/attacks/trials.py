"""Linking trials: which of two visits is the same person's as a given one?

`matched`: both candidates share robot and round, so place and hour reveal nothing; free: any other visit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from network.lab.privacy.attacks.learner import Floats, compare, learn
from network.lab.privacy.scoring import Rate, grouped_rate

TRIALS_A_PERSON_COUNT = 48


@dataclass(frozen=True, slots=True)
class Labelled:
    """A numbered visit with its truth: person, place, day, round."""

    number: int
    person: int
    robot: int
    day: int
    round: int


@dataclass(frozen=True, slots=True)
class Trial:
    """Indices of an anchor, the same person's other-day visit, and another person's."""

    person: int
    anchor: int
    same: int
    other: int


Features = Callable[[int, int], Sequence[float]]
"""Of two visits by number: what the attacker makes of the pair."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """Of each trial: whose it is, and the features (trials, features) of the true and of the false pair."""

    people: npt.NDArray[np.int64]
    same: Floats
    other: Floats


def draw_trials(visits: Sequence[Labelled], *, matched: bool, seed: int) -> list[Trial]:
    rng = np.random.default_rng([seed, 0x7121A1, matched])
    own: dict[int, list[Labelled]] = defaultdict(list)
    beside: dict[tuple[int, int, int], list[Labelled]] = defaultdict(list)
    for visit in visits:
        own[visit.person].append(visit)
        beside[visit.robot, visit.day, visit.round].append(visit)
    trials = []
    for person, mine in sorted(own.items()):
        pairs = [(first, second) for first in mine for second in mine if first.day != second.day]
        for place in rng.permutation(len(pairs))[:TRIALS_A_PERSON_COUNT]:
            anchor, same = pairs[place]
            pool = beside[same.robot, same.day, same.round] if matched else visits
            others = [visit for visit in pool if visit.person != person]
            if others:
                other = others[int(rng.integers(len(others)))]
                trials.append(Trial(person, anchor.number, same.number, other.number))
    return trials


def pairs_of(trials: Sequence[Trial], features: Features) -> Pairs:
    return Pairs(
        np.array([trial.person for trial in trials], dtype=np.int64),
        np.array([features(trial.anchor, trial.same) for trial in trials], dtype=np.float64),
        np.array([features(trial.anchor, trial.other) for trial in trials], dtype=np.float64),
    )


def join_pairs(*parts: Pairs) -> Pairs:
    """All features of the same trials."""
    return Pairs(parts[0].people, np.hstack([part.same for part in parts]), np.hstack([part.other for part in parts]))


def attack_pairs(pairs: Pairs, *, seed: int, boosting: bool) -> Rate:
    """Each half of the people is attacked by who learned on the other."""
    people, same, other = pairs.people, pairs.same, pairs.other
    if not len(people):
        return grouped_rate({}, 0.5, seed=seed)
    half = np.isin(people, np.random.default_rng([seed, 0x4A1F]).permutation(np.unique(people))[::2])
    hits: dict[int, list[float]] = defaultdict(list)
    for judged in (half, ~half):
        if not judged.any() or judged.all():
            continue
        score = learn(same[~judged], other[~judged], people[~judged], seed=seed, boosting=boosting)
        for person, hit in zip(people[judged], compare(score(same[judged]), score(other[judged])), strict=True):
            hits[int(person)].append(float(hit))
    return grouped_rate(hits, 0.5, seed=seed)

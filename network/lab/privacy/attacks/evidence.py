"""Attackers' input, and the truth that judges them."""

from __future__ import annotations

from dataclasses import dataclass

from network.lab.privacy.attacks.ledger_view import LedgerView, VisitSeen, collect_marks, read_ledger
from network.lab.privacy.attacks.trials import Labelled, Trial, draw_trials
from network.lab.privacy.hospital.attacked_days import Played
from network.lab.privacy.hospital.schemes import Scheme, make_schemes


@dataclass(frozen=True, slots=True)
class Evidence:
    """Chain, ordered visits, custodians' sizes, the paper's schemes; for judging, the trials."""

    played: Played
    view: LedgerView
    visits: tuple[VisitSeen, ...]
    sizes: tuple[tuple[int, ...], ...]
    marks: frozenset[bytes]
    labels: tuple[Labelled, ...]
    matched: tuple[Trial, ...]
    free: tuple[Trial, ...]
    schemes: dict[str, Scheme]
    seed: int
    boosting: bool

    def uid_of(self, visit: int) -> str:
        return self.played.holders[self.labels[visit].person].person.uid


def gather(played: Played, *, seed: int, boosting: bool) -> Evidence:
    view = read_ledger(played.chain.blocks)
    visits = tuple(visit for visit in view.visits.values() if visit.records)
    sizes = tuple(
        tuple(len(text) for record in visit.records for text in played.uploads[record.record_id].ciphertexts)
        for visit in visits
    )
    labels = []
    for number, visit in enumerate(visits):
        stay = played.population.stays[played.truth.stay_of_owner[visit.owner]]
        labels.append(Labelled(number, stay.person, stay.robot, stay.day, stay.round))
    return Evidence(
        played=played,
        view=view,
        visits=visits,
        sizes=sizes,
        marks=frozenset(collect_marks(played.chain)),
        labels=tuple(labels),
        matched=tuple(draw_trials(labels, matched=True, seed=seed)),
        free=tuple(draw_trials(labels, matched=False, seed=seed)),
        schemes=make_schemes(),
        seed=seed,
        boosting=boosting,
    )

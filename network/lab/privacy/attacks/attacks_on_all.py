"""Attacks on every scheme: dictionary, linking, membership.

Others do what needs public data alone: pure functions of hashes, of public keys, and of numbers made of pairs of visits.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace

from network.lab.privacy.attacks import linking
from network.lab.privacy.attacks.dictionary import Search, computed_costs, search_chain, search_marks
from network.lab.privacy.attacks.evidence import Evidence
from network.lab.privacy.attacks.membership import attack_enrolment, attack_presence, probe_standing
from network.lab.privacy.attacks.naming import name_visits
from network.lab.privacy.attacks.trials import Pairs, attack_pairs, join_pairs, pairs_of
from network.lab.privacy.hospital.schemes import OURS, PROTOTYPE, SALTED, Scheme, hash_uid
from network.lab.privacy.scoring import Rate, Rates, choice_score, count_rate, grouped_rate

SALTED_TARGETS_COUNT = 8
SALTED_TRIALS_COUNT = 8
NAMED_VISITS_COUNT = 200
_CHAIN_PARTS_COUNT = 16
_NAMED_A_JOB_COUNT = 20

Progress = Callable[[str], None]
Found = dict[str, Rate]
"""By scheme."""


def attack_all_schemes(
    evidence: Evidence, pool: Executor, progress: Progress
) -> Callable[[], tuple[Rates, dict[str, float]]]:
    """Hand out what others can do; what is returned does the rest, and waits for them."""
    progress("handing out: trying all UIDs, naming visits by guessed secrets")
    dictionary = _attack_dictionary(evidence, pool)
    named = _attack_names(evidence, pool)
    progress("handing out: linking visits")
    salted = _link_salted(evidence, pool)
    links = _link_visits(evidence, pool)

    def wait() -> tuple[Rates, dict[str, float]]:
        progress("asking who is enrolled, and who was here")
        played, schemes, seed = evidence.played, evidence.schemes, evidence.seed
        enrolled = _for_each(schemes, lambda s: attack_enrolment(played, evidence.marks, s, seed=seed))
        present = _for_each(schemes, lambda s: attack_presence(played, evidence.view, s, seed=seed))
        probed = probe_standing(played, seed=seed)
        progress("waiting for what was handed out")
        rates: Rates = {}
        rates["dictionary"], figures = dictionary()
        for name, jobs in links.items():
            rates[name] = {scheme: job.result() for scheme, job in jobs.items()}
        rates["link_key"][SALTED] = rates["link_all"][SALTED] = salted()
        rates["name"] = {**_guess_one_of(rates["dictionary"], len(played.holders)), OURS: named()}
        return rates | {"enrolled": enrolled, "present": present, "probe": {OURS: probed}}, figures

    return wait


def _for_each(schemes: dict[str, Scheme], attack: Callable[[Scheme | None], Rate]) -> Found:
    return {name: attack(scheme) for name, scheme in schemes.items()} | {OURS: attack(None)}


def _link_visits(evidence: Evidence, pool: Executor) -> dict[str, dict[str, Future[Rate]]]:
    """Jobs by attack and scheme."""
    visits, trials, schemes = evidence.visits, evidence.matched, evidence.schemes
    shared = {
        "time": pairs_of(trials, linking.by_time(visits)),
        "robot": pairs_of(trials, linking.by_robot(visits)),
        "size": pairs_of(trials, linking.by_size(evidence.sizes)),
    }

    def hand_out(pairs: Pairs) -> Future[Rate]:
        return pool.submit(attack_pairs, pairs, seed=evidence.seed, boosting=evidence.boosting)

    jobs = {f"link_{name}": dict.fromkeys((*schemes, OURS), hand_out(pairs)) for name, pairs in shared.items()}
    jobs |= {"link_key": {}, "link_all": {}}
    for name in (OURS, *(name for name in schemes if name != SALTED)):
        marks = (
            [schemes[name].mark(evidence.uid_of(place)).digest for place in range(len(visits))] if name != OURS else ()
        )
        by_key = pairs_of(trials, linking.by_key(visits, marks))
        jobs["link_key"][name] = hand_out(by_key)
        jobs["link_all"][name] = hand_out(join_pairs(by_key, *shared.values()))
    return jobs


def _attack_dictionary(evidence: Evidence, pool: Executor) -> Callable[[], tuple[Found, dict[str, float]]]:
    bits, chain_id = evidence.played.population.serial_bits, evidence.played.chain.chain_id
    uids = [holder.person.uid for holder in evidence.played.holders.values()]
    tried = {name: uids[:SALTED_TARGETS_COUNT] if name == SALTED else uids for name in evidence.schemes}
    jobs = {
        name: pool.submit(search_marks, scheme.marks(tried[name]), scheme.known_pepper or b"", bits)
        for name, scheme in evidence.schemes.items()
    }
    parts = [
        pool.submit(search_chain, evidence.marks, chain_id, bits, part, _CHAIN_PARTS_COUNT)
        for part in range(_CHAIN_PARTS_COUNT)
    ]

    def wait() -> tuple[Found, dict[str, float]]:
        searches = {name: job.result() for name, job in jobs.items()}
        on_ours = [part.result() for part in parts]
        guess = 2.0**-bits
        rates = {name: _rate_of(found, tried[name], guess) for name, found in searches.items()}
        hits = len({uid for part in on_ours for uid in part.found.values()} & set(uids))
        rates[OURS] = count_rate(hits, len(uids), guess)
        figures: dict[str, float] = {"dictionary_hashes_per_s": round(searches[PROTOTYPE].rate)}
        for name, search in searches.items():
            figures[f"dictionary_{name}_s"] = round(search.seconds, 2)
        figures[f"dictionary_{OURS}_s"] = round(sum(part.seconds for part in on_ours), 2)
        return rates, figures | computed_costs(searches[PROTOTYPE].rate)

    return wait


def _rate_of(search: Search, uids: list[str], guess: float) -> Rate:
    hits = sum(search.found.get(place) == uid for place, uid in enumerate(uids))
    return count_rate(hits, len(uids), guess)


def _link_salted(evidence: Evidence, pool: Executor) -> Callable[[], Rate]:
    scheme = evidence.schemes[SALTED]
    marks = [scheme.mark(evidence.uid_of(place)) for place in range(len(evidence.visits))]
    bits = evidence.played.population.serial_bits
    step = max(1, len(evidence.matched) // SALTED_TRIALS_COUNT)
    trials = evidence.matched[::step][:SALTED_TRIALS_COUNT]
    jobs = {
        anchor: pool.submit(search_marks, [marks[anchor]], b"", bits) for anchor in {trial.anchor for trial in trials}
    }

    def score(uid: str | None, other: int) -> float:
        mark = marks[other]
        return float(uid is not None and hash_uid(scheme.pepper, mark.salt, uid.encode()) == mark.digest)

    def wait() -> Rate:
        hits: dict[int, list[float]] = defaultdict(list)
        for trial in trials:
            uid = jobs[trial.anchor].result().found.get(0)
            hits[trial.person].append(choice_score(score(uid, trial.same), score(uid, trial.other)))
        return grouped_rate(hits, 0.5, seed=evidence.seed)

    return wait


def _attack_names(evidence: Evidence, pool: Executor) -> Callable[[], Rate]:
    holders = list(evidence.played.holders.values())
    people = [holder.public_keys for holder in holders]
    step = max(1, len(evidence.visits) // NAMED_VISITS_COUNT)
    visits = [replace(visit, records=[]) for visit in evidence.visits[::step][:NAMED_VISITS_COUNT]]
    jobs = [
        pool.submit(name_visits, visits[first : first + _NAMED_A_JOB_COUNT], people, evidence.played.chain.chain_id)
        for first in range(0, len(visits), _NAMED_A_JOB_COUNT)
    ]

    def wait() -> Rate:
        named = [pair for job in jobs for pair in job.result().items()]
        right = sum(holders[place].person.number == evidence.played.person_of(owner) for owner, place in named)
        return count_rate(right, len(visits), 1 / max(1, len(people)))

    return wait


def _guess_one_of(dictionary: Found, people: int) -> Found:
    """Who finds the UID has the name: the paper's schemes."""
    return {name: replace(rate, guess=1 / max(1, people)) for name, rate in dictionary.items() if name != OURS}

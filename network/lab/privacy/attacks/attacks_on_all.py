"""Attacks on every scheme: dictionary, linking, membership."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

from network.lab.privacy.attacks import linking
from network.lab.privacy.attacks.dictionary import Search, computed_costs, search_chain, search_marks
from network.lab.privacy.attacks.evidence import Evidence
from network.lab.privacy.attacks.membership import attack_enrolment, attack_presence, probe_standing
from network.lab.privacy.attacks.naming import name_visits
from network.lab.privacy.attacks.trials import Features, attack_trials
from network.lab.privacy.hospital.schemes import OURS, PROTOTYPE, SALTED, Scheme, hash_uid, make_schemes
from network.lab.privacy.scoring import Rate, Rates, choice_score, count_rate, grouped_rate

SALTED_TARGETS_COUNT = 8
SALTED_TRIALS_COUNT = 8
NAMED_VISITS_COUNT = 200

Progress = Callable[[str], None]


def attack_all_schemes(evidence: Evidence, progress: Progress) -> tuple[Rates, dict[str, float]]:
    schemes = make_schemes()
    rates: Rates = {}
    progress("trying all UIDs")
    rates["dictionary"], figures = _attack_dictionary(evidence, schemes)
    shared = _shared_attacks(evidence)
    for name, features in shared.items():
        progress(f"linking visits by {name}")
        rate = _learned(evidence, features)
        rates[f"link_{name}"] = dict.fromkeys((*schemes, OURS), rate)
    for name, by_key in _key_attacks(evidence, schemes).items():
        progress(f"linking visits by key and by everything: {name}")
        rates.setdefault("link_key", {})[name] = _learned(evidence, by_key)
        rates.setdefault("link_all", {})[name] = _learned(evidence, linking.joined(by_key, *shared.values()))
    progress("linking salted marks")
    rates["link_key"][SALTED] = rates["link_all"][SALTED] = _link_salted(evidence, schemes[SALTED])
    progress("naming visits by guessed secrets")
    rates["name"] = _attack_names(evidence, schemes, rates["dictionary"])
    progress("asking who is enrolled, and who was here")
    rates["enrolled"] = _for_each(
        schemes, lambda s: attack_enrolment(evidence.played, evidence.marks, s, seed=evidence.seed)
    )
    rates["present"] = _for_each(
        schemes, lambda s: attack_presence(evidence.played, evidence.view, s, seed=evidence.seed)
    )
    rates["probe"] = {OURS: probe_standing(evidence.played, seed=evidence.seed)}
    return rates, figures


def _for_each(schemes: dict[str, Scheme], attack: Callable[[Scheme | None], Rate]) -> dict[str, Rate]:
    return {name: attack(scheme) for name, scheme in schemes.items()} | {OURS: attack(None)}


def _shared_attacks(evidence: Evidence) -> dict[str, Features]:
    return {
        "time": linking.by_time(evidence.visits),
        "robot": linking.by_robot(evidence.visits),
        "size": linking.by_size(evidence.sizes),
    }


def _key_attacks(evidence: Evidence, schemes: dict[str, Scheme]) -> dict[str, Features]:
    attacks = {OURS: linking.by_key(evidence.visits)}
    for name, scheme in schemes.items():
        if name != SALTED:
            marks = [scheme.mark(evidence.uid_of(place)).digest for place in range(len(evidence.visits))]
            attacks[name] = linking.by_key(evidence.visits, marks)
    return attacks


def _learned(evidence: Evidence, features: Features) -> Rate:
    return attack_trials(evidence.matched, features, seed=evidence.seed, boosting=evidence.boosting)


def _attack_dictionary(evidence: Evidence, schemes: dict[str, Scheme]) -> tuple[dict[str, Rate], dict[str, float]]:
    bits = evidence.played.population.serial_bits
    uids = [holder.person.uid for holder in evidence.played.holders.values()]
    guess = 2.0**-bits
    rates, searches = {}, {}
    for name, scheme in schemes.items():
        tried = uids[:SALTED_TARGETS_COUNT] if name == SALTED else uids
        pepper = b"" if scheme.known_pepper is None else scheme.known_pepper
        searches[name] = found = search_marks(scheme.marks(tried), pepper, bits)
        rates[name] = _rate_of(found, tried, guess)
    searches[OURS] = search_chain(evidence.marks, evidence.played.chain.chain_id, bits)
    hits = len(set(searches[OURS].found.values()) & set(uids))
    rates[OURS] = count_rate(hits, len(uids), guess)
    figures: dict[str, float] = {"dictionary_hashes_per_s": round(searches[PROTOTYPE].rate)}
    for name, search in searches.items():
        figures[f"dictionary_{name}_s"] = round(search.seconds, 2)
    return rates, figures | computed_costs(searches[PROTOTYPE].rate)


def _rate_of(search: Search, uids: list[str], guess: float) -> Rate:
    hits = sum(search.found.get(place) == uid for place, uid in enumerate(uids))
    return count_rate(hits, len(uids), guess)


def _link_salted(evidence: Evidence, scheme: Scheme) -> Rate:
    marks = [scheme.mark(evidence.uid_of(place)) for place in range(len(evidence.visits))]
    bits = evidence.played.population.serial_bits
    step = max(1, len(evidence.matched) // SALTED_TRIALS_COUNT)
    trials = evidence.matched[::step][:SALTED_TRIALS_COUNT]
    anchors = sorted({trial.anchor for trial in trials})
    found = search_marks([marks[place] for place in anchors], b"", bits).found
    uids = {anchors[place]: uid.encode() for place, uid in found.items()}

    def score(anchor: int, other: int) -> float:
        uid = uids.get(anchor)
        mark = marks[other]
        return float(uid is not None and hash_uid(scheme.pepper, mark.salt, uid) == mark.digest)

    hits: dict[int, list[float]] = defaultdict(list)
    for trial in trials:
        hits[trial.person].append(choice_score(score(trial.anchor, trial.same), score(trial.anchor, trial.other)))
    return grouped_rate(hits, 0.5, seed=evidence.seed)


def _attack_names(evidence: Evidence, schemes: dict[str, Scheme], dictionary: dict[str, Rate]) -> dict[str, Rate]:
    holders = list(evidence.played.holders.values())
    people = [holder.public_keys for holder in holders]
    step = max(1, len(evidence.visits) // NAMED_VISITS_COUNT)
    visits = evidence.visits[::step][:NAMED_VISITS_COUNT]
    named = name_visits(visits, people, evidence.played.chain.chain_id)
    right = sum(holders[place].person.number == evidence.played.person_of(owner) for owner, place in named.items())
    guess = 1 / max(1, len(people))
    rates = {name: Rate(r.success, guess, r.low, r.high, r.trials) for name, r in dictionary.items() if name in schemes}
    return rates | {OURS: count_rate(right, len(visits), guess)}

"""Measures the accepted limits: block times, copresence at robots, consent statements by handle."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from consensus.state.identity import MEMBER
from network.lab.privacy.attacks.ledger_view import LedgerView, VisitSeen
from network.lab.privacy.hospital.attacked_days import Played, SessionSeen, day_of
from network.lab.privacy.hospital.population import HOUR_MS
from network.lab.privacy.scoring import Rate, choice_score, count_rate, grouped_rate

NEAR_WORD_MS = 15_000
CLOSED_BY_WORD_MS = 30_000
"""So soon a robot that closed what a word ends would close it: every 15 s, and it has to hear of it first."""

CLOSED_EARLY_MS = 9 * 60_000 - 5_000
ONE_FRAME_MS = 250
_TRIALS_MAX_COUNT = 3_000


def attack_copresence(played: Played, visits: Sequence[VisitSeen], *, seed: int) -> Rate:
    """Guess which of two visits is a companion's, by adjacent records."""
    rng = np.random.default_rng([seed, 0xC09])
    groups: dict[tuple[int, int, int], list[tuple[int, VisitSeen]]] = defaultdict(list)
    for visit in visits:
        stay = played.population.stays[played.truth.stay_of_owner[visit.owner]]
        groups[stay.robot, stay.day, stay.round].append((stay.person, visit))
    hits: dict[int, list[float]] = defaultdict(list)
    for group in groups.values():
        for person, visit in group:
            friend = played.population.companions.get(person)
            true = [other for who, other in group if who == friend]
            rest = [other for who, other in group if who not in (friend, person)]
            if true and rest:
                other = rest[int(rng.integers(len(rest)))]
                hits[person].append(choice_score(-_apart(visit, true[0]), -_apart(visit, other)))
    return grouped_rate(hits, 0.5, seed=seed)


def _apart(first: VisitSeen, second: VisitSeen) -> float:
    return float(abs(first.at_ms - second.at_ms))


def attack_rolled_visits(played: Played, visits: Sequence[VisitSeen]) -> Rate:
    """Link visits longer than nine minutes with their continuation (second owner key)."""
    owners = {visit.owner: visit for visit in visits}
    hits = trials = 0
    guesses: list[float] = []
    for stay in played.population.stays:
        if not stay.is_long:
            continue
        seen = [owners[owner] for owner in played.truth.owners_of(stay.number) if owner in owners]
        for before, after in pairwise(seen):
            pool = [
                visit
                for visit in visits
                if visit.robot == after.robot and after.at_ms - 20 * 60_000 < visit.at_ms < after.at_ms
            ]
            chosen = min(pool, key=lambda visit: abs(after.at_ms - visit.ends_ms))
            trials += 1
            hits += chosen.owner == before.owner
            guesses.append(1 / len(pool))
    return count_rate(hits, trials, statistics.fmean(guesses) if guesses else 0.0)


def attack_consent_words(played: Played, view: LedgerView, *, by_closing_alone: bool = False) -> Rate:
    """Name the visit of a withdrawn consent: a nearby one closed early."""
    handles = {holder.handle: number for number, holder in played.holders.items()}
    visits = list(view.visits.values())
    hits = trials = 0
    guesses: list[float] = []
    for word in view.words:
        if word.entry != "withdraw":
            continue
        pool = [v for v in visits if v.at_ms <= word.at_ms and v.ends_ms > word.at_ms - NEAR_WORD_MS]
        if not pool:
            continue
        key = _closed_after if by_closing_alone else _stops_with
        chosen = min(pool, key=lambda visit: (not _is_closed_by(word.at_ms, visit), *key(word.at_ms, visit)))
        trials += 1
        hits += played.person_of(chosen.owner) == handles[word.handle]
        guesses.append(1 / len(pool))
    return count_rate(hits, trials, statistics.fmean(guesses) if guesses else 0.0)


def _is_closed_by(word_ms: int, visit: VisitSeen) -> bool:
    is_early = visit.closed_at_ms - visit.at_ms < CLOSED_EARLY_MS
    return is_early and 0 <= visit.closed_at_ms - word_ms < CLOSED_BY_WORD_MS


def _stops_with(word_ms: int, visit: VisitSeen) -> tuple[float, float]:
    return (visit.ends_ms > word_ms + 1_500, abs(visit.ends_ms - word_ms))


def _closed_after(word_ms: int, visit: VisitSeen) -> tuple[float, float]:
    return (visit.closed_at_ms < word_ms, abs(visit.closed_at_ms - word_ms))


def attack_addresses(played: Played, *, seed: int) -> Rate:
    members = {session.address: session.key for session in played.sessions if _is_member(played, session)}
    return _judge_sessions(played, lambda session: members.get(session.address), seed=seed)


def attack_session_times(played: Played, *, seed: int) -> Rate:
    opened = sorted((s.at_ms, s.key) for s in played.sessions if _is_member(played, s))

    def last_before(session: SessionSeen) -> bytes | None:
        before = [key for at_ms, key in opened if at_ms <= session.at_ms]
        return before[-1] if before else None

    return _judge_sessions(played, last_before, seed=seed)


def _is_member(played: Played, session: SessionSeen) -> bool:
    return MEMBER.has(played.chain.state, session.key)


def _judge_sessions(played: Played, name: Callable[[SessionSeen], bytes | None], *, seed: int) -> Rate:
    members = {holder.keys.identity.public_key: number for number, holder in played.holders.items()}
    hits: dict[int, list[float]] = defaultdict(list)
    for session in played.sessions:
        if session.key in members:
            continue
        person = played.person_of(session.key)
        hits[person].append(float(members.get(name(session) or b"") == person))
    return grouped_rate(hits, 1 / max(1, len(members)), seed=seed)


def attack_request_bursts(played: Played, view: LedgerView, manner: str, *, seed: int) -> Rate:
    """Guess which of two visits shares a third's owner, by adjacent requests."""
    rng = np.random.default_rng([seed, 0xB0257])
    times = dict(view.requests)
    evenings: dict[int, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for asked in played.truth.asked:
        if asked.manner == manner and asked.owner in times:
            evenings[asked.day][asked.person].append(_nearest(view.requests, asked.owner, asked.at_ms))
    hits: dict[int, list[float]] = defaultdict(list)
    for people in evenings.values():
        orders = {person: rng.permutation(len(own)) for person, own in people.items()}
        for person, own in people.items():
            ottheirs = [at_ms for other, found in people.items() if other != person for at_ms in found]
            for place in range(len(own) // 2) if ottheirs else ():
                anchor, same = (own[number] for number in orders[person][2 * place : 2 * place + 2])
                other = ottheirs[int(rng.integers(len(ottheirs)))]
                hits[person].append(choice_score(-abs(anchor - same), -abs(anchor - other)))
    return grouped_rate(hits, 0.5, seed=seed)


def _nearest(requests: Sequence[tuple[bytes, int]], owner: bytes, at_ms: int) -> float:
    return float(min((seen for key, seen in requests if key == owner), key=lambda seen: abs(seen - at_ms)))


def attack_registration_times(played: Played, view: LedgerView, *, seed: int) -> Rate:
    """Guess which of two admitted people is enrolled, by registrations within two hours."""
    rng = np.random.default_rng([seed, 0x2E6])
    times = np.array([at_ms for _, _, at_ms in view.registrations], dtype=np.float64)
    start = played.chain.genesis.created_at_ms + 1000
    scores: Mapping[bool, list[float]] = {True: [], False: []}
    for person in played.population.people:
        since = times - start - person.admitted_at_ms
        scores[person.enrolled].append(float(np.count_nonzero((since > 10 * 60_000) & (since < 2 * HOUR_MS))))
    count = min(_TRIALS_MAX_COUNT, len(scores[True]) * 8)
    hits: dict[int, list[float]] = defaultdict(list)
    for _ in range(count):
        first, second = int(rng.integers(len(scores[True]))), int(rng.integers(len(scores[False])))
        hits[first].append(choice_score(scores[True][first], scores[False][second]))
    return grouped_rate(hits, 0.5, seed=seed)


def measure_time_error_s(played: Played, visits: Sequence[VisitSeen]) -> float:
    """Return the median seconds between a clip's sealing and its record's block."""
    sealed = played.truth.sealed_at_ms
    errors = [record.at_ms - sealed[record.record_id] for visit in visits for record in visit.records]
    return round(statistics.median(errors) / 1000, 3) if errors else 0.0


def attack_one_frame(played: Played, visits: Sequence[VisitSeen]) -> Rate:
    """Match one companion's record with the other's same moment, by nearest time."""
    owners = {visit.owner: visit for visit in visits}
    places = {(s.robot, s.day, s.round, s.person): s.number for s in played.population.stays if not s.is_long}
    sealed = played.truth.sealed_at_ms
    hits, guesses = 0.0, list[float]()
    for (*place, person), number in places.items():
        friend = places.get((*place, played.population.companions.get(person, -1)))  # type: ignore[arg-type]
        pair = [[owners[o] for o in played.truth.owners_of(n) if o in owners] for n in (number, friend or -1)]
        if not all(pair):
            continue
        theirs = pair[1][0].records
        for record in pair[0][0].records:
            at_ms = sealed[record.record_id]
            true = min(theirs, key=lambda other: abs(sealed[other.record_id] - at_ms))
            if abs(sealed[true.record_id] - at_ms) > ONE_FRAME_MS:
                continue
            chosen = min(
                theirs, key=lambda other: (abs(other.height - record.height), abs(other.position - record.position))
            )
            hits += chosen is true
            guesses.append(1 / len(theirs))
    return count_rate(round(hits), len(guesses), statistics.fmean(guesses) if guesses else 0.0)


def attack_robot_memory(played: Played, visits: Sequence[VisitSeen]) -> Rate:
    """Name a running stolen robot's finished visits of the day by its memory."""
    stolen = {robot.unit.member for robot in played.stolen}
    last = played.population.days - 1
    over = [visit for visit in visits if visit.robot in stolen and day_of(visit.at_ms) == last]
    handles = {holder.handle: number for number, holder in played.holders.items()}
    named = {
        visit.chain.owner: handles[robot.people[alias].handle]
        for robot in played.stolen
        for alias, visit in robot.visits._open.items()  # a thief asks for nobody's leave
        if alias in robot.people
    }
    hits = sum(named.get(visit.owner) == played.person_of(visit.owner) for visit in over)
    return count_rate(hits, len(over), 1 / max(1, len(played.holders)))

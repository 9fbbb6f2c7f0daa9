"""The accepted limits as figures: named leaks of our design."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np

from consensus.records.padding import pad
from network.lab.privacy.attacks import linking, open_limits
from network.lab.privacy.attacks.evidence import Evidence
from network.lab.privacy.attacks.insiders import (
    name_waiting,
    open_frames,
    open_stolen_roster,
    open_stolen_spool,
    read_database,
    read_erase_keys,
    search_roster,
)
from network.lab.privacy.attacks.ledger_view import read_ledger
from network.lab.privacy.attacks.membership import attack_presence
from network.lab.privacy.attacks.trials import Features, Trial, attack_pairs, pairs_of
from network.lab.privacy.hospital.attacked_custodian import CustodyStory
from network.lab.privacy.hospital.attacked_days import MANNERS, play, working_folder
from network.lab.privacy.hospital.population import BUILD_SPREAD, FRAME_SPREAD, RENDITION_MEDIAN_BYTES, draw_population
from network.lab.privacy.scoring import Rate, count_rate

AT_ONCE_PEOPLE_MAX_COUNT, AT_ONCE_DAYS_COUNT = 40, 2
_FRAMES_FIXED_COUNT = 10

Limits = dict[str, Rate | float]


def limits_of(evidence: Evidence, custody: CustodyStory, pool: Executor, progress: Callable[[str], None]) -> Limits:
    progress("measuring the accepted limits")
    played, visits, seed = evidence.played, evidence.visits, evidence.seed
    enrolled = min(AT_ONCE_PEOPLE_MAX_COUNT, len(played.holders))

    def learned(trials: tuple[Trial, ...], features: Features) -> Future[Rate]:
        return pool.submit(attack_pairs, pairs_of(trials, features), seed=seed, boosting=evidence.boosting)

    limits: dict[str, Rate | float | Future[Rate]] = {
        "ward": learned(evidence.free, linking.by_robot(visits)),
        "hour": learned(evidence.free, linking.by_time(visits)),
        "visit_length": learned(evidence.matched, linking.by_length(visits)),
        "size_at_fixed_distance": learned(evidence.matched, linking.by_size(_fixed_sizes(evidence))),
        "company": learned(evidence.matched, linking.by_company(visits)),
        "within_visit": count_rate(len(visits), len(visits), 0.5),
        "came_together": open_limits.attack_copresence(played, visits, seed=seed),
        "one_frame": open_limits.attack_one_frame(played, visits),
        "one_frame_now": pool.submit(attack_one_frame_at_once, seed, enrolled),
        "long_stay": open_limits.attack_rolled_visits(played, visits),
        "consent_word": open_limits.attack_consent_words(played, evidence.view),
        "consent_word_by_closing": open_limits.attack_consent_words(played, evidence.view, by_closing_alone=True),
        "present_with_words": attack_presence(played, evidence.view, None, seed=seed, speaking=True),
        "registration_time": open_limits.attack_registration_times(played, evidence.view, seed=seed),
        "node_by_address": open_limits.attack_addresses(played, seed=seed),
        "node_by_time": open_limits.attack_session_times(played, seed=seed),
        "robot_memory": open_limits.attack_robot_memory(played, visits),
    }
    progress("searching the stolen robot's roster")
    for manner in MANNERS:
        limits[f"asked_for_{manner}"] = open_limits.attack_request_bursts(played, evidence.view, manner, seed=seed)
    limits |= _robot_limits(evidence)
    limits |= _wallet_limits(evidence, custody)
    limits["record_time_error_s"] = open_limits.measure_time_error_s(played, visits)
    return {name: found.result() if isinstance(found, Future) else found for name, found in limits.items()}


def limit_figures(limits: Limits) -> dict[str, float | None]:
    figures: dict[str, float | None] = {}
    for name, found in limits.items():
        figures |= found.figures(f"limit_{name}") if isinstance(found, Rate) else {f"limit_{name}": found}
    return figures


def attack_one_frame_at_once(seed: int, people: int) -> Rate:
    """Play days of their own, on which robots send at once."""
    population = draw_population(seed, people=people, days=AT_ONCE_DAYS_COUNT, serial_bits=20)
    with tempfile.TemporaryDirectory(prefix="blockrobot-attack-", dir=working_folder()) as folder:
        played = play(population, Path(folder), seed=seed, at_once=True)
    visits = [visit for visit in read_ledger(played.chain.blocks).visits.values() if visit.records]
    return open_limits.attack_one_frame(played, visits)


def _fixed_sizes(evidence: Evidence) -> list[list[int]]:
    rng = np.random.default_rng([evidence.seed, 0xF12ED])
    builds = {number: float(rng.lognormal(0, BUILD_SPREAD)) for number in evidence.played.holders}
    found = []
    for label in evidence.labels:
        scale = RENDITION_MEDIAN_BYTES * builds[label.person]
        drawn = (int(scale * rng.lognormal(0, FRAME_SPREAD)) for _ in range(_FRAMES_FIXED_COUNT))
        found.append([len(pad(bytes(size))) for size in drawn])
    return found


def _robot_limits(evidence: Evidence) -> Limits:
    played = evidence.played
    uids = {holder.handle: holder.person.uid for holder in played.holders.values()}
    people = {holder.handle: number for number, holder in played.holders.items()}
    first = open_stolen_roster(played.stolen[0].unit)
    found = search_roster(first, played.population.serial_bits)
    right = sum(uids[handle] == uid for handle, uid in found.items())
    hits = waiting = 0
    for robot in played.stolen:
        clips = open_stolen_spool(robot.unit)
        named = name_waiting(clips, robot.unit, open_stolen_roster(robot.unit))
        owners = {clip.upload.record_id: clip.owner for clip in clips}
        hits += sum(people[handle] == played.person_of(owners[record_id]) for record_id, handle in named.items())
        waiting += len(clips)
    return {
        "robot_roster_uids": count_rate(right, len(first.rows), 2.0**-played.population.serial_bits),
        "robot_waiting_clips_named": count_rate(hits, waiting, 1 / max(1, len(first.rows))),
    }


def _wallet_limits(evidence: Evidence, custody: CustodyStory) -> Limits:
    erased = set(custody.erased_ids)
    gone = [frame for frame in read_database(custody.before.database) if frame.record_id in erased]
    wallets = [holder.keys.sealing for holder in evidence.played.holders.values()]
    keys = read_erase_keys(custody.before.erase_keys)
    opened = open_frames(gone, keys, wallets)
    return {"old_backup_with_old_keys_and_wallet": count_rate(opened.pictures, opened.frames, 0.0)}

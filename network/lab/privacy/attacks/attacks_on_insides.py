"""Insider attacks beyond the design's limits: curious custodian, stolen backup, stolen robot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from consensus.records.envelopes import open_data_key, open_frame
from consensus.state.access import GRANT
from network.lab.privacy.attacks.evidence import Evidence
from network.lab.privacy.attacks.grants import link_grants, name_grantees, read_grants
from network.lab.privacy.attacks.insiders import (
    Opened,
    StoredFrame,
    find_bytes,
    name_visits_by_robot_keys,
    open_all_metadata,
    open_frames,
    open_stolen_roster,
    open_stolen_spool,
    open_waiting,
    read_database,
    read_erase_keys,
)
from network.lab.privacy.hospital.attacked_custodian import CustodyStory
from network.lab.privacy.hospital.schemes import (
    OURS,
    PAPER_SCHEMES,
    PROTOTYPE,
    make_schemes,
    open_plain_store,
    write_plain_store,
)
from network.lab.privacy.scoring import Rate, Rates, count_rate
from node.custody.erase_keys import unwrap_key

METADATA_VISITS_COUNT = 100


def attack_insides(
    evidence: Evidence, custody: CustodyStory, folder: Path, progress: Callable[[str], None]
) -> tuple[Rates, dict[str, int]]:
    progress("opening what a custodian, a backup and a stolen robot hold")
    played = evidence.played
    own = [played.chain.custodian.secret]
    before, after = read_database(custody.before.database), read_database(custody.after.database)
    keys_before, keys_after = read_erase_keys(custody.before.erase_keys), read_erase_keys(custody.after.erase_keys)
    erased = set(custody.erased_ids)
    gone = [frame for frame in before if frame.record_id in erased]
    wallets = [holder.keys.sealing for holder in _owners(evidence, gone)]
    attempts = {
        "custodian_opens": open_frames(before, keys_before, own),
        "backup_opens": open_frames(before, {}, own),
        "backup_with_keys_opens": open_frames(before, keys_before, own),
        "backup_of_erased_with_keys_and_wallet_opens": open_frames(gone, keys_after, wallets),
    }
    plain = _open_plain(evidence, before, keys_before, folder)
    rates = {name: _rates(found, plain) for name, found in attempts.items()}
    rates["grant_names"] = {OURS: _attack_grants(evidence, custody)}
    left = sum(frame.record_id in erased for frame in after)
    found_bytes = find_bytes(custody.after.database, [frame.ciphertext[:64] for frame in gone])
    rates["erased_bytes_left"] = {OURS: count_rate(max(left, found_bytes), len(gone), 0.0)}
    sampled = evidence.visits[:METADATA_VISITS_COUNT]
    records = sum(len(visit.records) for visit in sampled)
    rates["metadata_opens"] = {OURS: count_rate(open_all_metadata(sampled, own), records, 0.0)}
    rates |= _attack_robot(evidence)
    counts = {
        "custody_frames": len(before),
        "custody_frames_erased": len(gone),
        "custody_sealed_keys_with_erase_keys": attempts["custodian_opens"].sealed_keys,
        "custody_sealed_keys_without_erase_keys": attempts["backup_opens"].sealed_keys,
    }
    return rates, counts


def _rates(ours: Opened, plain: Rate) -> dict[str, Rate]:
    return dict.fromkeys(PAPER_SCHEMES, plain) | {OURS: count_rate(ours.pictures, ours.frames, 0.0)}


def _open_plain(evidence: Evidence, frames: list[StoredFrame], keys: dict[int, bytes], folder: Path) -> Rate:
    scheme, pictures = make_schemes()[PROTOTYPE], []
    people = {record.record_id: visit.owner for visit in evidence.visits for record in visit.records}
    for frame in frames:
        holder = evidence.played.holders[evidence.played.person_of(people[frame.record_id])]
        sealed = unwrap_key(keys[frame.slot], frame.record_id, frame.index, frame.wrapped_key)
        data_key = open_data_key(holder.keys.sealing, sealed)
        picture = open_frame(data_key, frame.record_id, frame.index, frame.ciphertext)
        pictures.append((scheme.mark(holder.person.uid).digest, picture))
    write_plain_store(folder / "plain", pictures)
    rows, shown = open_plain_store(folder / "plain")
    return count_rate(shown, rows, 0.0)


def _owners(evidence: Evidence, frames: list[StoredFrame]) -> list[Any]:
    people = {record.record_id: visit.owner for visit in evidence.visits for record in visit.records}
    numbers = {evidence.played.person_of(people[frame.record_id]) for frame in frames}
    return [evidence.played.holders[number] for number in sorted(numbers)]


def _attack_grants(evidence: Evidence, custody: CustodyStory) -> Rate:
    played = evidence.played
    numbers = sorted(played.holders)
    people = [played.holders[number].public_keys for number in numbers]
    handles = [played.holders[number].handle for number in numbers]
    grants = read_grants(dict(played.chain.state.scan(GRANT.flat, len(custody.grantees) + 1)))
    named = name_grantees(grants, people, handles, played.chain.chain_id)
    right = {grant_id for grant_id, place in named.items() if custody.grantees[grant_id] == numbers[place]}
    right.update(grant_id for pair in link_grants(grants) for grant_id in pair)
    return count_rate(len(right), len(grants), 1 / max(1, len(people)))


def _attack_robot(evidence: Evidence) -> Rates:
    played = evidence.played
    handles = {holder.handle: number for number, holder in played.holders.items()}
    frames = opened = visits = right = 0
    for unit in (robot.unit for robot in played.stolen):
        clips, roster = open_stolen_spool(unit), open_stolen_roster(unit)
        frames += sum(len(clip.upload.ciphertexts) for clip in clips)
        opened += open_waiting(clips, unit)
        past = [visit for visit in evidence.visits if visit.robot == unit.member]
        named = name_visits_by_robot_keys(past, roster.rows, unit, played.chain.chain_id)
        visits += len(past)
        right += sum(handles[handle] == played.person_of(owner) for owner, handle in named.items())
    return {
        "robot_spool_opens": {OURS: count_rate(opened, frames, 0.0)},
        "robot_names_past": {OURS: count_rate(right, visits, 1 / max(1, len(handles)))},
    }

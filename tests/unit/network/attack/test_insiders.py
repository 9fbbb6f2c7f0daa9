"""What thieves and insiders open: nothing where the design says so, everything where they have the keys."""

from __future__ import annotations

import dataclasses

import pytest

from consensus.primitives.encoding import u64
from consensus.primitives.hashing import sha256
from consensus.records.owner_keys import open_visit_keys
from network.lab.privacy.attacks.attacks_on_insides import attack_insides
from network.lab.privacy.attacks.insiders import (
    StoredFrame,
    find_bytes,
    name_visits_by_robot_keys,
    name_waiting,
    open_all_metadata,
    open_frames,
    open_stolen_roster,
    open_stolen_spool,
    open_waiting,
    read_database,
    read_erase_keys,
    search_roster,
)
from network.lab.privacy.attacks.naming import name_visits
from network.lab.privacy.hospital.schemes import open_plain_store
from tests.unit.network.attack.conftest import SERIAL_BITS, SmallHospital


@pytest.fixture
def frames(hospital: SmallHospital) -> list[StoredFrame]:
    return read_database(hospital.custody.before.database)


@pytest.fixture
def gone(hospital: SmallHospital, frames: list[StoredFrame]) -> list[StoredFrame]:
    return [frame for frame in frames if frame.record_id in hospital.custody.erased_ids]


def wallets(hospital: SmallHospital) -> list[bytes]:
    return [holder.keys.sealing for holder in hospital.played.holders.values()]


def test_a_database_and_its_erase_keys_open_nothing_without_the_wallets(
    hospital: SmallHospital, frames: list[StoredFrame]
) -> None:
    assert len(frames) > 20
    opened = open_frames(frames, {}, wallets(hospital))
    assert (opened.frames, opened.sealed_keys, opened.pictures) == (len(frames), 0, 0)
    opened = open_frames(frames, read_erase_keys(hospital.custody.before.erase_keys))
    assert (opened.sealed_keys, opened.pictures) == (len(frames), 0)
    # The attack is sound: with all three, it wins.
    opened = open_frames(frames, read_erase_keys(hospital.custody.before.erase_keys), wallets(hospital))
    assert opened.pictures == len(frames)


def test_what_was_erased_opens_to_nobody_and_no_byte_of_it_is_in_the_files(
    hospital: SmallHospital, gone: list[StoredFrame]
) -> None:
    """Not with an old backup of the database, the erase keys of now, and every wallet."""
    assert gone
    keys = read_erase_keys(hospital.custody.after.erase_keys)
    assert open_frames(gone, keys, wallets(hospital)).pictures == 0
    old = read_erase_keys(hospital.custody.before.erase_keys)
    assert open_frames(gone, old, wallets(hospital)).pictures == len(gone)
    needles = [frame.ciphertext[:64] for frame in gone]
    assert find_bytes(hospital.custody.before.database, needles) == len(gone)
    assert find_bytes(hospital.custody.after.database, needles) == 0


def test_metadata_opens_to_its_owner_alone(hospital: SmallHospital) -> None:
    visits = hospital.evidence.visits
    records = sum(len(visit.records) for visit in visits)
    assert open_all_metadata(visits, [hospital.played.chain.custodian.secret]) == 0
    assert open_all_metadata(visits, wallets(hospital)) == records


def test_a_stolen_robot_gives_its_roster_and_no_picture(hospital: SmallHospital) -> None:
    unit = hospital.played.stolen[0].unit
    roster, clips = open_stolen_roster(unit), open_stolen_spool(unit)
    assert len(roster.rows) == len(hospital.played.holders)
    assert clips
    assert open_waiting(clips, unit) == 0
    uids = {holder.handle: holder.person.uid for holder in hospital.played.holders.values()}
    assert search_roster(roster, SERIAL_BITS) == uids
    assert set(name_waiting(clips, unit, roster)) == {clip.upload.record_id for clip in clips}


def test_a_robot_that_drew_from_its_key_would_give_past_visits_away(hospital: SmallHospital) -> None:
    played, unit = hospital.played, hospital.played.stolen[0].unit
    roster, chain_id = open_stolen_roster(unit), hospital.played.chain.chain_id
    past = list(hospital.evidence.visits)
    assert name_visits_by_robot_keys(past, roster.rows, unit, chain_id) == {}
    row = roster.rows[0]
    careless = open_visit_keys(unit.identity.spend.secret, row.view, row.spend, chain_id=chain_id, robot=unit.member)
    past.append(dataclasses.replace(past[0], owner=careless.owner))
    assert name_visits_by_robot_keys(past, roster.rows, unit, chain_id) == {careless.owner: row.handle}
    assert played.truth.stay_of_owner.get(careless.owner) is None


def test_secrets_made_of_public_things_are_guessed(hospital: SmallHospital) -> None:
    played, visit = hospital.played, hospital.evidence.visits[0]
    people = [
        (holder.keys.identity.public_key, holder.keys.spend.public_key, holder.keys.view.public_key)
        for holder in played.holders.values()
    ]
    chain_id = played.chain.chain_id
    assert name_visits(hospital.evidence.visits[:4], people, chain_id) == {}
    secret = sha256(visit.robot + u64(visit.bucket_ms))
    careless = open_visit_keys(secret, people[3][2], people[3][1], chain_id=chain_id, robot=visit.robot)
    planted = dataclasses.replace(visit, owner=careless.owner, ephemeral=careless.ephemeral)
    assert name_visits([planted], people, chain_id) == {careless.owner: 3}


def test_the_prototypes_store_shows_every_picture(hospital: SmallHospital) -> None:
    rates, counts = attack_insides(hospital.evidence, hospital.custody, hospital.folder / "insides", lambda _: None)
    for name in ("custodian_opens", "backup_opens", "backup_with_keys_opens"):
        assert rates[name]["prototype"].success == 1.0
        assert rates[name]["ours"].success == 0.0
    rows, shown = open_plain_store(hospital.folder / "insides" / "plain")
    assert rows == shown == counts["custody_frames"]
    assert 0 < counts["custody_frames_erased"] < counts["custody_frames"]
    assert all(found["ours"].success == 0.0 for found in rates.values())

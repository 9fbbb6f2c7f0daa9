"""What insiders and thieves can open: custodian, stolen backup, stolen robot."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

from clients.robot.consent.consent_view import compute_person_tag
from clients.robot.identity.sealed_file import read_sealed
from clients.robot.recording.spool import SpooledClip
from consensus.errors import BlockRobotError
from consensus.members.roster import Roster, RosterRow, SignedRoster, roster_tag
from consensus.primitives.encoding import decode
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import open_data_key, open_frame, open_metadata, open_sealed
from consensus.records.owner_keys import open_visit_keys
from network.lab.privacy.attacks.dictionary import enumerate_uids
from network.lab.privacy.attacks.ledger_view import VisitSeen
from network.lab.privacy.hospital.household import Unit
from node.custody.erase_keys import EraseKeys, unwrap_key
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME

_GUESSED_KEYS = (bytes(32), b"\x01" * 32)


@dataclass(frozen=True, slots=True)
class StoredFrame:
    """One row of a stolen database."""

    record_id: bytes
    index: int
    slot: int
    wrapped_key: bytes
    ciphertext: bytes


@dataclass(frozen=True, slots=True)
class Opened:
    """Number of frames, with opened data keys and opened pictures."""

    frames: int
    sealed_keys: int
    pictures: int


def read_database(folder: Path) -> list[StoredFrame]:
    with closing(sqlite3.connect(folder / DATABASE_FILE_NAME)) as database:
        rows = database.execute("SELECT record_id, place, slot, wrapped_key, ciphertext FROM frames").fetchall()
    return [StoredFrame(*row) for row in rows]


def read_erase_keys(folder: Path) -> dict[int, bytes]:
    with EraseKeys(folder) as keys:
        found = ((slot, keys.read(slot)) for slot in range(keys.held_count + 4096))
        return {slot: key for slot, key in found if key is not None}


def find_bytes(folder: Path, needles: Iterable[bytes]) -> int:
    """Free pages and logs included."""
    content = b"".join(path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file())
    return sum(needle in content for needle in needles)


def open_frames(
    frames: Sequence[StoredFrame], erase_keys: dict[int, bytes], sealing_secrets: Sequence[bytes] = ()
) -> Opened:
    sealed_keys = pictures = 0
    for frame in frames:
        keys = [erase_keys[frame.slot]] if frame.slot in erase_keys else []
        sealed = next(
            _opened(unwrap_key, [*keys, *_GUESSED_KEYS], frame.record_id, frame.index, frame.wrapped_key), None
        )
        sealed_keys += sealed is not None
        data_keys = [*_GUESSED_KEYS, *keys]
        if sealed is not None:
            data_keys += _opened(open_data_key, sealing_secrets, sealed)
        pictures += any(True for _ in _opened(open_frame, data_keys, frame.record_id, frame.index, frame.ciphertext))
    return Opened(len(frames), sealed_keys, pictures)


def _opened(opens: Callable[..., bytes], keys: Iterable[bytes], *sealed: bytes | int) -> Iterator[bytes]:
    for key in keys:
        with suppress(BlockRobotError):
            yield opens(key, *sealed)


def open_all_metadata(visits: Iterable[VisitSeen], sealing_secrets: Sequence[bytes]) -> int:
    sealed = [record.sealed_metadata for visit in visits for record in visit.records]
    return sum(any(True for _ in _opened(open_metadata, sealing_secrets, one)) for one in sealed)


def open_stolen_roster(unit: Unit) -> Roster:
    signed = decode(open_sealed(unit.identity.sealing, (unit.folder / "roster").read_bytes()), SignedRoster)
    return decode(signed.roster, Roster)


def search_roster(roster: Roster, serial_bits: int) -> dict[bytes, str]:
    rows = {row.tag: row.handle for row in roster.rows}
    found: dict[bytes, str] = {}
    for uids in enumerate_uids(serial_bits):
        for uid in uids:
            handle = rows.get(roster_tag(roster.key, uid.decode()))
            if handle is not None:
                found[handle] = uid.decode()
        if len(found) == len(rows):
            break
    return found


def open_stolen_spool(unit: Unit) -> list[SpooledClip]:
    paths = sorted((unit.folder / "spool").glob("*.clip"))
    return [decode(read_sealed(path, unit.identity.spool), SpooledClip) for path in paths]


def name_waiting(clips: Sequence[SpooledClip], unit: Unit, roster: Roster) -> dict[bytes, bytes]:
    handles = {compute_person_tag(unit.identity.spool, row.handle): row.handle for row in roster.rows}
    return {clip.upload.record_id: handles[clip.person] for clip in clips if clip.person in handles}


def open_waiting(clips: Sequence[SpooledClip], unit: Unit) -> int:
    identity = unit.identity
    secrets = [identity.sealing, identity.spool, *(key.secret for key in _scalars(unit))]
    opened = 0
    for clip in clips:
        upload = clip.upload
        for index, (text, sealed) in enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True)):
            keys = [*secrets, *_opened(open_data_key, secrets, sealed)]
            opened += any(True for _ in _opened(open_frame, keys, upload.record_id, index, text))
    return opened


def name_visits_by_robot_keys(
    visits: Sequence[VisitSeen], rows: Sequence[RosterRow], unit: Unit, chain_id: bytes
) -> dict[bytes, bytes]:
    announced = {visit.owner for visit in visits}
    named: dict[bytes, bytes] = {}
    for row in rows:
        for scalar in _scalars(unit):
            keys = open_visit_keys(scalar.secret, row.view, row.spend, chain_id=chain_id, robot=unit.member)
            if keys.owner in announced:
                named[keys.owner] = row.handle
    return named


def _scalars(unit: Unit) -> list[PrivateKey]:
    identity = unit.identity
    return [identity.identity, identity.spend, identity.view]

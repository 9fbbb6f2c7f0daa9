"""Rows of the state for members, visits and records, in key order and as contracts write them."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from typing import Any

from nacl.public import PrivateKey as SealingKey

from clients.wallet.store.member_keys import WalletKeys
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES
from consensus.members.roster import RosterRow
from consensus.primitives.encoding import encode, encode_value, u64
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import seal_metadata
from consensus.records.metadata import RecordMetadata
from consensus.records.owner_keys import open_visit_keys
from consensus.state import audit, consent, identity
from consensus.state.consent import StepRow
from consensus.state.identity import MemberRow
from consensus.state.keys import to_value
from consensus.state.records import (
    ANNOUNCEMENT,
    ANNOUNCEMENT_COUNT,
    RECORD,
    VISIT,
    AnnouncementRow,
    RecordRow,
    VisitRow,
)
from network.sim.world.sim_chain import EPOCH_MS

Row = tuple[bytes, bytes]

ROBOT = PrivateKey(sha256(b"robot of the growth"))
ORGANISATION = "hospital"
PURPOSE = "care"
_PUBLIC = PrivateKey(sha256(b"somebody of the growth")).public_key
_SEALING = bytes(SealingKey(sha256(b"sealing of the growth")).public_key)
_KEY_TAIL = bytes(24)


def _row(key: bytes, row: Any) -> Row:
    return key, encode_value(to_value(row))


def _record(owner: bytes, sealed: bytes = bytes(SEALED_METADATA_BYTES)) -> RecordRow:
    return RecordRow(
        owner=owner,
        robot=ROBOT.public_key,
        commitment_root=sha256(owner),
        ciphertext_root=sha256(owner),
        sealed_metadata=sealed,
        bucket_ms=EPOCH_MS,
        expires_at_ms=EPOCH_MS + RETENTION_DEFAULT_MS,
        height=1,
        txid=sha256(owner),
        status="active",
        erased_frames=[],
        awaited=[],
    )


def record_key(number: int) -> bytes:
    return RECORD.key(u64(number) + bytes(8))


def record_rows(count: int) -> Iterator[Row]:
    for number in range(count):
        yield _row(record_key(number), _record(b"\x02" + u64(number) + _KEY_TAIL))


def _member(handle: bytes, role: str) -> MemberRow:
    keys = {"spend": _PUBLIC, "view": _PUBLIC, "sealing": _SEALING}
    return MemberRow(handle=handle, role=role, org=ORGANISATION, status="active", since=EPOCH_MS, **keys)


def member_key(number: int) -> bytes:
    return b"\x02" + u64(number) + _KEY_TAIL


def handle_of(number: int) -> bytes:
    return u64(number) + _KEY_TAIL


def roster_row(number: int) -> RosterRow:
    handle = handle_of(number)
    return RosterRow(tag=sha256(handle), handle=handle, spend=_PUBLIC, view=_PUBLIC, sealing=_SEALING, proof=b"")


def member_rows(count: int) -> Iterator[Row]:
    """With a consent each; the robot is one more."""
    step = StepRow(height=1, status="given", since_ms=EPOCH_MS, from_ms=0, until_ms=0, mandate=b"")
    choices = encode_value({PURPOSE: {"depth": [to_value(step)], "rgb": [to_value(step)]}})
    for number in range(count):
        yield consent.CHOICES.key(handle_of(number)), choices
    for number in range(count):
        yield identity.HANDLE.key(handle_of(number)), encode_value(member_key(number))
    members = [member_key(number) for number in range(count)]
    robot = ROBOT.public_key
    for key in sorted([*members, robot]):
        handle, role = (sha256(robot), "robot") if key == robot else (key[1:], "subject")
        yield _row(identity.MEMBER.key(key), _member(handle, role))


def person_rows(keys: WalletKeys, visits: int, chain_id: bytes) -> Iterator[Row]:
    """One person's visits, with one closed record each."""
    rows = [_row(identity.MEMBER.key(ROBOT.public_key), _member(sha256(ROBOT.public_key), "robot"))]
    person = MemberRow(
        handle=sha256(keys.identity.public_key),
        role="subject",
        org=ORGANISATION,
        spend=keys.spend.public_key,
        view=keys.view.public_key,
        sealing=keys.sealing_public,
        status="active",
        since=EPOCH_MS,
    )
    rows.append(_row(identity.MEMBER.key(keys.identity.public_key), person))
    rows.append((ANNOUNCEMENT_COUNT.flat, encode_value(visits)))
    for number in range(visits):
        rows += _visit_rows(keys, number, chain_id)
    return iter(sorted(rows))


def _visit_rows(keys: WalletKeys, number: int, chain_id: bytes) -> Iterator[Row]:
    robot = ROBOT.public_key
    visit = open_visit_keys(
        secrets.token_bytes(32), keys.view.public_key, keys.spend.public_key, chain_id=chain_id, robot=robot
    )
    owner, record_id = visit.owner, secrets.token_bytes(16)
    at_ms = EPOCH_MS + number
    metadata = RecordMetadata(
        sensor="depth",
        started_at_ms=at_ms,
        ended_at_ms=at_ms + 1,
        frame_count=1,
        index_in_visit=0,
        previous_hash=bytes(32),
        withheld=(),
        width=640,
        height=480,
    )
    row = VisitRow(
        robot=robot,
        ephemeral=visit.ephemeral,
        view_tag=visit.view_tag,
        bucket_ms=EPOCH_MS,
        purpose=PURPOSE,
        status="closed",
        record_count=1,
        height=1,
        sequence=number,
    )
    announced = AnnouncementRow(
        owner=owner, ephemeral=visit.ephemeral, view_tag=visit.view_tag, bucket_ms=EPOCH_MS, robot=robot
    )
    yield _row(VISIT.key(owner), row)
    yield _row(ANNOUNCEMENT.key(number), announced)
    yield _row(RECORD.key(record_id), _record(owner, seal_metadata(keys.sealing_public, encode(metadata))))
    words = (("recorded", record_id), ("visit_closed", b""))
    for index, (kind, named) in enumerate(words):
        entry = audit.EntryRow(record_id=named, kind=kind, time=at_ms, height=1, data={})
        yield _row(audit.ENTRY.key(owner, index), entry)
    yield audit.COUNT.key(owner), encode_value(len(words))

"""A visit from proved state: no key missing or extra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from clients.bundle.checks.chain_proofs import ProvedValue
from clients.bundle.documents import RecordOpening, read_bytes
from clients.bundle.layout import RECORD_OPENINGS
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.records.envelopes import open_disclosed_metadata
from consensus.records.metadata import RecordMetadata
from consensus.state import access, erasure
from consensus.state.access import VERDICT, AccessRow, VerdictRow
from consensus.state.audit import COUNT, ENTRY, EntryRow
from consensus.state.erasure import ErasureRow
from consensus.state.keys import Prefix
from consensus.state.records import CURRENT, RECORD, VISIT, RecordRow, VisitRow, deciding_key
from consensus.state.rights import (
    CORRECTION,
    CORRECTION_COUNT,
    OBJECTION,
    QUARANTINE,
    RESTRICTION,
    CorrectionRow,
    RestrictionRow,
    correction_keys,
)

RECORDED = "recorded"
TRANSFERRED = "transferred"
RECORDS_MAX_COUNT = 100_000

Proved = Mapping[bytes, ProvedValue]
T = TypeVar("T")
R = TypeVar("R", AccessRow, ErasureRow)


@dataclass(frozen=True, slots=True)
class RecordFacts:
    """One record: its state, and its metadata if opened."""

    record_id: bytes
    state: RecordRow
    verdict: VerdictRow | None
    opening: RecordOpening | None
    metadata: RecordMetadata | None
    metadata_proved: bool


@dataclass(frozen=True, slots=True)
class VisitFacts:
    """A proved visit; `entries` are (index, value)."""

    owner: bytes
    state: VisitRow
    trail_count: int
    entries: tuple[tuple[int, EntryRow], ...]
    records: tuple[RecordFacts, ...]
    accesses: dict[bytes, AccessRow]
    erasures: dict[bytes, ErasureRow]
    restriction: RestrictionRow | None
    objection: dict[str, int] | None
    quarantine: bytes | None
    corrections: tuple[CorrectionRow, ...]
    heights: tuple[int, int]
    decided_by: bytes
    """The key that decides of the visit, and signs: its first key, or the one that it was transferred to last."""

    @property
    def is_whole(self) -> bool:
        return len(self.entries) == self.trail_count


def trail_keys(owner: bytes) -> list[bytes]:
    """Return a visit's initial keys; rights may be proved absent."""
    kinds: tuple[Prefix[Any], ...] = (VISIT, CURRENT, COUNT, RESTRICTION, OBJECTION, QUARANTINE, CORRECTION_COUNT)
    return [kind.key(owner) for kind in kinds]


def keys_of_entry(entry: EntryRow) -> list[bytes]:
    keys: list[bytes] = []
    if entry.kind == RECORDED:
        keys += [RECORD.key(entry.record_id), VERDICT.key(entry.record_id)]
    for rows, name in ((access.REQUEST, "access_id"), (erasure.REQUEST, "erasure_id")):
        if isinstance(entry.data.get(name), bytes):
            keys.append(rows.key(entry.data[name]))
    return keys


def _unproven(detail: str) -> BlockRobotError:
    return BlockRobotError("BUNDLE_UNPROVEN", detail)


def _row(proved: Proved, rows: Prefix[T], *parts: bytes | int) -> T | None:
    value = proved[rows.key(*parts)].value
    return None if value is None else rows.convert(value)


def _present(proved: Proved, rows: Prefix[T], *parts: bytes | int) -> T:
    row = _row(proved, rows, *parts) if rows.key(*parts) in proved else None
    if row is None:
        raise _unproven(f"The bundle does not prove what stands on the ledger under {rows.name}.")
    return row


def _present_count(proved: Proved, rows: Prefix[int], owner: bytes) -> int:
    count = (_row(proved, rows, owner) or 0) if rows.key(owner) in proved else -1
    if not 0 <= count < 1 << 20:
        raise _unproven("The bundle does not prove how much there is of a visit.")
    return count


def _keys(proved: Proved, rows: Prefix[T]) -> list[tuple[bytes, ...]]:
    return [rows.split(key) for key in sorted(proved) if key.startswith(rows.flat)]


def read_visit(proved: Proved, openings: Mapping[bytes, RecordOpening], sealing: Sequence[bytes]) -> VisitFacts:
    """Without `sealing` keys metadata is unproved. Raises BUNDLE_UNPROVEN."""
    owners = _keys(proved, VISIT)
    if len(owners) != 1:
        raise _unproven("A document of proofs is about no visit, or about several.")
    ((owner,),) = owners
    state = _present(proved, VISIT, owner)
    indexes = [int.from_bytes(index, "big") for visit, index in _keys(proved, ENTRY) if visit == owner]
    trail = tuple((index, _present(proved, ENTRY, owner, index)) for index in indexes)
    expected = set(trail_keys(owner)) | {ENTRY.key(owner, index) for index in indexes}
    corrections = _present_count(proved, CORRECTION_COUNT, owner)
    expected.update(correction_keys(owner, corrections))
    for _, entry in trail:
        expected.update(keys_of_entry(entry))
    # Bundles that were made before visits could be transferred do not prove which key decides: see `_deciding_key`.
    if expected.symmetric_difference(proved) - {CURRENT.key(owner)}:
        raise _unproven("The proofs of a visit leave out what its trail leads to, or hold something else.")
    count = _present_count(proved, COUNT, owner)
    ids = [entry.record_id for _, entry in trail if entry.kind == RECORDED]
    records = [_read_record(proved, record_id, owner, openings.get(record_id), sealing) for record_id in ids]
    quarantine = _row(proved, QUARANTINE, owner)
    if quarantine is not None and any(record.opening for record in records):
        raise _unproven(
            "A visit is quarantined, since it may show somebody else, and yet the bundle opens records of it."
        )
    heights = [proof.height for proof in proved.values()]
    return VisitFacts(
        owner=owner,
        state=state,
        trail_count=count,
        entries=trail,
        records=tuple(sorted(records, key=_place)),
        accesses=_of_owner(proved, access.REQUEST, owner),
        erasures=_of_owner(proved, erasure.REQUEST, owner),
        restriction=_row(proved, RESTRICTION, owner),
        objection=_row(proved, OBJECTION, owner),
        quarantine=quarantine,
        corrections=tuple(_present(proved, CORRECTION, owner, number) for number in range(corrections)),
        heights=(min(heights), max(heights)),
        decided_by=_deciding_key(proved, owner, trail, count),
    )


def _deciding_key(proved: Proved, owner: bytes, trail: tuple[tuple[int, EntryRow], ...], trail_count: int) -> bytes:
    """Return the signing key; omitted or old proofs cannot revert it. Raises BUNDLE_UNPROVEN."""
    transfers = max((entry.data["transfers"] for _, entry in trail if entry.kind == TRANSFERRED), default=0)
    found = proved.get(CURRENT.key(owner))
    if found is None:
        if transfers or [index for index, _ in trail] != list(range(trail_count)):
            raise _unproven("The bundle does not prove which key decides of a visit that may have been transferred.")
        return owner
    current = _row(proved, CURRENT, owner)
    proved_transfers = 0 if current is None else current.transfers
    if proved_transfers < transfers or found.height < proved[COUNT.key(owner)].height:
        raise _unproven("What the bundle proves of the key that decides of a visit is older than the visit's trail.")
    return deciding_key(owner, current)


def _of_owner(proved: Proved, rows: Prefix[R], owner: bytes) -> dict[bytes, R]:
    found = {name: _present(proved, rows, name) for (name,) in _keys(proved, rows)}
    if any(row.owner != owner for row in found.values()):
        raise _unproven("The proofs of a visit hold a request of another's.")
    return found


def _place(record: RecordFacts) -> tuple[int, bytes]:
    place = RECORDS_MAX_COUNT if record.metadata is None else record.metadata.index_in_visit
    return place, record.record_id


def _opens(sealing: bytes, box_key: bytes, sealed: bytes, content: bytes) -> bool:
    try:
        return open_disclosed_metadata(sealing, box_key, sealed) == content
    except BlockRobotError:
        return False


def _read_record(
    proved: Proved, record_id: bytes, owner: bytes, opening: RecordOpening | None, sealing: Sequence[bytes]
) -> RecordFacts:
    state = _present(proved, RECORD, record_id)
    if state.owner != owner:
        raise _unproven("The trail of a visit names a record of another's.")
    verdict = _row(proved, VERDICT, record_id)
    if opening is None:
        return RecordFacts(record_id, state, verdict, None, None, metadata_proved=False)
    if state.status != "active":
        raise _unproven(f"Record {record_id.hex()} is {state.status}, and yet the bundle opens it.")
    content = read_bytes(RECORD_OPENINGS, opening.metadata)
    metadata = decode(content, RecordMetadata)
    if not 0 <= metadata.index_in_visit < RECORDS_MAX_COUNT:
        raise _unproven("A record has an impossible place in its visit.")
    box_key = read_bytes(RECORD_OPENINGS, opening.box_key)
    if box_key:
        if not sealing:
            raise _unproven("The bundle opens sealed metadata without saying whose it is.")
        if not any(_opens(key, box_key, state.sealed_metadata, content) for key in sealing):
            raise _unproven(f"The metadata of record {record_id.hex()} is not what the robot sealed.")
    return RecordFacts(record_id, state, verdict, opening, metadata, metadata_proved=bool(box_key))

"""What the proved state says of one visit, put together. Must never pass over a key that is proved, or one that is due.

Every key that is proved must be one that the visit's own trail leads to, and every key that it leads to must be there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clients.bundle.chain_proofs import ProvedValue
from clients.bundle.documents import RecordOpening, read_bytes
from clients.bundle.layout import RECORD_OPENINGS
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, u32
from consensus.records.disclosure import open_disclosed_metadata
from consensus.records.metadata import RecordMetadata

VISIT = b"records\x00visit/"
CURRENT = b"records\x00current/"
RECORD = b"records\x00record/"
COUNT = b"audit\x00count/"
ENTRY = b"audit\x00entry/"
ACCESS = b"access\x00access/"
VERDICT = b"access\x00verdict/"
ERASURE = b"erasure\x00erasure/"
RESTRICTION = b"rights\x00restriction/"
OBJECTION = b"rights\x00objection/"
QUARANTINE = b"rights\x00quarantine/"
CORRECTION_COUNT = b"rights\x00correction-count/"
CORRECTION = b"rights\x00correction/"
RECORDED = "recorded"
TRANSFERRED = "transferred"
RECORDS_MAX_COUNT = 100_000

Proved = Mapping[bytes, ProvedValue]


@dataclass(frozen=True, slots=True)
class RecordFacts:
    """One record: its state, and its metadata if it was opened."""

    record_id: bytes
    state: dict[str, Any]
    verdict: dict[str, Any] | None
    opening: RecordOpening | None
    metadata: RecordMetadata | None
    metadata_proved: bool


@dataclass(frozen=True, slots=True)
class VisitFacts:
    """One visit as the ledger proves it. `entries` are pairs of index and value; ids of accesses and erasures are keys."""

    owner: bytes
    state: dict[str, Any]
    trail_count: int
    entries: tuple[tuple[int, dict[str, Any]], ...]
    records: tuple[RecordFacts, ...]
    accesses: dict[bytes, dict[str, Any]]
    erasures: dict[bytes, dict[str, Any]]
    restriction: Any
    objection: Any
    quarantine: Any
    corrections: tuple[Any, ...]
    heights: tuple[int, int]
    decided_by: bytes
    """The key that decides of the visit, and signs: its first key, or the one that it was transferred to last."""

    @property
    def is_whole(self) -> bool:
        """Whether the whole trail is there, and with it every record."""
        return len(self.entries) == self.trail_count


def trail_keys(owner: bytes) -> list[bytes]:
    """Return the keys by which reading a visit begins; those of rights may be absent, and are proved to be."""
    return [kind + owner for kind in (VISIT, CURRENT, COUNT, RESTRICTION, OBJECTION, QUARANTINE, CORRECTION_COUNT)]


def correction_keys(owner: bytes, count: int) -> list[bytes]:
    """Return the keys of a visit's linked corrections."""
    return [CORRECTION + owner + u32(number) for number in range(count)]


def entry_key(owner: bytes, index: int) -> bytes:
    """Return the key of one entry of a visit's trail."""
    return ENTRY + owner + u32(index)


def keys_of_entry(entry: Mapping[str, Any]) -> list[bytes]:
    """Return the keys that an entry of the trail leads to."""
    keys: list[bytes] = []
    data = entry["data"]
    if entry["kind"] == RECORDED:
        keys += [RECORD + entry["record_id"], VERDICT + entry["record_id"]]
    if isinstance(data.get("access_id"), bytes):
        keys.append(ACCESS + data["access_id"])
    if isinstance(data.get("erasure_id"), bytes):
        keys.append(ERASURE + data["erasure_id"])
    return keys


def _unproven(detail: str) -> BlockRobotError:
    return BlockRobotError("BUNDLE_UNPROVEN", detail)


def _present(proved: Proved, key: bytes, what: str) -> Any:
    found = proved.get(key)
    if found is None or found.value is None:
        raise _unproven(f"The bundle does not prove {what}.")
    return found.value


def _present_count(proved: Proved, key: bytes) -> int:
    """Return a proved count, 0 where the key is proved absent. No visit has as many as would take long to count."""
    found = proved.get(key)
    count = 0 if found is None or found.value is None else found.value
    if found is None or not isinstance(count, int) or not 0 <= count < 1 << 20:
        raise _unproven("The bundle does not prove how much there is of a visit.")
    return count


def _values(proved: Proved, prefix: bytes) -> dict[bytes, Any]:
    return {key[len(prefix) :]: proof.value for key, proof in proved.items() if key.startswith(prefix)}


def read_visit(proved: Proved, openings: Mapping[bytes, RecordOpening], sealing: Sequence[bytes]) -> VisitFacts:
    """Return one visit from what is proved of it, with the records opened.

    `sealing` are the person's proved sealing keys, former ones too; none where the bundle does not say who she is:
    metadata is the exporter's word then. Raises BUNDLE_UNPROVEN for keys that are missing or lead nowhere, for metadata
    that is not what was sealed, and for a quarantined visit of which a record is opened.
    """
    owners = list(_values(proved, VISIT))
    if len(owners) != 1:
        raise _unproven("A document of proofs is about no visit, or about several.")
    owner = owners[0]
    state = _present(proved, VISIT + owner, "a visit")
    entries = [
        (int.from_bytes(key[len(ENTRY + owner) :], "big"), key) for key in proved if key.startswith(ENTRY + owner)
    ]
    trail = tuple((index, _present(proved, key, "an entry of the trail")) for index, key in sorted(entries))
    expected = set(trail_keys(owner)) | {entry_key(owner, index) for index, _ in trail}
    corrections = _present_count(proved, CORRECTION_COUNT + owner)
    expected.update(correction_keys(owner, corrections))
    for _, entry in trail:
        expected.update(keys_of_entry(entry))
    # Bundles that were made before visits could be transferred do not prove which key decides: see `_deciding_key`.
    if expected - {CURRENT + owner} != set(proved) - {CURRENT + owner}:
        raise _unproven("The proofs of a visit leave out what its trail leads to, or hold something else.")
    count = _present_count(proved, COUNT + owner)
    ids = [entry["record_id"] for _, entry in trail if entry["kind"] == RECORDED]
    records = [_read_record(proved, record_id, owner, openings.get(record_id), sealing) for record_id in ids]
    if proved[QUARANTINE + owner].value is not None and any(record.opening for record in records):
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
        accesses=_of_owner(_values(proved, ACCESS), owner),
        erasures=_of_owner(_values(proved, ERASURE), owner),
        restriction=proved[RESTRICTION + owner].value,
        objection=proved[OBJECTION + owner].value,
        quarantine=proved[QUARANTINE + owner].value,
        corrections=tuple(proved[key].value for key in correction_keys(owner, corrections)),
        heights=(min(heights), max(heights)),
        decided_by=_deciding_key(proved, owner, trail, count),
    )


def _deciding_key(
    proved: Proved, owner: bytes, trail: tuple[tuple[int, dict[str, Any]], ...], trail_count: int
) -> bytes:
    """Return the key that has to sign, which no proof that is left out, nor an older one, may turn back to a former key.

    Raises BUNDLE_UNPROVEN.
    """
    transfers = max((entry["data"]["transfers"] for _, entry in trail if entry["kind"] == TRANSFERRED), default=0)
    found = proved.get(CURRENT + owner)
    if found is None:
        if transfers or [index for index, _ in trail] != list(range(trail_count)):
            raise _unproven("The bundle does not prove which key decides of a visit that may have been transferred.")
        return owner
    current: dict[str, Any] = {"owner": owner, "transfers": 0} if found.value is None else found.value
    if current["transfers"] < transfers or found.height < proved[COUNT + owner].height:
        raise _unproven("What the bundle proves of the key that decides of a visit is older than the visit's trail.")
    return bytes(current["owner"])


def _of_owner(found: dict[bytes, Any], owner: bytes) -> dict[bytes, dict[str, Any]]:
    if any(value is None or value["owner"] != owner for value in found.values()):
        raise _unproven("The proofs of a visit hold a request of another's.")
    return found


def _place(record: RecordFacts) -> tuple[int, bytes]:
    """Records follow each other as the robot numbered them; those that nobody can open any more come last."""
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
    state = _present(proved, RECORD + record_id, "a record")
    if state["owner"] != owner:
        raise _unproven("The trail of a visit names a record of another's.")
    verdict = proved[VERDICT + record_id].value
    if opening is None:
        return RecordFacts(record_id, state, verdict, None, None, metadata_proved=False)
    if state["status"] != "active":
        raise _unproven(f"Record {record_id.hex()} is {state['status']}, and yet the bundle opens it.")
    content = read_bytes(RECORD_OPENINGS, opening.metadata)
    metadata = decode(content, RecordMetadata)
    if not 0 <= metadata.index_in_visit < RECORDS_MAX_COUNT:
        raise _unproven("A record has an impossible place in its visit.")
    box_key = read_bytes(RECORD_OPENINGS, opening.box_key)
    if box_key:
        if not sealing:
            raise _unproven("The bundle opens sealed metadata without saying whose it is.")
        if not any(_opens(key, box_key, state["sealed_metadata"], content) for key in sealing):
            raise _unproven(f"The metadata of record {record_id.hex()} is not what the robot sealed.")
    return RecordFacts(record_id, state, verdict, opening, metadata, metadata_proved=bool(box_key))

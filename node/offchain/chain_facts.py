"""What the finalized state says of records, access and erasures, as a custodian needs it. Must never look at blocks.

The state keeps all that blocks ever said of them but the heights of requests, and of words that no longer stand; those
are in the visits' audit entries.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

from msgspec import structs

from consensus.primitives.encoding import decode_value
from node.offchain.robots import is_frame_approved_for_any
from node.offchain.share_store import ShareRow, read_share
from node.offchain.standing import prolong, read_restriction, with_natural
from node.offchain.store import Checkpoint, RecordFacts, VisitStanding

RECORD_PREFIX = b"records\x00record/"
ACCESS_PREFIX = b"access\x00access/"
GRANT_PREFIX = b"access\x00grant/"
CUSTODIANS_KEY = b"identity\x00custodians"
RELEASE_PREFIX = b"access\x00release/"
ERASURE_PREFIX = b"erasure\x00erasure/"
AUDIT_PREFIX = b"audit\x00entry/"
RESTRICTION_PREFIX = b"rights\x00restriction/"
OBJECTION_PREFIX = b"rights\x00objection/"
QUARANTINE_PREFIX = b"rights\x00quarantine/"
OF_VISIT_PREFIX = b"records\x00of-visit/"
OWNER_BYTES = 33
ALL_ROWS_COUNT = 1 << 60
NARROWING_KINDS = frozenset({"restricted", "objected", "denied", "transferred"})
"""What the audit calls the words that make earlier requests void; the end of a quarantine is one too (`_narrows`)."""


class StateReader(Protocol):
    """The flat table of the finalized state."""

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs of flat key and encoded value under the prefix, in key order."""
        ...


@dataclass(frozen=True, slots=True)
class RecordState:
    """A record as the state has it: `status` is active, erasing, erased or expired; the roots of the last two are gone.

    `awaited` are the custodians whose report of its expiry an expired one waits for.
    """

    facts: RecordFacts
    status: str
    awaited: frozenset[bytes] = frozenset()

    def is_kept(self, at_ms: int) -> bool:
        """Tell whether its clip is to be kept at a block's time: not erased, not being erased, not expired."""
        return self.status == "active" and self.facts.expires_at_ms > at_ms


@dataclass(frozen=True, slots=True)
class AccessFacts:
    """A request for access: `height` is that of its block, `released` and `refused` tell who answered."""

    access_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    height: int
    refused: dict[bytes, str]
    share: bytes = b""
    released: frozenset[bytes] = frozenset()


@dataclass(frozen=True, slots=True)
class ErasureFacts:
    """A request for erasure: who has to confirm it, and who has."""

    erasure_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    frames: tuple[int, ...]
    height: int
    custodians: tuple[bytes, ...]
    receipts: frozenset[bytes]
    asked_at_ms: int = 0


@dataclass(frozen=True, slots=True)
class _Audited:
    """The height of each request by its id, and by owner that of the last word that made earlier ones void, and of the
    last denial.
    """

    requested: dict[bytes, int] = field(default_factory=dict)
    narrowed: dict[bytes, int] = field(default_factory=dict)
    denied: dict[bytes, int] = field(default_factory=dict)


class ChainFacts:
    """The state at one finalized block. The reader has to stay open while it is used."""

    def __init__(self, state: StateReader, point: Checkpoint) -> None:
        self._state = state
        self.point = point

    def _rows(self, prefix: bytes) -> Iterator[tuple[bytes, dict[str, Any]]]:
        return self._values(prefix)

    def active_records(self) -> Iterator[RecordFacts]:
        """Yield the records whose clips are to be kept, those being erased too: the erasure comes after."""
        for record in self.records():
            if record.status in {"active", "erasing"}:
                yield record.facts

    def records(self) -> Iterator[RecordState]:
        """Yield every record that the state has ever had, by its id."""
        for record_id, entry in self._rows(RECORD_PREFIX):
            yield self._record(record_id, entry)

    def unreported(self, member: bytes) -> list[bytes]:
        """Return the expired records that wait for a custodian's report, or for nobody who is a custodian still."""
        value = self._state.get(CUSTODIANS_KEY)
        custodians = frozenset(decode_value(value) if value is not None else ())
        if member not in custodians:
            return []
        expired = (record for record in self.records() if record.status == "expired")
        return [each.facts.record_id for each in expired if member in each.awaited or not each.awaited & custodians]

    def record(self, record_id: bytes) -> RecordState | None:
        """Return one record, or None if the state has none of this id."""
        value = self._state.get(RECORD_PREFIX + record_id)
        return None if value is None else self._record(record_id, decode_value(value))

    def _record(self, record_id: bytes, entry: dict[str, Any]) -> RecordState:
        """Return a record with the expiry that it has now: a restriction may keep it longer."""
        expires_at_ms = prolong(self._restrictions.get(entry["owner"]), record_id, entry["expires_at_ms"])
        return _record(record_id, entry | {"expires_at_ms": expires_at_ms})

    @cached_property
    def _restrictions(self) -> dict[bytes, VisitStanding]:
        return {owner: read_restriction(owner, row) for owner, row in self._rows(RESTRICTION_PREFIX)}

    def standings(self) -> Iterator[VisitStanding]:
        """Yield what stands of every visit of which something was ever said, also where it was taken back since.

        Requests are void up to the height of the last word that the audit has; where it has none, up to this state.
        """
        denied = {owner for owner, _ in self._values(QUARANTINE_PREFIX)}
        objected = {owner for owner, _ in self._values(OBJECTION_PREFIX)}
        narrowed = self._audited.narrowed
        for owner in sorted(denied | objected | set(self._restrictions) | set(narrowed)):
            told = self._restrictions.get(owner, VisitStanding(owner))
            height = narrowed.get(owner, self.point.height)
            standing = structs.replace(told, narrowed_height=height, quarantined=owner in denied)
            yield with_natural(standing, self._natural(told))

    def _natural(self, standing: VisitStanding) -> dict[bytes, int]:
        """Return when the records of a visit that are kept longer would expire, ms."""
        natural = {}
        for record_id, _ in self._values(OF_VISIT_PREFIX + standing.owner) if standing.until_ms else ():
            value = self._state.get(RECORD_PREFIX + record_id)
            own_ms: int = 0 if value is None else decode_value(value)["expires_at_ms"]
            if value is not None and prolong(standing, record_id, own_ms) != own_ms:
                natural[record_id] = own_ms
        return natural

    def _values(self, prefix: bytes) -> Iterator[tuple[bytes, Any]]:
        for key, value in self._state.scan(prefix, ALL_ROWS_COUNT):
            yield key[len(prefix) :], decode_value(value)

    def is_empty_frame_approved(self, digest: bytes) -> bool:
        """Tell whether an empty frame is approved for any robot."""
        return is_frame_approved_for_any(self._state, digest)

    def erased_frames(self) -> dict[bytes, frozenset[int]]:
        """Return which frames were asked to be erased of records that stay, by record."""
        asked: dict[bytes, set[int]] = {}
        for _, entry in self._rows(ERASURE_PREFIX):
            for record_id in entry["records"]:
                if entry["frames"]:
                    asked.setdefault(record_id, set()).update(entry["frames"])
        return {record_id: frozenset(frames) for record_id, frames in asked.items()}

    def accesses(self) -> Iterator[AccessFacts]:
        """Yield every request for access."""
        for access_id, entry in self._rows(ACCESS_PREFIX):
            height = self._audited.requested.get(access_id, self.point.height)
            share, records = entry.get("grant", b""), tuple(entry["records"])
            released = frozenset(entry.get("released", {}))
            yield AccessFacts(access_id, entry["owner"], records, height, entry["refused"], share, released)

    def shares(self) -> tuple[dict[bytes, ShareRow], set[bytes]]:
        """Return the grants that stand at this block, by id, and the ids of those that were revoked or are over.

        A grant is without the records of which frames were erased since: their keys are in what was sealed for it.
        """
        standing: dict[bytes, ShareRow] = {}
        ended: set[bytes] = set()
        for grant_id, entry in self._rows(GRANT_PREFIX):
            if entry["status"] == "active" and entry["until_ms"] > self.point.timestamp_ms:
                share = read_share(grant_id, entry, entry["height"])
                left = tuple(each for each in share.records if self._narrowed_at.get(each, -1) < share.height)
                standing[grant_id] = replace(share, records=left)
            else:
                ended.add(grant_id)
        return standing, ended

    @cached_property
    def _narrowed_at(self) -> dict[bytes, int]:
        """Return the height of the last erasure of frames, by record."""
        heights: dict[bytes, int] = {}
        for erasure in self.erasures():
            for record_id in erasure.records if erasure.frames else ():
                heights[record_id] = max(erasure.height, heights.get(record_id, 0))
        return heights

    def denied_heights(self) -> dict[bytes, int]:
        """Return the height of the last denial of each visit that was ever denied, also if that was settled since."""
        return self._audited.denied

    def erasures(self) -> Iterator[ErasureFacts]:
        """Yield every request for erasure."""
        for erasure_id, entry in self._rows(ERASURE_PREFIX):
            yield _erasure(erasure_id, entry, self._audited.requested.get(erasure_id, self.point.height))

    def open_erasures(self) -> Iterator[ErasureFacts]:
        """Yield the requests for erasure that a custodian has yet to confirm, all as of this state's height."""
        for erasure_id, entry in self._rows(ERASURE_PREFIX):
            if not set(entry["custodians"]) <= set(entry["receipts"]):
                yield _erasure(erasure_id, entry, self.point.height)

    def has_released(self, access_id: bytes, custodian: bytes, record_ids: list[bytes]) -> bool:
        """Tell whether a custodian has told the chain that it released all these records under a request."""
        prefix = RELEASE_PREFIX + access_id + custodian
        return all(self._state.get(prefix + record_id) is not None for record_id in record_ids)

    @cached_property
    def _audited(self) -> _Audited:
        """What the audit alone tells, of all visits: one walk over it, since each request would take one of its own."""
        found = _Audited()
        for key, entry in self._values(AUDIT_PREFIX):
            height: int = entry["height"]
            for name in ("access_id", "erasure_id"):
                if name in entry["data"]:
                    found.requested.setdefault(entry["data"][name], height)
            owner = key[:OWNER_BYTES]
            if entry["kind"] == "denied":
                found.denied[owner] = max(height, found.denied.get(owner, 0))
            if _narrows(entry):
                found.narrowed[owner] = max(height, found.narrowed.get(owner, 0))
        return found


def _narrows(entry: dict[str, Any]) -> bool:
    ends_quarantine = entry["kind"] == "breach_closed" and entry["data"].get("outcome") == "released"
    return entry["kind"] in NARROWING_KINDS or ends_quarantine


def _erasure(erasure_id: bytes, entry: dict[str, Any], height: int) -> ErasureFacts:
    return ErasureFacts(
        erasure_id=erasure_id,
        owner=entry["owner"],
        records=tuple(entry["records"]),
        frames=tuple(entry["frames"]),
        height=height,
        custodians=tuple(entry["custodians"]),
        receipts=frozenset(entry["receipts"]),
        asked_at_ms=entry.get("time", 0),
    )


def _record(record_id: bytes, entry: dict[str, Any]) -> RecordState:
    facts = RecordFacts(
        record_id=record_id,
        txid=entry["txid"],
        owner=entry["owner"],
        commitment_root=entry["commitment_root"],
        ciphertext_root=entry["ciphertext_root"],
        expires_at_ms=entry["expires_at_ms"],
        height=entry["height"],
        erased_frames=tuple(entry["erased_frames"]),
    )
    return RecordState(facts, entry["status"], frozenset(entry["awaited"]))

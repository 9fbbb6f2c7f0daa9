"""Finalized state of records, access, grantees and erasures for a custodian."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

from msgspec import structs

from consensus.errors import BlockRobotError
from consensus.records.placement import Placement
from consensus.records.sharing import GRANTEE_ROLES, SharedRequest, hash_grant_member
from consensus.state.access import GRANT, RELEASE
from consensus.state.access import REQUEST as ACCESS_REQUEST
from consensus.state.audit import ENTRY, EntryRow
from consensus.state.erasure import REQUEST as ERASURE_REQUEST
from consensus.state.erasure import ErasureRow
from consensus.state.identity import HANDLE, active_role, custodian_organisations, custodian_rooms, custodians
from consensus.state.keys import RangeScanner, Reader, Scanner
from consensus.state.records import EMPTY_FRAME, OF_VISIT, RECORD, RecordRow
from consensus.state.rights import OBJECTION, QUARANTINE, RESTRICTION
from consensus.state.settings import read_copies
from node.custody.restrictions import prolong, restrictions_from_row, with_natural_expiries
from node.custody.stores.custody_store import Checkpoint, RecordFacts, VisitRestrictions
from node.custody.stores.share_store import ShareRow

NARROWING_KINDS = frozenset({"restricted", "objected", "denied", "transferred"})
"""What the audit calls the words that make earlier requests void; the end of a quarantine is one too (`_narrows`)."""


class StateReader(Reader, Scanner, RangeScanner, Protocol):
    """The flat table of the finalized state."""


@dataclass(frozen=True, slots=True)
class RecordState:
    """A record; `status`: active, erasing, erased or expired (the last two without roots).

    `awaited`: custodians whose expiry report is pending.
    """

    facts: RecordFacts
    status: str
    awaited: frozenset[bytes] = frozenset()

    def is_kept(self, at_ms: int) -> bool:
        return self.status == "active" and self.facts.expires_at_ms > at_ms


@dataclass(frozen=True, slots=True)
class AccessFacts:
    """An access request with its block's height; `released` and `refused` name custodians."""

    access_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    height: int
    refused: dict[bytes, str]
    share: bytes = b""
    released: frozenset[bytes] = frozenset()


@dataclass(frozen=True, slots=True)
class ErasureFacts:
    """An erasure request: who has to confirm it, and who has."""

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
    """Request heights by id; last voiding statement and denial by owner."""

    requested: dict[bytes, int] = field(default_factory=dict)
    narrowed: dict[bytes, int] = field(default_factory=dict)
    denied: dict[bytes, int] = field(default_factory=dict)


def read_placement(state: Reader) -> Placement:
    return Placement.of(custodian_rooms(state), read_copies(state.get), custodian_organisations(state))


class ChainFacts:
    """The state at one finalized block; its reader stays open during use."""

    def __init__(self, state: StateReader, point: Checkpoint) -> None:
        self._state = state
        self.point = point

    @cached_property
    def placement(self) -> Placement:
        return read_placement(self._state)

    def active_records(self) -> Iterator[RecordFacts]:
        """Those being erased included."""
        for record in self.records():
            if record.status in {"active", "erasing"}:
                yield record.facts

    def records(self, after: bytes = b"") -> Iterator[RecordState]:
        """In the order of their ids."""
        for (record_id,), row in RECORD.rows_after(self._state, after):
            yield self._record(record_id, row)

    def unreported(self, member: bytes) -> list[bytes]:
        """Return expired records awaiting this custodian's report, or only former custodians'."""
        known = frozenset(custodians(self._state))
        if member not in known:
            return []
        expired = (record for record in self.records() if record.status == "expired")
        return [each.facts.record_id for each in expired if member in each.awaited or not each.awaited & known]

    def has_record(self, record_id: bytes) -> bool:
        return RECORD.has(self._state, record_id)

    def record(self, record_id: bytes) -> RecordState | None:
        row = RECORD.at(self._state, record_id)
        return None if row is None else self._record(record_id, row)

    def _record(self, record_id: bytes, row: RecordRow) -> RecordState:
        facts = RecordFacts(
            record_id=record_id,
            txid=row.txid,
            owner=row.owner,
            commitment_root=row.commitment_root,
            ciphertext_root=row.ciphertext_root,
            expires_at_ms=prolong(self._restrictions.get(row.owner), record_id, row.expires_at_ms),
            height=row.height,
            erased_frames=tuple(row.erased_frames),
        )
        return RecordState(facts, row.status, frozenset(row.awaited))

    @cached_property
    def _restrictions(self) -> dict[bytes, VisitRestrictions]:
        return {owner: restrictions_from_row(owner, row) for (owner,), row in RESTRICTION.rows(self._state)}

    def visit_restrictions(self) -> Iterator[VisitRestrictions]:
        """Yield the restrictions of every visit with any statement, even withdrawn ones.

        Requests are void up to its last audited statement's height, else this state's.
        """
        denied = {owner for (owner,), _ in QUARANTINE.rows(self._state)}
        objected = {owner for (owner,), _ in OBJECTION.rows(self._state)}
        narrowed = self._audited.narrowed
        for owner in sorted(denied | objected | set(self._restrictions) | set(narrowed)):
            stated = self._restrictions.get(owner, VisitRestrictions(owner))
            height = narrowed.get(owner, self.point.height)
            restrictions = structs.replace(stated, narrowed_height=height, quarantined=owner in denied)
            yield with_natural_expiries(restrictions, self._natural(stated))

    def _natural(self, restrictions: VisitRestrictions) -> dict[bytes, int]:
        natural = {}
        for (_, record_id), _ in OF_VISIT.rows(self._state, restrictions.owner) if restrictions.until_ms else ():
            row = RECORD.at(self._state, record_id)
            if row is not None and prolong(restrictions, record_id, row.expires_at_ms) != row.expires_at_ms:
                natural[record_id] = row.expires_at_ms
        return natural

    def is_empty_frame_approved(self, digest: bytes) -> bool:
        return EMPTY_FRAME.has(self._state, digest)

    def erased_frames(self) -> dict[bytes, frozenset[int]]:
        asked: dict[bytes, set[int]] = {}
        for _, row in ERASURE_REQUEST.rows(self._state):
            for record_id in row.records if row.frames else ():
                asked.setdefault(record_id, set()).update(row.frames)
        return {record_id: frozenset(frames) for record_id, frames in asked.items()}

    def accesses(self) -> Iterator[AccessFacts]:
        for (access_id,), row in ACCESS_REQUEST.rows(self._state):
            height = self._audited.requested.get(access_id, self.point.height)
            records, released = tuple(row.records), frozenset(row.released)
            yield AccessFacts(access_id, row.owner, records, height, row.refused, row.grant, released)

    def shares(self) -> tuple[dict[bytes, ShareRow], set[bytes]]:
        """Return standing grants by id, and ids of revoked or ended ones.

        A grant excludes records with frames erased since: its sealed packages hold their keys.
        """
        standing: dict[bytes, ShareRow] = {}
        ended: set[bytes] = set()
        for (grant_id,), row in GRANT.rows(self._state):
            if row.is_open(self.point.timestamp_ms):
                left = tuple(each for each in row.records if self._narrowed_at.get(each, -1) < row.height)
                standing[grant_id] = ShareRow(grant_id, row.owner, left, row.until_ms, row.height)
            else:
                ended.add(grant_id)
        return standing, ended

    @cached_property
    def _narrowed_at(self) -> dict[bytes, int]:
        heights: dict[bytes, int] = {}
        for erasure in self.erasures():
            for record_id in erasure.records if erasure.frames else ():
                heights[record_id] = max(erasure.height, heights.get(record_id, 0))
        return heights

    def denied_heights(self) -> dict[bytes, int]:
        """Even of denials settled since."""
        return self._audited.denied

    def erasures(self) -> Iterator[ErasureFacts]:
        for (erasure_id,), row in ERASURE_REQUEST.rows(self._state):
            yield _erasure(erasure_id, row, self._audited.requested.get(erasure_id, self.point.height))

    def open_erasures(self) -> Iterator[ErasureFacts]:
        """Those that await a custodian's confirmation."""
        for (erasure_id,), row in ERASURE_REQUEST.rows(self._state):
            if not set(row.custodians) <= set(row.receipts):
                yield _erasure(erasure_id, row, self.point.height)

    def has_released(self, access_id: bytes, custodian: bytes, record_ids: list[bytes]) -> bool:
        return all(RELEASE.has(self._state, access_id, custodian, record_id) for record_id in record_ids)

    @cached_property
    def _audited(self) -> _Audited:
        found = _Audited()
        for (owner, _), row in ENTRY.rows(self._state):
            for name in ("access_id", "erasure_id"):
                if name in row.data:
                    found.requested.setdefault(row.data[name], row.height)
            if row.kind == "denied":
                found.denied[owner] = max(row.height, found.denied.get(owner, 0))
            if _narrows(row):
                found.narrowed[owner] = max(row.height, found.narrowed.get(owner, 0))
        return found


def _narrows(row: EntryRow) -> bool:
    ends_quarantine = row.kind == "breach_closed" and row.data.get("outcome") == "released"
    return row.kind in NARROWING_KINDS or ends_quarantine


def _erasure(erasure_id: bytes, row: ErasureRow, height: int) -> ErasureFacts:
    return ErasureFacts(
        erasure_id=erasure_id,
        owner=row.owner,
        records=tuple(row.records),
        frames=tuple(row.frames),
        height=height,
        custodians=tuple(row.custodians),
        receipts=frozenset(row.receipts),
        asked_at_ms=row.time,
    )


def require_open_grant(state: Reader, grant_id: bytes, now_ms: int) -> None:
    """Raise GRANT_ENDED for a revoked or ended grant; unfinalized ones pass."""
    grant = GRANT.at(state, grant_id)
    if grant is not None and not grant.is_open(now_ms):
        raise BlockRobotError("GRANT_ENDED")


def require_grantee(state: Reader, request: SharedRequest, grant_id: bytes, grantee: bytes, now_ms: int) -> None:
    """Check that this proven 33-byte key holds a standing grant and its request.

    Raises ACCESS_NOT_GRANTED, NOT_PERMITTED, GRANT_ENDED, GRANTEE_NOT_A_MEMBER.
    """
    grant = GRANT.at(state, grant_id)
    if grant is None or grant.grantee != grantee:
        raise BlockRobotError("NOT_PERMITTED", "The grant is for another key.")
    asked = ACCESS_REQUEST.at(state, request.access_id)
    if asked is None or asked.grant != grant_id or request.record_id not in asked.records:
        raise BlockRobotError("ACCESS_NOT_GRANTED")
    if not grant.is_open(now_ms):
        raise BlockRobotError("GRANT_ENDED")
    try:
        is_theirs = hash_grant_member(request.salt, request.handle) == grant.member_hash
    except BlockRobotError:
        is_theirs = False
    member = HANDLE.at(state, request.handle) if is_theirs else None
    if member is None or active_role(state, member) not in GRANTEE_ROLES:
        raise BlockRobotError("GRANTEE_NOT_A_MEMBER")

"""What the finalized state says of records, access and erasures, as a custodian needs it. Must never look at blocks.

The state keeps all that blocks ever said of them but the heights of requests; those are in the visits' audit entries.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

from msgspec import structs

from consensus.primitives.encoding import decode_value
from consensus.primitives.hashing import sha256
from node.offchain.standing import prolong, read_restriction, with_natural
from node.offchain.store import Checkpoint, RecordFacts, VisitStanding

RECORD_PREFIX = b"records\x00record/"
ACCESS_PREFIX = b"access\x00access/"
RELEASE_PREFIX = b"access\x00release/"
ERASURE_PREFIX = b"erasure\x00erasure/"
AUDIT_PREFIX = b"audit\x00entry/"
RESTRICTION_PREFIX = b"rights\x00restriction/"
OBJECTION_PREFIX = b"rights\x00objection/"
QUARANTINE_PREFIX = b"rights\x00quarantine/"
OF_VISIT_PREFIX = b"records\x00of-visit/"
ALL_ROWS_COUNT = 1 << 60


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
    """A record as the state has it: `status` is active, erasing, erased or expired; the roots of the last two are gone."""

    facts: RecordFacts
    status: str

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
        """Yield what stands of every visit of which something was said.

        The state does not say when, so every request up to it is void: who wants to see a record asks again.
        """
        denied = {owner for owner, _ in self._values(QUARANTINE_PREFIX)}
        objected = {owner for owner, _ in self._values(OBJECTION_PREFIX)}
        for owner in sorted(denied | objected | set(self._restrictions)):
            told = self._restrictions.get(owner, VisitStanding(owner))
            standing = structs.replace(told, narrowed_height=self.point.height, quarantined=owner in denied)
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
            height = self._height_of(entry["owner"], "access_requested", "access_id", access_id)
            yield AccessFacts(access_id, entry["owner"], tuple(entry["records"]), height, entry["refused"])

    def erasures(self) -> Iterator[ErasureFacts]:
        """Yield every request for erasure."""
        for erasure_id, entry in self._rows(ERASURE_PREFIX):
            yield ErasureFacts(
                erasure_id=erasure_id,
                owner=entry["owner"],
                records=tuple(entry["records"]),
                frames=tuple(entry["frames"]),
                height=self._height_of(entry["owner"], "erasure_requested", "erasure_id", erasure_id),
                custodians=tuple(entry["custodians"]),
                receipts=frozenset(entry["receipts"]),
                asked_at_ms=entry.get("time", 0),
            )

    def has_released(self, access_id: bytes, custodian: bytes, record_ids: list[bytes]) -> bool:
        """Tell whether a custodian has told the chain that it released exactly these records under a request."""
        told = sha256(custodian + b"".join(record_ids))
        return self._state.get(RELEASE_PREFIX + access_id + told) is not None

    def _height_of(self, owner: bytes, kind: str, field: str, identifier: bytes) -> int:
        """Return the height of a request by its audit entry; that of this state if there is none."""
        for _, entry in self._rows(AUDIT_PREFIX + owner):
            if entry["kind"] == kind and entry["data"].get(field) == identifier:
                height: int = entry["height"]
                return height
        return self.point.height


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
    return RecordState(facts, entry["status"])

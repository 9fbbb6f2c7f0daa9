"""Puts together what happened to a person's records, from the chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import msgspec

from clients.wallet.store.keystore import KnownVisit
from consensus.primitives.keys import PrivateKey
from consensus.state.audit import COUNT, ENTRY, entry_keys

RECORDED_KIND = "recorded"
VERDICT_KIND = "verdict"
Finding = tuple[bytes, str, list[int]]
"""What a verdict says of one record: its id, `verified` or `corrupted`, and the indexes of corrupted frames."""
_PAGE_COUNT = 100


class VisitReader(Protocol):
    """What an audit needs of a wallet.

    `trails` keeps, by visit, the entries that were read before, for a wallet that stays open: what is final never
    changes, so only what is new is asked for. None keeps nothing.
    """

    @property
    def trails(self) -> dict[bytes, list[AuditEntry]] | None:
        """The entries that were read before, by visit."""
        ...

    def owner_key(self, visit: KnownVisit) -> PrivateKey:
        """Derive the private key of one visit."""
        ...

    async def values(self, keys: Sequence[bytes], session: PrivateKey) -> dict[bytes, Any]:
        """Return proved values of flat keys, in the session of one key; None for what is absent."""
        ...

    async def scan(self) -> list[KnownVisit]:
        """Return all visits that are this person's."""
        ...


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One event of one visit, proven. `time_ms` is the block's timestamp; `data` depends on the kind."""

    owner: bytes
    index: int
    record_id: bytes
    kind: str
    time_ms: int
    height: int
    data: dict[str, Any]


def findings_of(entry: AuditEntry) -> list[Finding]:
    """Return what a verdict in the trail says of each record; nothing of another entry."""
    if entry.kind != VERDICT_KIND:
        return []
    return [(record_id, verdict, list(frames)) for record_id, verdict, frames in entry.data["findings"]]


def records_of(entry: AuditEntry) -> list[bytes]:
    """Return the records that an entry names."""
    named = entry.data.get("records")
    if isinstance(named, list):
        return named
    return [finding[0] for finding in findings_of(entry)] or [entry.record_id][: len(entry.record_id)]


async def audit_visit(wallet: VisitReader, visit: KnownVisit, count: int | None = None) -> list[AuditEntry]:
    """Return all events of a visit in order. The count and each entry are proven, so none can be left out.

    `count` is a proven count, from who has asked for it among other things; without one it is asked for.
    """
    key = wallet.owner_key(visit)
    if count is None:
        count = COUNT.among(await wallet.values([COUNT.key(visit.owner)], key), visit.owner) or 0
    trails = wallet.trails
    entries = [] if trails is None else trails.get(visit.owner, [])[:count]
    for start in range(len(entries), count, _PAGE_COUNT):
        keys = entry_keys(visit.owner, min(count, start + _PAGE_COUNT), start)
        values = await wallet.values(keys, key)
        for index, place in enumerate(keys, start):
            entries.append(AuditEntry(visit.owner, index, *msgspec.structs.astuple(ENTRY.convert(values[place]))))
    if trails is not None:
        trails[visit.owner] = list(entries)
    return entries


async def audit_all(wallet: VisitReader) -> list[AuditEntry]:
    """Return the events of all visits, in the order of the chain."""
    entries = []
    for visit in await wallet.scan():
        entries.extend(await audit_visit(wallet, visit))
    return sorted(entries, key=lambda entry: (entry.height, entry.index))

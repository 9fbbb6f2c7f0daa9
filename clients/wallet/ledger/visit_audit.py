"""Audit trails of a person's records, from the chain."""

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
    """What an audit needs of a wallet. `trails` caches final entries by visit; None disables it."""

    @property
    def trails(self) -> dict[bytes, list[AuditEntry]] | None: ...

    def owner_key(self, visit: KnownVisit) -> PrivateKey: ...

    async def values(self, keys: Sequence[bytes], session: PrivateKey) -> dict[bytes, Any]: ...

    async def scan(self) -> list[KnownVisit]: ...


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """A visit's proven event. `time_ms` is the block's; `data` depends on kind."""

    owner: bytes
    index: int
    record_id: bytes
    kind: str
    time_ms: int
    height: int
    data: dict[str, Any]


def findings_of(entry: AuditEntry) -> list[Finding]:
    """Of a verdict, per record; none for other entries."""
    if entry.kind != VERDICT_KIND:
        return []
    return [(record_id, verdict, list(frames)) for record_id, verdict, frames in entry.data["findings"]]


def records_of(entry: AuditEntry) -> list[bytes]:
    named = entry.data.get("records")
    if isinstance(named, list):
        return named
    return [finding[0] for finding in findings_of(entry)] or [entry.record_id][: len(entry.record_id)]


async def audit_visit(wallet: VisitReader, visit: KnownVisit, count: int | None = None) -> list[AuditEntry]:
    """In order, proven complete. `count` is an already proven length."""
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
    """In chain order."""
    entries = []
    for visit in await wallet.scan():
        entries.extend(await audit_visit(wallet, visit))
    return sorted(entries, key=lambda entry: (entry.height, entry.index))

"""Owners' restrictions, objections and denials as custodians apply them.

A narrowing statement or an owner-key transfer voids all earlier requests.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from msgspec import structs

from consensus.errors import BlockRobotError
from consensus.state.rights import RestrictionRow
from node.custody.finalized_events import FinalizedEvent
from node.custody.stores.custody_store import BlockEffects, CustodyStore, Grant, RecordFacts, VisitRestrictions

NARROWING_EVENTS = frozenset(
    {
        "records.transferred",
        "rights.restricted",
        "rights.objected",
        "rights.quarantined",
        "rights.quarantine_ended",
    }
)
RESTRICTION_EVENTS = NARROWING_EVENTS | {"rights.lifted"}


def prolong(restrictions: VisitRestrictions | None, record_id: bytes, expires_at_ms: int) -> int:
    """Return a record's expiry (ms), given its expiry without statements."""
    if restrictions is None or not restrictions.until_ms:
        return expires_at_ms
    covered = record_id in restrictions.records or (restrictions.whole and restrictions.whole_since_ms < expires_at_ms)
    return max(expires_at_ms, restrictions.until_ms) if covered else expires_at_ms


def restrictions_from_row(owner: bytes, row: RestrictionRow | None) -> VisitRestrictions:
    if row is None:
        return VisitRestrictions(owner)
    return VisitRestrictions(
        owner,
        whole=row.whole,
        whole_since_ms=row.whole_since_ms,
        until_ms=row.until_ms,
        records=tuple(row.records),
    )


def is_void(grant: Grant, restrictions: VisitRestrictions | None) -> bool:
    return restrictions is not None and (restrictions.quarantined or grant.height <= restrictions.narrowed_height)


def require_release(grant: Grant, restrictions: VisitRestrictions | None) -> None:
    """Raise CLIP_QUARANTINED or ACCESS_ENDED if a request releases nothing."""
    if restrictions is not None and restrictions.quarantined:
        raise BlockRobotError("CLIP_QUARANTINED")
    if is_void(grant, restrictions):
        raise BlockRobotError("ACCESS_ENDED")


def with_natural_expiries(restrictions: VisitRestrictions, natural: Mapping[bytes, int]) -> VisitRestrictions:
    return structs.replace(restrictions, natural=tuple(sorted(natural.items())))


async def find_restrictions(store: CustodyStore, owner: bytes) -> VisitRestrictions | None:
    return (await store.visit_restrictions([owner])).get(owner)


def follow_event(before: VisitRestrictions, event: FinalizedEvent, height: int) -> VisitRestrictions:
    """Return the restrictions after a visit's event; `apply_restrictions` handles prolonged clips."""
    after = before
    if event.kind in {"rights.restricted", "rights.lifted"}:
        data = event.data
        after = VisitRestrictions(
            owner=before.owner,
            narrowed_height=before.narrowed_height,
            quarantined=before.quarantined,
            whole=data["whole"],
            whole_since_ms=data["whole_since_ms"],
            until_ms=data["until_ms"],
            records=tuple(data["records"]),
            natural=before.natural,
        )
    elif event.kind == "rights.quarantined":
        after = VisitRestrictions(before.owner, before.narrowed_height, quarantined=True, natural=before.natural)
    elif event.kind == "rights.quarantine_ended":
        after = VisitRestrictions(before.owner, before.narrowed_height, natural=before.natural)
    if event.kind in NARROWING_EVENTS:
        after = structs.replace(after, narrowed_height=max(height, before.narrowed_height))
    return after


async def apply_restrictions(store: CustodyStore, restrictions: VisitRestrictions) -> VisitRestrictions:
    """Write a visit's restrictions and its clips' expiries. Idempotent.

    Natural expiries are written before prolonging and dropped after restoring, against crashes.
    """
    natural = dict(restrictions.natural)
    known = {clip.record_id: clip.expires_at_ms for clip in await store.clips_of_owner(restrictions.owner)}
    missing = {facts.record_id: facts for facts in await store.missing_of_owner(restrictions.owner)}
    known |= {record_id: facts.expires_at_ms for record_id, facts in missing.items()}
    held: dict[bytes, int] = {}
    changed: list[tuple[bytes, int]] = []
    for record_id, now_ms in known.items():
        own_ms = natural.get(record_id, now_ms)
        until_ms = prolong(restrictions, record_id, own_ms)
        if until_ms != own_ms:
            held[record_id] = own_ms
        if until_ms != now_ms:
            changed.append((record_id, until_ms))
    await store.apply(BlockEffects(visit_restrictions=(with_natural_expiries(restrictions, {**natural, **held}),)))
    late = tuple(replace(missing[key], expires_at_ms=until_ms) for key, until_ms in changed if key in missing)
    expiries = tuple((key, until_ms) for key, until_ms in changed if key not in missing)
    await store.apply(BlockEffects(missing=late, expiries=expiries))
    settled = with_natural_expiries(restrictions, held)
    await store.apply(BlockEffects(visit_restrictions=(settled,)))
    return settled


def hold(restrictions: VisitRestrictions, facts: RecordFacts) -> tuple[VisitRestrictions, RecordFacts]:
    until_ms = prolong(restrictions, facts.record_id, facts.expires_at_ms)
    if until_ms == facts.expires_at_ms:
        return restrictions, facts
    natural = {**dict(restrictions.natural), facts.record_id: facts.expires_at_ms}
    return with_natural_expiries(restrictions, natural), replace(facts, expires_at_ms=until_ms)

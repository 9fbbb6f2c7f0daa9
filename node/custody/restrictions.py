"""What people said of their visits, as a custodian heeds it: restricted, objected to, denied. Must never doubt for a yes.

All that a visit's owner said last is one row. A word that narrows what may be released makes void every request from
before it: what she asks for afterwards the contracts have judged already. So does a transfer to another owner key: who
has the former key had asked for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from msgspec import structs

from consensus.errors import BlockRobotError
from consensus.state.rights import RestrictionRow
from node.custody.finalized_events import FinalizedEvent
from node.custody.stores.custody_store import BlockEffects, CustodyStore, Grant, RecordFacts, VisitRestrictions

NARROWING = frozenset(
    {
        "records.transferred",
        "rights.restricted",
        "rights.objected",
        "rights.quarantined",
        "rights.quarantine_ended",
    }
)
STANDING_EVENTS = NARROWING | {"rights.lifted"}


def prolong(standing: VisitRestrictions | None, record_id: bytes, expires_at_ms: int) -> int:
    """Return when a record expires, in ms, that would expire at a time if nothing had been said."""
    if standing is None or not standing.until_ms:
        return expires_at_ms
    covered = record_id in standing.records or (standing.whole and standing.whole_since_ms < expires_at_ms)
    return max(expires_at_ms, standing.until_ms) if covered else expires_at_ms


def standing_of(owner: bytes, row: RestrictionRow | None) -> VisitRestrictions:
    """Return the standing of a visit of which only a restriction is known."""
    if row is None:
        return VisitRestrictions(owner)
    return VisitRestrictions(
        owner,
        whole=row.whole,
        whole_since_ms=row.whole_since_ms,
        until_ms=row.until_ms,
        records=tuple(row.records),
    )


def is_void(grant: Grant, standing: VisitRestrictions | None) -> bool:
    """Tell whether a request counts no more, because of what was said of the visit after it."""
    return standing is not None and (standing.quarantined or grant.height <= standing.narrowed_height)


def require_release(grant: Grant, standing: VisitRestrictions | None) -> None:
    """Raise CLIP_QUARANTINED or ACCESS_ENDED if nothing may be released under a request any more."""
    if standing is not None and standing.quarantined:
        raise BlockRobotError("CLIP_QUARANTINED")
    if is_void(grant, standing):
        raise BlockRobotError("ACCESS_ENDED")


def with_natural(standing: VisitRestrictions, natural: Mapping[bytes, int]) -> VisitRestrictions:
    """Return a standing with other natural expiries, sorted."""
    return structs.replace(standing, natural=tuple(sorted(natural.items())))


async def find_standing(store: CustodyStore, owner: bytes) -> VisitRestrictions | None:
    """Return what was said of one visit, or None if nothing was."""
    return (await store.standings([owner])).get(owner)


def follow_event(before: VisitRestrictions, event: FinalizedEvent, height: int) -> VisitRestrictions:
    """Return what stands after one event that is about a whole visit; what is kept beyond its expiry is settled apart."""
    after = before
    if event.kind in {"rights.restricted", "rights.lifted"}:
        told = event.data
        after = VisitRestrictions(
            owner=before.owner,
            narrowed_height=before.narrowed_height,
            quarantined=before.quarantined,
            whole=told["whole"],
            whole_since_ms=told["whole_since_ms"],
            until_ms=told["until_ms"],
            records=tuple(told["records"]),
            natural=before.natural,
        )
    elif event.kind == "rights.quarantined":
        after = VisitRestrictions(before.owner, before.narrowed_height, quarantined=True, natural=before.natural)
    elif event.kind == "rights.quarantine_ended":
        after = VisitRestrictions(before.owner, before.narrowed_height, natural=before.natural)
    if event.kind in NARROWING:
        after = structs.replace(after, narrowed_height=max(height, before.narrowed_height))
    return after


async def settle(store: CustodyStore, standing: VisitRestrictions) -> VisitRestrictions:
    """Write what stands, and with it until when each clip of the visit is kept. Doing it again changes nothing.

    The natural expiries are written before any clip is prolonged and forgotten after all have them again, so that a
    crash in between loses none.
    """
    natural = dict(standing.natural)
    known = {clip.record_id: clip.expires_at_ms for clip in await store.clips_of_owner(standing.owner)}
    missing = {facts.record_id: facts for facts in await store.missing_of_owner(standing.owner)}
    known |= {record_id: facts.expires_at_ms for record_id, facts in missing.items()}
    held: dict[bytes, int] = {}
    changed: list[tuple[bytes, int]] = []
    for record_id, now_ms in known.items():
        own_ms = natural.get(record_id, now_ms)
        until_ms = prolong(standing, record_id, own_ms)
        if until_ms != own_ms:
            held[record_id] = own_ms
        if until_ms != now_ms:
            changed.append((record_id, until_ms))
    await store.apply(BlockEffects(standings=(with_natural(standing, {**natural, **held}),)))
    late = tuple(replace(missing[key], expires_at_ms=until_ms) for key, until_ms in changed if key in missing)
    expiries = tuple((key, until_ms) for key, until_ms in changed if key not in missing)
    await store.apply(BlockEffects(missing=late, expiries=expiries))
    settled = with_natural(standing, held)
    await store.apply(BlockEffects(standings=(settled,)))
    return settled


def hold(standing: VisitRestrictions, facts: RecordFacts) -> tuple[VisitRestrictions, RecordFacts]:
    """Return a record that has just come to a visit as it is to be kept, and what stands of the visit with it."""
    until_ms = prolong(standing, facts.record_id, facts.expires_at_ms)
    if until_ms == facts.expires_at_ms:
        return standing, facts
    natural = {**dict(standing.natural), facts.record_id: facts.expires_at_ms}
    return with_natural(standing, natural), replace(facts, expires_at_ms=until_ms)

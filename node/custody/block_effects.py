"""Applies one finalized block's events to a custodian, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import structlog

from consensus.primitives.encoding import encode_value
from consensus.records.commitments import ciphertext_root, commitment_root
from consensus.records.placement import Placement
from node.custody.erasure import (
    EXPIRED_KIND,
    RECEIPT_KIND,
    RECORDS_A_CALL_MAX_COUNT,
    Eraser,
    compute_expiry_subject,
)
from node.custody.finalized_events import FinalizedEvent, FinalizedEvents
from node.custody.restrictions import (
    RESTRICTION_EVENTS,
    apply_restrictions,
    find_restrictions,
    follow_event,
    hold,
    is_void,
)
from node.custody.shares import Shares, may_release
from node.custody.stores.custody_store import (
    BlockEffects,
    ClipRow,
    CustodyStore,
    Grant,
    OutboxRow,
    RecordFacts,
    VisitRestrictions,
)
from node.custody.stores.share_store import ShareRow

RELEASED_KIND = "access.released"
REFUSED_KIND = "access.refused"
_RECORDED = "records.recorded"
_RECEIPTS = frozenset({"access.released", "access.refused", "erasure.receipted", "erasure.expired"})
_WORK = RESTRICTION_EVENTS | {
    _RECORDED,
    "access.requested",
    "access.granted",
    "access.revoked",
    "records.empty_frames_withdrawn",
    "erasure.requested",
}

log = structlog.get_logger(__name__)


def _release(grant: Grant, record_ids: Sequence[bytes], part: int) -> OutboxRow:
    arguments = encode_value([grant.access_id, sorted(record_ids)])
    return OutboxRow(RELEASED_KIND, grant.access_id, part, "access", "released", arguments, grant.height)


async def build_release(store: CustodyStore, grant: Grant, record_ids: Sequence[bytes]) -> OutboxRow:
    rows = await store.outbox_of(RELEASED_KIND, grant.access_id)
    row = _release(grant, record_ids, max((row.part for row in rows), default=-1) + 1)
    return next((known for known in rows if known.arguments == row.arguments), row)


def _share(data: Mapping[str, Any], height: int) -> ShareRow:
    return ShareRow(data["grant_id"], data["owner"], tuple(data["records"]), data["until_ms"], height)


def place(facts: RecordFacts, member: bytes, placement: Placement) -> RecordFacts:
    """Of a clip that is not here: whether this custodian is to keep it."""
    return replace(facts, elsewhere=not placement.is_keeper(member, facts.record_id))


def matches_roots(clip: ClipRow, facts: RecordFacts) -> bool:
    return (
        commitment_root(clip.commitment_leaves) == facts.commitment_root
        and ciphertext_root(clip.ciphertext_leaves) == facts.ciphertext_root
    )


def _is_work(member: bytes, event: FinalizedEvent) -> bool:
    return event.data["custodian"] == member if event.kind in _RECEIPTS else event.kind in _WORK


def only_records(member: bytes, block: FinalizedEvents) -> bool:
    return all(event.kind == _RECORDED for event in block.events if _is_work(member, event))


class BlockApplier:
    """Applies one block in event order; adjacent confirmations are batched, flushed before clip reads.

    Of several blocks it only collects what they record.
    """

    def __init__(
        self,
        store: CustodyStore,
        eraser: Eraser,
        shares: Shares,
        member: bytes,
        placement: Placement,
        blocks: Sequence[FinalizedEvents],
    ) -> None:
        self._store = store
        self._shares = shares
        self._eraser = eraser
        self._member = member
        self._placement = placement
        self._blocks = blocks
        self._block = blocks[0]
        self._confirmed: list[RecordFacts] = []
        self._missing: list[RecordFacts] = []
        self._visit_restrictions: dict[bytes, VisitRestrictions] = {}
        self._settled: list[tuple[str, bytes, int]] = []

    async def apply(self) -> None:
        """The caller sets the checkpoint."""
        staged = await self._read_recorded()
        for event in self._block.events:
            if not _is_work(self._member, event):
                continue
            match event.kind:
                case "records.recorded":
                    await self._on_recorded(event, staged.get(event.data["record_id"]))
                case "access.requested":
                    await self._flush()
                    await self._on_access(event.data)
                case "access.granted":
                    await self._shares.take_grant(_share(event.data, self._block.height))
                case "access.revoked":
                    await self._shares.end_grant(event.data["grant_id"])
                case "records.empty_frames_withdrawn":
                    await self._eraser.delete_backgrounds(event.data["gone"])
                case "erasure.requested":
                    await self._flush()
                    await self._on_erasure(event.data)
                case kind if kind in _RECEIPTS:
                    await self._on_own_receipt(event)
                case _:
                    await self._flush()
                    await self._on_right(event)
        await self._flush()

    async def collect_recorded(self) -> BlockEffects | None:
        """What blocks that `only_records` change; nothing is written. None if they do more than that."""
        staged = await self._read_recorded()
        for block in self._blocks:
            self._block = block
            for event in block.events:
                if event.kind != _RECORDED:
                    continue
                facts, clip = self._facts(event), staged.get(event.data["record_id"])
                restrictions = self._visit_restrictions.get(facts.owner)
                if restrictions is not None and restrictions.whole:
                    return None
                if clip is None:
                    self._missing.append(place(facts, self._member, self._placement))
                elif clip.status == "staged":
                    if not matches_roots(clip, facts):
                        return None
                    self._confirmed.append(facts)
        return BlockEffects(confirmed=tuple(self._confirmed), missing=tuple(self._missing))

    async def _read_recorded(self) -> dict[bytes, ClipRow]:
        recorded = [event.data for block in self._blocks for event in block.events if event.kind == _RECORDED]
        owners = sorted({data["owner"] for data in recorded})
        self._visit_restrictions = await self._store.visit_restrictions(owners) if owners else {}
        return await self._store.clips([data["record_id"] for data in recorded])

    async def _flush(self) -> None:
        if self._confirmed or self._missing or self._settled:
            settled = tuple(self._settled)
            await self._store.apply(
                BlockEffects(confirmed=tuple(self._confirmed), missing=tuple(self._missing), settled=settled)
            )
        self._confirmed, self._missing, self._settled = [], [], []

    async def _on_recorded(self, event: FinalizedEvent, clip: ClipRow | None) -> None:
        facts = self._facts(event)
        restrictions = self._visit_restrictions.get(facts.owner)
        if restrictions is not None and restrictions.whole:
            restrictions, facts = hold(restrictions, facts)
            self._visit_restrictions[facts.owner] = restrictions
            await self._store.apply(BlockEffects(visit_restrictions=(restrictions,)))
        if clip is None:
            self._missing.append(place(facts, self._member, self._placement))
        elif clip.status == "staged":
            if matches_roots(clip, facts):
                self._confirmed.append(facts)
            else:
                log.warning("custody_upload_is_not_what_was_recorded", record_id=facts.record_id.hex())
                await self._eraser.drop_staged([facts.record_id])
                self._missing.append(place(facts, self._member, self._placement))

    def _facts(self, event: FinalizedEvent) -> RecordFacts:
        data = event.data
        return RecordFacts(
            record_id=data["record_id"],
            txid=event.txid,
            owner=data["owner"],
            commitment_root=data["commitment_root"],
            ciphertext_root=data["ciphertext_root"],
            expires_at_ms=data["expires_at_ms"],
            height=self._block.height,
        )

    async def _on_access(self, data: dict[str, Any]) -> None:
        named = tuple(data["records"])
        grant = Grant(data["access_id"], data["owner"], named, self._block.height, data.get("grant", b""))
        has_ended = grant.share and await self._store.share(grant.share) is None
        if has_ended or is_void(grant, await find_restrictions(self._store, grant.owner)):
            await self._store.apply(BlockEffects(grants=(grant,)))
            return
        held = [clip.record_id for clip in await self._store.clips_of_owner(grant.owner)]
        if grant.share:  # a part of the key is released wherever the clip is
            held += [facts.record_id for facts in await self._store.missing_of_owner(grant.owner)]
        if named:
            own = set(held)
            held = [record_id for record_id in named if record_id in own]
        is_known = bool(held)
        held = [record_id for record_id in held if await may_release(self._store, grant, record_id)]
        batches = range(0, len(held), RECORDS_A_CALL_MAX_COUNT)
        owed = [
            _release(grant, held[start : start + RECORDS_A_CALL_MAX_COUNT], part) for part, start in enumerate(batches)
        ]
        if named and not held and (is_known or not await self._awaits_any(named)):
            code = "GRANT_PARTS_MISSING" if is_known else "CLIP_ERASED"
            arguments = encode_value([grant.access_id, code])
            owed = [OutboxRow(REFUSED_KIND, grant.access_id, 0, "access", "refused", arguments, grant.height)]
        await self._store.apply(BlockEffects(outbox=tuple(owed), grants=(grant,)))

    async def _on_right(self, event: FinalizedEvent) -> None:
        owner = event.data["owner"]
        before = await find_restrictions(self._store, owner) or VisitRestrictions(owner)
        self._visit_restrictions[owner] = await apply_restrictions(
            self._store, follow_event(before, event, self._block.height)
        )
        if self._visit_restrictions[owner].quarantined:
            await self._shares.deny_visit(owner)

    async def _awaits_any(self, record_ids: Sequence[bytes]) -> bool:
        return bool(await self._store.missing_clips(record_ids))

    async def _on_erasure(self, data: dict[str, Any]) -> None:
        record_ids, frames = list(data["records"]), sorted(data["frames"])
        clips = await self._store.clips(record_ids)
        listed = await self._store.missing_clips(record_ids)
        own = []
        for record_id in record_ids:
            missing, clip = listed.get(record_id), clips.get(record_id)
            holder = clip.owner if clip is not None and clip.status == "confirmed" else (missing and missing.owner)
            if holder and holder != data["owner"]:
                log.error("custody_erasure_by_another_owner", record_id=record_id.hex())
                continue
            own.append(record_id)
            if missing is not None and frames:
                erased = tuple(sorted({*missing.erased_frames, *frames}))
                await self._store.apply(BlockEffects(missing=(replace(missing, erased_frames=erased),)))
        if frames:
            await self._shares.leave_out(data["owner"], own, self._block.height)
        await self._eraser.erase_requested(data["erasure_id"], own, frames, self._block.height)

    async def _on_own_receipt(self, event: FinalizedEvent) -> None:
        data = event.data
        if event.kind == "access.released":
            arguments = encode_value([data["access_id"], data["records"]])
            rows = await self._store.outbox_of(RELEASED_KIND, data["access_id"])
            self._settled += [row.key for row in rows if row.arguments == arguments]
        elif event.kind == "access.refused":
            self._settled.append((REFUSED_KIND, data["access_id"], 0))
        elif event.kind == "erasure.receipted":
            self._settled.append((RECEIPT_KIND, data["erasure_id"], 0))
        else:
            self._settled.append((EXPIRED_KIND, compute_expiry_subject(data["record_ids"]), 0))

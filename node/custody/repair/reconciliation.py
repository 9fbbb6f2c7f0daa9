"""Reconciles a custodian's store with finalized state, without blocks; idempotent, checkpoint last."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any, TypeVar

from msgspec import structs

from consensus.primitives.encoding import decode_value
from consensus.records.placement import Placement
from node.custody.block_effects import RELEASED_KIND, BlockApplier, matches_roots, place
from node.custody.chain_facts import AccessFacts, ChainFacts, ErasureFacts
from node.custody.erasure import Eraser
from node.custody.finalized_events import FinalizedEvent, FinalizedEvents
from node.custody.restrictions import apply_restrictions, with_natural_expiries
from node.custody.shares import Shares
from node.custody.stores.custody_store import BlockEffects, CustodyStore, RecordFacts, VisitRestrictions

RECORDS_AT_ONCE_COUNT = 256

T = TypeVar("T")


async def read_in_thread(read: Callable[[], T]) -> T:
    """Returns only after reading, even if cancelled.

    The caller closes the state next.
    """
    reading = asyncio.ensure_future(asyncio.to_thread(read))
    try:
        return await asyncio.shield(reading)
    finally:
        await asyncio.wait([reading])


async def read_in_parts(rows: Iterator[T]) -> AsyncIterator[list[T]]:
    while part := await read_in_thread(lambda: list(islice(rows, RECORDS_AT_ONCE_COUNT))):
        yield part


class Reconciliation:
    """One store against one state; the caller writes the checkpoint."""

    def __init__(
        self,
        store: CustodyStore,
        eraser: Eraser,
        shares: Shares,
        member: bytes,
        placement: Placement,
        facts: ChainFacts,
    ) -> None:
        self._store = store
        self._shares = shares
        self._eraser = eraser
        self._member = member
        self._placement = placement
        self._facts = facts

    async def apply(self) -> None:
        async for batch in read_in_parts(self._facts.active_records()):
            await self._take_records(batch)
        await self._take_restrictions()
        await self._take_shares()
        held = await self._store.background_digests()
        withdrawn = [digest for digest in held if not self._facts.is_empty_frame_approved(digest)]
        await self._eraser.delete_backgrounds(withdrawn)
        async for accesses in read_in_parts(self._facts.accesses()):
            for access in accesses:
                await self._take_access(access)
        async for erasures in read_in_parts(self._facts.erasures()):
            for erasure in erasures:
                await self._take_erasure(erasure)
        await self._eraser.finish()
        async for erasures in read_in_parts(self._facts.erasures()):
            for erasure in erasures:
                await self._settle_erasure(erasure)
        await self.report_expired()

    async def report_expired(self) -> None:
        """Queue reports that expired records await, whoever they were due from."""
        unreported = await read_in_thread(lambda: self._facts.unreported(self._member))
        await self._eraser.report_expired(unreported, self._facts.point.height)

    async def _take_records(self, batch: list[RecordFacts]) -> None:
        clips = await self._store.clips([facts.record_id for facts in batch])
        confirmed: list[RecordFacts] = []
        missing: list[RecordFacts] = []
        for facts in batch:
            clip = clips.get(facts.record_id)
            if clip is not None and clip.status == "staged" and matches_roots(clip, facts):
                confirmed.append(replace(facts, erased_frames=()))
            elif clip is not None and clip.status == "staged":
                await self._eraser.drop_staged([facts.record_id])
                missing.append(place(facts, self._member, self._placement))
            elif clip is None:
                missing.append(place(facts, self._member, self._placement))
        await self._store.apply(BlockEffects(confirmed=tuple(confirmed), missing=tuple(missing)))

    async def _take_restrictions(self) -> None:
        restrictions = {row.owner: row for row in await read_in_thread(lambda: list(self._facts.visit_restrictions()))}
        for owner, before in (await self._store.visit_restrictions()).items():
            now = restrictions.get(owner, VisitRestrictions(owner))
            now = structs.replace(now, narrowed_height=max(before.narrowed_height, now.narrowed_height))
            restrictions[owner] = with_natural_expiries(now, {**dict(before.natural), **dict(now.natural)})
        for row in restrictions.values():
            await apply_restrictions(self._store, row)

    async def _take_shares(self) -> None:
        standing, ended = await read_in_thread(self._facts.shares)
        visit_restrictions = await read_in_thread(lambda: list(self._facts.visit_restrictions()))
        denied = {row.owner for row in visit_restrictions if row.quarantined}
        point = await self._store.checkpoint()
        followed = -1 if point is None else point.height
        meanwhile = {owner: height for owner, height in self._facts.denied_heights().items() if height > followed}
        await self._shares.reconcile(standing, ended, denied, meanwhile)
        at_ms = self._facts.point.timestamp_ms
        shared = {place.record_id async for place in self._store.all_parts()}
        gone = await read_in_thread(lambda: [each for each in sorted(shared) if not self._is_kept(each, at_ms)])
        await self._eraser.destroy_parts(await self._store.parts_of("record_id", gone))

    def _is_kept(self, record_id: bytes, at_ms: int) -> bool:
        record = self._facts.record(record_id)
        return record is not None and record.is_kept(at_ms)

    async def _take_access(self, access: AccessFacts) -> None:
        if await self._store.grant(access.access_id) is None:
            data = {"access_id": access.access_id, "owner": access.owner, "records": list(access.records)}
            data["grant"] = access.share
            await self._replay(access.height, access.access_id, "access", "requested", data)
        if self._member in access.refused or self._member in access.released:
            event_data = {"access_id": access.access_id, "custodian": self._member}
            await self._replay(access.height, access.access_id, "access", "refused", event_data)
        for row in await self._store.outbox_of(RELEASED_KIND, access.access_id):
            record_ids = decode_value(row.arguments)[1]
            if self._facts.has_released(access.access_id, self._member, record_ids):
                released = {"access_id": access.access_id, "custodian": self._member, "records": record_ids}
                await self._replay(access.height, access.access_id, "access", "released", released)

    async def _take_erasure(self, erasure: ErasureFacts) -> None:
        """Erase again even if confirmed: the store may be an old backup."""
        data = {
            "erasure_id": erasure.erasure_id,
            "owner": erasure.owner,
            "records": list(erasure.records),
            "frames": list(erasure.frames),
        }
        await self._replay(erasure.height, erasure.erasure_id, "erasure", "requested", data)

    async def _settle_erasure(self, erasure: ErasureFacts) -> None:
        if self._member in erasure.receipts or self._member not in erasure.custodians:
            event_data = {"erasure_id": erasure.erasure_id, "custodian": self._member}
            await self._replay(erasure.height, erasure.erasure_id, "erasure", "receipted", event_data)

    async def _replay(self, height: int, txid: bytes, contract: str, name: str, data: dict[str, Any]) -> None:
        event = FinalizedEvent(txid, contract, name, data)
        point = self._facts.point
        blocks = [FinalizedEvents(height, point.block_id, point.timestamp_ms, (event,))]
        await BlockApplier(self._store, self._eraser, self._shares, self._member, self._placement, blocks).apply()

"""Brings a custodian's store to what the finalized state says, where there are no blocks to follow.

Must never give up a clip that the state still knows, nor keep one that it does not. A node that joined by snapshot, or
whose store is older than the blocks that its ledger kept, does this once and then follows block by block. Every step is
idempotent and the checkpoint comes last, so that a crash at any moment repeats it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any, TypeVar

from msgspec import structs

from consensus.primitives.encoding import decode_value
from node.custody.block_effects import RELEASED_KIND, BlockApplier, matches_roots
from node.custody.chain_facts import AccessFacts, ChainFacts, ErasureFacts
from node.custody.erasure import Eraser
from node.custody.finalized_events import FinalizedEvent, FinalizedEvents
from node.custody.restrictions import settle, with_natural
from node.custody.shares import Shares
from node.custody.stores.custody_store import BlockEffects, CustodyStore, RecordFacts, VisitRestrictions

RECORDS_AT_ONCE_COUNT = 256

T = TypeVar("T")


async def read_in_thread(read: Callable[[], T]) -> T:
    """Read the state in a thread, so that the event loop goes on. Ends after the reading, also when it is cancelled.

    Whoever opened the state closes it next, and nothing may read it then.
    """
    reading = asyncio.ensure_future(asyncio.to_thread(read))
    try:
        return await asyncio.shield(reading)
    finally:
        await asyncio.wait([reading])


async def read_in_parts(rows: Iterator[T]) -> AsyncIterator[list[T]]:
    """Yield what an iterator over the state yields, in parts that a thread has read."""
    while part := await read_in_thread(lambda: list(islice(rows, RECORDS_AT_ONCE_COUNT))):
        yield part


class Reconciliation:
    """One custodian's store against one version of the state. The checkpoint is the caller's."""

    def __init__(self, store: CustodyStore, eraser: Eraser, shares: Shares, member: bytes, facts: ChainFacts) -> None:
        self._store = store
        self._shares = shares
        self._eraser = eraser
        self._member = member
        self._facts = facts

    async def apply(self) -> None:
        """Take records, what was said of visits, access and erasures into the store, as their blocks would have."""
        async for batch in read_in_parts(self._facts.active_records()):
            await self._take_records(batch)
        await self._take_standings()
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
        """Owe the reports for which expired records still wait, whoever was to say it: nobody else may come to do so."""
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
                missing.append(facts)
            elif clip is None:
                missing.append(facts)
        await self._store.apply(BlockEffects(confirmed=tuple(confirmed), missing=tuple(missing)))

    async def _take_standings(self) -> None:
        """Heed what stands of each visit; what no longer does, because it was lifted meanwhile, is let go.

        Only the store knows of a clip that it keeps longer and the chain no longer does: those expiries are its own.
        """
        standing = {row.owner: row for row in await read_in_thread(lambda: list(self._facts.standings()))}
        for owner, before in (await self._store.standings()).items():
            now = standing.get(owner, VisitRestrictions(owner))
            now = structs.replace(now, narrowed_height=max(before.narrowed_height, now.narrowed_height))
            standing[owner] = with_natural(now, {**dict(before.natural), **dict(now.natural)})
        for row in standing.values():
            await settle(self._store, row)

    async def _take_shares(self) -> None:
        """Heed the grants that stand, and let go of what is held for those that do not, or for records that are gone."""
        standing, ended = await read_in_thread(self._facts.shares)
        standings = await read_in_thread(lambda: list(self._facts.standings()))
        denied = {row.owner for row in standings if row.quarantined}
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
            told = {"access_id": access.access_id, "custodian": self._member}
            await self._replay(access.height, access.access_id, "access", "refused", told)
        for row in await self._store.outbox_of(RELEASED_KIND, access.access_id):
            record_ids = decode_value(row.arguments)[1]
            if self._facts.has_released(access.access_id, self._member, record_ids):
                released = {"access_id": access.access_id, "custodian": self._member, "records": record_ids}
                await self._replay(access.height, access.access_id, "access", "released", released)

    async def _take_erasure(self, erasure: ErasureFacts) -> None:
        """Carry an erasure out, also one that was confirmed before: the store may be an older one put back."""
        data = {
            "erasure_id": erasure.erasure_id,
            "owner": erasure.owner,
            "records": list(erasure.records),
            "frames": list(erasure.frames),
        }
        await self._replay(erasure.height, erasure.erasure_id, "erasure", "requested", data)

    async def _settle_erasure(self, erasure: ErasureFacts) -> None:
        """Owe nothing for an erasure that this custodian has confirmed before, or that was not asked of it."""
        if self._member in erasure.receipts or self._member not in erasure.custodians:
            told = {"erasure_id": erasure.erasure_id, "custodian": self._member}
            await self._replay(erasure.height, erasure.erasure_id, "erasure", "receipted", told)

    async def _replay(self, height: int, txid: bytes, contract: str, name: str, data: dict[str, Any]) -> None:
        """Let one event take effect as if its block had just come."""
        event = FinalizedEvent(txid, contract, name, data)
        point = self._facts.point
        block = FinalizedEvents(height, point.block_id, point.timestamp_ms, (event,))
        await BlockApplier(self._store, self._eraser, self._shares, self._member, block).apply()

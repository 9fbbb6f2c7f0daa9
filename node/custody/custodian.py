"""The custodian: stages clips, and releases or erases exactly as the chain says.

Block effects are idempotent, in chain order, checkpoint last. Data keys are sealed to owners.
"""

from __future__ import annotations

import asyncio
from array import array
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from itertools import islice, takewhile

import structlog

from consensus.errors import BlockRobotError
from consensus.records.clips import ClipDownload, FrameDownload
from consensus.records.placement import Placement
from node.custody.block_effects import BlockApplier, build_release, only_records
from node.custody.chain_facts import ChainFacts
from node.custody.clip_fetching import ClipFetcher, parts_of
from node.custody.erase_keys import ErasableKeys, unwrap_key, wipe_keys, wrap_frames
from node.custody.erasure import Eraser
from node.custody.finalized_events import FinalizedEvents
from node.custody.repair.reconciliation import Reconciliation
from node.custody.restrictions import find_restrictions, is_void, require_release
from node.custody.share_service import ShareService
from node.custody.shares import Shares, grant_covers
from node.custody.stores.custody_store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    CustodyStore,
    FrameRow,
    OutboxRow,
    RecordFacts,
    Unwritten,
    require_written,
)
from node.custody.uploads.upload_queue import UploadQueue
from node.custody.uploads.upload_service import UploadService
from node.process_memory import wipe

LAPSED_AT_ONCE_COUNT = 64
WORDS_DIVISOR = 4
"""What part of what is submitted at once is for words on requests, however many receipts wait."""

_SETTLED_AT_START_COUNT = 10_000
_TELL_SLOTS_COUNT = 100_000

log = structlog.get_logger(__name__)


def _log_slots(count: int) -> None:
    log.info("custody_reads_slots", count=count)


class Custodian(UploadService, ShareService, ClipFetcher):
    """One custodian; `member` is its 33-byte chain key.

    Methods raise STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED; unfinished work continues at the next block.
    """

    def __init__(
        self,
        store: CustodyStore,
        erase_keys: ErasableKeys,
        *,
        member: bytes,
        clock_ms: Callable[[], int],
        has_room: Callable[[int], bool] | None = None,
        is_frame_approved: Callable[[bytes], bool] = lambda _digest: False,
        find_placement: Callable[[], Placement] | None = None,
    ) -> None:
        """`has_room`: whether bytes fit without the disk's reserve; `is_frame_approved`: see `Eraser`; `find_placement`: by
        the newest final state, without it every clip is kept here.
        """
        self._store = store
        self._has_room = has_room or (lambda _size_bytes: True)
        self._keys = erase_keys
        self._eraser = Eraser(store, erase_keys, is_frame_approved)
        self._shares = Shares(store, self._eraser, erase_keys)
        self._member = member
        self._clock_ms = clock_ms
        self._following = asyncio.Lock()  # from a block's first write to its last
        self._writing = asyncio.Lock()
        self._allocating = asyncio.Lock()
        self._uploads = UploadQueue(self._write_uploads)
        self._find_placement = find_placement or (lambda: Placement.even([member], 0))
        self._placed_by: Placement | None = None
        self._placed_up_to: bytes | None = None  # of what is absent, the last record that was sorted; None: all were
        self._point: Checkpoint | None = None
        self._waited_s: dict[str, float] = {}
        self._in_flight: set[int] = set()

    async def start(self, tell: Callable[[int], None] = _log_slots) -> None:
        """Finish interrupted erasures, then drop unreferenced keys. Call once, before serving.

        `tell` is called with how many slots were read of all that are in use.
        """
        await self._eraser.finish()
        in_use = array("Q")  # a few bytes for each frame that is held
        async for slot in self._store.slots_in_use():
            in_use.append(slot)
            if len(in_use) % _TELL_SLOTS_COUNT == 0:
                tell(len(in_use))
        orphans = await asyncio.to_thread(self._keys.reconcile, in_use)
        if orphans:
            log.info("custody_orphan_keys_destroyed", count=orphans)
        async with self._writing:
            await self._settle_missing(await self._store.missing(_SETTLED_AT_START_COUNT))

    # Keeping

    @asynccontextmanager
    async def _taking(self, count: int) -> AsyncIterator[list[tuple[int, bytes]]]:
        """Erase keys for `count` frames, which count as under way; wiped from memory afterwards.

        Not while at rest: a key that is neither named nor under way then is taken for nobody's.
        """
        async with self._allocating:
            taken = await asyncio.to_thread(self._keys.allocate, count)
            slots = [slot for slot, _ in taken]
            self._in_flight.update(slots)
        try:
            yield taken
        finally:
            wipe_keys(taken)
            self._in_flight.difference_update(slots)

    async def _stage(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        """Keys of what was not written are destroyed, and those of what an earlier try left half written.

        Where it raises, all keys stay: the store may hold the rows although it did not answer.
        """
        left = await self._store.frame_places([clip.record_id for clip, _ in clips])
        unwritten = await self._store.stage_all(clips)
        unused = [place.slot for place in left if place.record_id not in unwritten]
        unused += [row.slot for clip, rows in clips if clip.record_id in unwritten for row in rows]
        await self._eraser.destroy_unused(unused)
        return unwritten

    async def _keep_missing(self, found: Sequence[tuple[ClipRow, Sequence[FrameRow], RecordFacts]]) -> Unwritten:
        """Store clips of final records, without the frames that were erased before they came. Keys: as `_stage`."""
        confirmed = [
            (
                replace(
                    clip,
                    txid=facts.txid,
                    status="confirmed",
                    owner=facts.owner,
                    expires_at_ms=facts.expires_at_ms,
                    height=facts.height,
                ),
                [row for row in rows if row.index not in facts.erased_frames],
            )
            for clip, rows, facts in found
        ]
        unwritten = await self._stage(confirmed)
        here = {clip.record_id: clip for clip, _ in confirmed if clip.record_id not in unwritten}
        await self._settle_missing([facts for *_, facts in found], here)
        erased = {row.slot for _, rows, facts in found for row in rows if row.index in facts.erased_frames}
        await self._eraser.destroy_unused(sorted(erased))
        return unwritten

    async def _settle_missing(
        self, missing: Sequence[RecordFacts], clips: Mapping[bytes, ClipRow] | None = None
    ) -> None:
        """Those that are here by now are no longer missing, and are owed to whoever asked for them.

        `clips`: as just stored.
        """
        if not missing:
            return
        if clips is None:
            clips = await self._store.clips([facts.record_id for facts in missing])
        here = [facts for facts in missing if facts.record_id in clips and clips[facts.record_id].status == "confirmed"]
        owners = sorted({facts.owner for facts in here})
        restrictions = await self._store.visit_restrictions(owners)
        own = [  # parts are told of as they come
            grant
            for grant in await self._store.grants_of_owners(owners)
            if not grant.share and not is_void(grant, restrictions.get(grant.owner))
        ]
        unasked = []
        for facts in here:
            clip = clips[facts.record_id]
            grants = [grant for grant in own if grant.owner == facts.owner and grant_covers(grant, clip)]
            if grants:  # alone, since the next one takes the next part of the same request
                owed = tuple([await build_release(self._store, grant, [clip.record_id]) for grant in grants])
                await self._store.apply(BlockEffects(outbox=owed, found=(facts.record_id,)))
            else:
                unasked.append(facts.record_id)
        if unasked:
            await self._store.apply(BlockEffects(found=tuple(unasked)))

    # Upkeep

    def reconciliation(self, facts: ChainFacts) -> Reconciliation:
        """While writing only. Placed by the newest state, as blocks are: what `follow_placement` has sorted stays so."""
        return Reconciliation(self._store, self._eraser, self._shares, self._member, self._newest_placement(), facts)

    def is_keeper(self, placement: Placement, record_id: bytes) -> bool:
        return placement.is_keeper(self._member, record_id)

    @property
    def eraser(self) -> Eraser:
        """Only `at_rest`."""
        return self._eraser

    @asynccontextmanager
    async def at_rest(self) -> AsyncIterator[frozenset[int]]:
        """Keep store and keys unchanged, between blocks; yields the erase-key slots of frames under way."""
        async with self._following, self._writing, self._allocating:
            yield frozenset(self._in_flight)

    # Blocks

    async def on_finalized_block(self, block: FinalizedEvents) -> None:
        """As `on_finalized_blocks`."""
        await self.on_finalized_blocks([block])

    async def on_finalized_blocks(self, blocks: Sequence[FinalizedEvents]) -> None:
        """Apply finalized blocks once, in order; blocks up to the checkpoint are skipped.

        Those that only record are one write. Raises CUSTODY_OUT_OF_ORDER for a gap or another block of its height.
        """
        due = list(blocks)
        async with self._following:
            while due:
                async with self._writing:
                    if not await self._is_next(due[0]):
                        del due[0]
                        continue
                    await self._eraser.finish()
                    taken = await self._record_together(due)
                    if not taken:
                        await self._applier(due[0]).apply()
                if not taken:
                    await self._close_in_turns(due[0].checkpoint)
                del due[: max(taken, 1)]

    async def _close_in_turns(self, point: Checkpoint) -> None:
        """Of many clips that expire together some at a time, so that uploads wait for no more than those.

        Of those that lapse some with each block: nobody waits for their end, and blocks would.
        """
        is_more = True
        while is_more:
            async with self._writing:
                is_more = await self._eraser.erase_some_expired(point.timestamp_ms, point.height)
                if not is_more:
                    await self._drop_some_lapsed(point.timestamp_ms)
                    await self._close_block(point)

    async def _drop_some_lapsed(self, at_ms: int) -> bool:
        """Tell whether there may be more."""
        lapsed = await self._store.lapsed(at_ms, LAPSED_AT_ONCE_COUNT)
        if lapsed:
            await self._eraser.drop_staged(lapsed)
        return len(lapsed) == LAPSED_AT_ONCE_COUNT

    def _applier(self, *blocks: FinalizedEvents) -> BlockApplier:
        return BlockApplier(self._store, self._eraser, self._shares, self._member, self._newest_placement(), blocks)

    async def _record_together(self, blocks: Sequence[FinalizedEvents]) -> int:
        """Write what the first blocks record, if that is all that is due by the last of them; return how many."""
        first = blocks[0].height
        is_plain = partial(only_records, self._member)
        plain = [*takewhile(lambda at: at[1].height == first + at[0] and is_plain(at[1]), enumerate(blocks))]
        if not plain:
            return 0
        point = plain[-1][1].checkpoint
        effects = await self._applier(*(block for _, block in plain)).collect_recorded()
        if effects is None or await self._is_more_due(effects, point.timestamp_ms):
            return 0
        await self._write_checkpoint(replace(effects, checkpoint=point))
        return len(plain)

    async def _is_more_due(self, effects: BlockEffects, at_ms: int) -> bool:
        """Whether by then anything lapses, ends or expires, of what is here and what these effects bring."""
        confirmed = {facts.record_id for facts in effects.confirmed}
        return bool(
            any(facts.expires_at_ms <= at_ms for facts in (*effects.confirmed, *effects.missing))
            or set(await self._store.lapsed(at_ms, LAPSED_AT_ONCE_COUNT)) - confirmed
            or await self._shares.is_any_over(at_ms)
            or await self._store.expired(at_ms, 1)
            or await self._store.missing_over(at_ms)
        )

    async def reconcile(self, facts: ChainFacts) -> None:
        """Bring the store to a finalized state whose blocks are unavailable.

        The next block follows it; states below the checkpoint are skipped.
        """
        point = facts.point
        async with self._following, self._writing:
            known = await self.checkpoint()
            if known is not None and known.height >= point.height:
                return
            await self._eraser.finish()
            await self.reconciliation(facts).apply()
            while await self._drop_some_lapsed(point.timestamp_ms):
                pass
            await self._close_block(point)

    async def report_expired(self, facts: ChainFacts) -> None:
        """Queue expiry reports that a removed custodian may have left pending."""
        async with self._writing:
            await self.reconciliation(facts).report_expired()
            await self._eraser.finish()

    async def _close_block(self, point: Checkpoint) -> None:
        await self._shares.close_block(point.timestamp_ms)
        await self._eraser.erase_expired(point.timestamp_ms, point.height)
        await self._eraser.finish()
        await self._write_checkpoint(BlockEffects(checkpoint=point))

    async def _write_checkpoint(self, effects: BlockEffects) -> None:
        self._point = None  # a failed write may have been done all the same
        await self._store.apply(effects)
        self._point = effects.checkpoint

    async def _is_next(self, block: FinalizedEvents) -> bool:
        point = await self.checkpoint()
        newest = point.height if point is not None else 0
        if point is not None and block.height == newest and block.block_id != point.block_id:
            raise BlockRobotError("CUSTODY_OUT_OF_ORDER", f"The store followed another block of height {newest}.")
        if block.height > newest + 1:
            raise BlockRobotError("CUSTODY_OUT_OF_ORDER", f"Block {block.height} came after block {newest}.")
        return point is None or block.height > newest

    async def checkpoint(self) -> Checkpoint | None:
        """Return the newest applied block; next is one higher (or 0)."""
        if self._point is None:
            self._point = await self._store.checkpoint()
        return self._point

    # What the chain is owed

    async def ready_outbox(self, limit: int) -> list[OutboxRow]:
        """Return transactions to submit, again and again until the chain shows them.

        Oldest erasure and expiry receipts first; some places are for access answers.
        """
        receipts = await self._store.outbox("ready", "erasure", limit)
        words = await self._store.outbox("ready", "access", limit)
        receipts = receipts[: limit - min(len(words), limit // WORDS_DIVISOR)]
        return receipts + words[: limit - len(receipts)]

    async def dismiss(self, row: OutboxRow) -> None:
        """Does nothing if by now something later is owed by the same key."""
        async with self._writing:
            if any(row.is_same_call(owed) for owed in await self._store.outbox_of(row.kind, row.subject)):
                await self._store.remove_outbox(row.key)

    # Release

    async def download(self, record_id: bytes, access_id: bytes, owner: bytes) -> ClipDownload:
        """Return a clip to its owner (33 bytes, session-proven) under a final request.

        Erased frames are empty; altered ones come unchecked. Raises ACCESS_NOT_GRANTED, ACCESS_ENDED, CLIP_QUARANTINED,
        CLIP_ERASED, CLIP_NOT_CONFIRMED (also while fetched), NOT_FOUND.
        """
        grant = await self._store.grant(access_id)
        if grant is None or grant.share or grant.owner != owner or (grant.records and record_id not in grant.records):
            raise BlockRobotError("ACCESS_NOT_GRANTED")
        clip = await self._confirmed_clip(record_id)
        if not grant_covers(grant, clip):
            raise BlockRobotError("ACCESS_NOT_GRANTED")
        rows = await self._store.frames(record_id)
        # After the rows, since a word may have become final while they were read; the keys last, at once: of what was
        # erased meanwhile nothing leaves.
        require_release(grant, await find_restrictions(self._store, owner))
        return self._assemble(clip, rows)

    async def _confirmed_clip(self, record_id: bytes) -> ClipRow:
        clip = (await self._store.clips([record_id])).get(record_id)
        if clip is None:
            facts = (await self._store.missing_clips([record_id])).get(record_id)
            awaited = facts is not None and not facts.elsewhere
            raise BlockRobotError("CLIP_NOT_CONFIRMED" if awaited else "NOT_FOUND", "This custodian has no such clip.")
        if clip.status == "erased":
            raise BlockRobotError("CLIP_ERASED")
        if clip.status == "staged":
            raise BlockRobotError("CLIP_NOT_CONFIRMED")
        return clip

    def _assemble(self, clip: ClipRow, rows: Sequence[FrameRow]) -> ClipDownload:
        known = {row.index: row for row in rows}
        frames = [self._open_frame(index, known.get(index)) for index in range(len(clip.ciphertext_leaves))]
        return ClipDownload(
            record_id=clip.record_id,
            txid=clip.txid,
            frames=frames,
            commitment_leaves=list(clip.commitment_leaves),
            ciphertext_leaves=list(clip.ciphertext_leaves),
        )

    def _open_frame(self, index: int, row: FrameRow | None) -> FrameDownload:
        erase_key = self._keys.read(row.slot) if row is not None else None
        if row is None or erase_key is None:
            return FrameDownload(index=index, erased=True, ciphertext=b"", sealed_key=b"")
        try:
            sealed_key = unwrap_key(erase_key, row.record_id, index, row.wrapped_key)
        except BlockRobotError:
            sealed_key = b""
        finally:
            wipe(erase_key)
        return FrameDownload(index=index, erased=False, ciphertext=row.ciphertext, sealed_key=sealed_key)

    async def holds(self, record_id: bytes) -> bool:
        return record_id in await self._store.clips([record_id])

    async def holds_background(self, digest: bytes) -> bool:
        return await self._store.background(digest) is not None

    async def get_background(self, digest: bytes) -> bytes | None:
        return await self._store.background(digest)

    # Between custodians

    async def export(self, record_id: bytes) -> ClipDownload:
        """Verified by the caller. Raises as `download`.

        Restricted clips may be copied (storage); those of denied visits may not.
        """
        clip = await self._confirmed_clip(record_id)
        rows = await self._store.frames(record_id)
        await self._require_not_denied(clip)  # after the rows and before the keys, as in `download`
        return self._assemble(clip, rows)

    async def require_exportable(self, record_id: bytes) -> None:
        """Raise as `export` if a clip may not go to another custodian."""
        await self._require_not_denied(await self._confirmed_clip(record_id))

    async def _require_not_denied(self, clip: ClipRow) -> None:
        restrictions = await find_restrictions(self._store, clip.owner)
        if restrictions is not None and restrictions.quarantined:
            raise BlockRobotError("CLIP_QUARANTINED")

    async def look_at(self, record_id: bytes) -> ClipDownload:
        """For internal maintenance. Raises as `download`."""
        clip = await self._confirmed_clip(record_id)
        return self._assemble(clip, await self._store.frames(record_id))

    async def missing(self, limit: int) -> list[RecordFacts]:
        return await self._store.missing(limit)

    async def install_checked(self, fetched: Sequence[ClipDownload]) -> int:
        """Store those that are still missing; return how many. The caller checked them against the chain's roots."""
        parts = {clip.record_id: parts_of([frame for frame in clip.frames if not frame.erased]) for clip in fetched}
        async with self._taking(sum(map(len, parts.values()))) as taken:
            left = iter(taken)
            rows = {key: wrap_frames(key, own, list(islice(left, len(own)))) for key, own in parts.items()}
            async with self._writing:
                try:
                    missing = await self._store.missing_clips(list(parts))
                    known = await self._store.clips(list(parts))
                except BlockRobotError:
                    await self._eraser.destroy_unused([slot for slot, _ in taken])
                    raise
                found = [
                    (_fetched_row(clip), rows[clip.record_id], missing[clip.record_id])
                    for clip in fetched
                    if clip.record_id in missing and clip.record_id not in known
                ]
                kept = {clip.record_id for clip, *_ in found}
                await self._eraser.destroy_unused(
                    [row.slot for key in sorted(parts.keys() - kept) for row in rows[key]]
                )
                await self._settle_missing([facts for key, facts in missing.items() if key in known])
                if found:
                    require_written(await self._keep_missing(found))
        return len(found)


def _fetched_row(fetched: ClipDownload) -> ClipRow:
    leaves = (tuple(fetched.commitment_leaves), tuple(fetched.ciphertext_leaves))
    return ClipRow(fetched.record_id, fetched.txid, 0, "staged", *leaves)

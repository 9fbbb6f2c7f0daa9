"""The custodian: keeps staged clips, follows the finalized chain, releases and erases as it says. Must never act on less.

Everything that a block changes is in effect exactly once: effects are idempotent, come in the order of the chain, and
the checkpoint is written last. What the custodian owes the chain (releases, receipts) lies in its outbox until the
chain shows it. A custodian cannot open what it keeps: data keys are sealed to owners.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from types import MappingProxyType

import structlog

from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.hashing import sha256
from consensus.records.clips import ClipDownload, ClipUpload, FrameDownload, check_clip_download, check_clip_upload
from consensus.records.commitments import ciphertext_leaves
from node.custody.block_effects import BlockApplier, build_release, matches_roots
from node.custody.chain_facts import ChainFacts
from node.custody.clip_fetching import MISSING_READ_COUNT, Fetching
from node.custody.erase_keys import ErasableKeys, unwrap_key
from node.custody.erasure import Eraser
from node.custody.finalized_events import FinalizedEvents
from node.custody.frame_wrapping import parts_of, wipe_keys, wrap_frames
from node.custody.repair.reconciliation import Reconciliation
from node.custody.restrictions import find_standing, is_void, require_release
from node.custody.share_service import ShareService
from node.custody.shares import CLOCK_SLACK_MS, Shares, grant_covers, may_release
from node.custody.stores.custody_store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    CustodyStore,
    FrameRow,
    OutboxRow,
    RecordFacts,
)
from node.custody.uploads import DayUse, UploadTerms, Use, require_quota_of
from node.process_memory import wipe

LAPSED_AT_ONCE_COUNT = 64
WORDS_DIVISOR = 4
"""What part of what is submitted at once is for words on requests, however many receipts wait."""

log = structlog.get_logger(__name__)


class Custodian(ShareService, Fetching):
    """One custodian over its store and its erase keys.

    `member` is its own key on the chain (33 bytes), by which it knows its receipts again; `clock_ms` is the node's wall
    clock. Every method raises STORE_UNAVAILABLE if the store does not answer and ERASE_KEYS_DAMAGED if the file of
    erase keys fails; after either, what was begun is finished at the next block or start.
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
    ) -> None:
        """`has_room` tells whether so many bytes fit without using the disk's reserve. For the last see `Eraser`."""
        self._store = store
        self._has_room = has_room or (lambda _size_bytes: True)
        self._keys = erase_keys
        self._eraser = Eraser(store, erase_keys, is_frame_approved)
        self._shares = Shares(store, self._eraser, erase_keys)
        self._member = member
        self._clock_ms = clock_ms
        self._writing = asyncio.Lock()
        self._asked_for: set[bytes] = set()
        self._in_flight: set[int] = set()

    async def start(self) -> None:
        """Finish what a crash cut off: erasures first, then keys to which nothing refers. Call once, before serving."""
        await self._eraser.finish()
        in_use = [slot async for slot in self._store.slots_in_use()]
        orphans = await asyncio.to_thread(self._keys.reconcile, in_use)
        if orphans:
            log.info("custody_orphan_keys_destroyed", count=orphans)
        async with self._writing:
            for facts in await self._store.missing(MISSING_READ_COUNT):
                await self._settle_missing(facts)

    # Uploads

    async def stage(self, upload: ClipUpload, terms: UploadTerms | None = None) -> None:
        """Keep an uploaded clip until its record is final; the same bytes again are accepted again.

        A clip whose record is final already is confirmed at once. With `terms` it counts for its robot, and has to fit
        the quotas. Raises UPLOAD_INVALID for wrong sizes or an expiry too far ahead, UPLOAD_CONFLICT for other bytes
        under this id, UPLOAD_HASH_MISMATCH if the chain's roots are others, CLIP_ERASED, TRANSACTION_EXPIRED,
        UPLOAD_QUOTA_EXCEEDED.
        """
        check_clip_upload(upload)
        leaves = await asyncio.to_thread(ciphertext_leaves, upload.ciphertexts, upload.sealed_keys)
        clip = ClipRow(
            record_id=upload.record_id,
            txid=upload.txid,
            valid_until_ms=upload.valid_until_ms,
            status="staged",
            commitment_leaves=tuple(upload.commitment_leaves),
            ciphertext_leaves=tuple(leaves),
            robot=b"" if terms is None else terms.robot,
            size_bytes=upload.size_bytes,
        )
        if await self._is_known(clip):
            async with self._writing:
                facts = await self._store.missing_clip(clip.record_id)
                if facts is not None:
                    await self._settle_missing(facts)
            return
        await self._check_in_time(clip)
        await self.require_quota(clip.size_bytes, terms)  # before any key is made for it, which is flushed to the disk
        await self._find_missing(clip)
        pairs = list(enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True)))
        await self._keep(clip, [(index, text, key) for index, (text, key) in pairs], terms)

    async def _is_known(self, clip: ClipRow) -> bool:
        known = (await self._store.clips([clip.record_id])).get(clip.record_id)
        if known is None:
            return False
        if known.status == "erased":
            raise BlockRobotError("CLIP_ERASED", "The record of this clip is erased; it is not kept again.")
        if (known.commitment_leaves, known.ciphertext_leaves) != (clip.commitment_leaves, clip.ciphertext_leaves):
            raise BlockRobotError("UPLOAD_CONFLICT")
        if known.status == "staged" and clip.valid_until_ms > known.valid_until_ms:
            await self._check_in_time(clip)
            await self._store.extend_staged(clip.record_id, clip.txid, clip.valid_until_ms)
        return True

    async def _find_missing(self, clip: ClipRow) -> RecordFacts | None:
        """Return the record that waits for a clip, or None. Raises UPLOAD_HASH_MISMATCH if it commits to another one."""
        facts = await self._store.missing_clip(clip.record_id)
        if facts is not None and not matches_roots(clip, facts):
            raise BlockRobotError("UPLOAD_HASH_MISMATCH", "The clip is not the one that its record commits to.")
        return facts

    async def _check_in_time(self, clip: ClipRow) -> None:
        point = await self._store.checkpoint()
        # A clock that is behind the chain is wrong; nobody's upload is refused for it.
        now_ms = max(self._clock_ms(), 0 if point is None else point.timestamp_ms)
        if clip.valid_until_ms > now_ms + TRANSACTION_LIFETIME_MAX_MS + CLOCK_SLACK_MS:
            raise BlockRobotError("UPLOAD_INVALID", "The transaction's expiry is more than ten minutes ahead.")
        late = point is not None and clip.valid_until_ms <= point.timestamp_ms
        if late and await self._store.missing_clip(clip.record_id) is None:
            raise BlockRobotError("TRANSACTION_EXPIRED", "The record's transaction can no longer become final.")

    async def require_quota(
        self, size_bytes: int, terms: UploadTerms | None, in_flight: Mapping[bytes, Use] = MappingProxyType({})
    ) -> int:
        """Return the day for which an upload counts, beside those `in_flight`. Raises UPLOAD_QUOTA_EXCEEDED."""
        point = await self._store.checkpoint()
        now_ms = 0 if point is None else point.timestamp_ms
        return await require_quota_of(self._store, size_bytes, terms, now_ms, in_flight)

    async def _keep(
        self, clip: ClipRow, frames: Sequence[tuple[int, bytes, bytes]], terms: UploadTerms | None = None
    ) -> bool:
        """Wrap the keys of (index, ciphertext, sealed key) and keep the clip; False if it was known meanwhile."""
        taken = await asyncio.to_thread(self._keys.allocate, len(frames))
        slots = [slot for slot, _ in taken]
        self._in_flight.update(slots)
        try:
            return await self._keep_under(clip, frames, taken, terms)
        finally:
            wipe_keys(taken)
            self._in_flight.difference_update(slots)

    async def _keep_under(
        self,
        clip: ClipRow,
        frames: Sequence[tuple[int, bytes, bytes]],
        taken: Sequence[tuple[int, bytes]],
        terms: UploadTerms | None,
    ) -> bool:
        rows = wrap_frames(clip.record_id, frames, taken)
        slots = [slot for slot, _ in taken]
        async with self._writing:
            try:
                known = await self._is_known(clip)
                facts = await self._find_missing(clip)
                day = 0 if known else await self.require_quota(clip.size_bytes, terms)
            except BlockRobotError:
                await self._eraser.destroy_unused(slots)
                raise
            if known:
                await self._eraser.destroy_unused(slots)
                if facts is not None:
                    await self._settle_missing(facts)
                return False
            if terms is not None:
                await self._store.add_use(DayUse(day, clip.robot, clip.size_bytes))
            # From here on a failure leaves the slots alone: the store may hold the rows although it did not answer.
            if facts is None:
                await self._store.stage(clip, rows)
            else:
                await self._keep_missing(clip, rows, facts)
                erased = {row.slot for row in rows if row.index in facts.erased_frames}
                await self._eraser.destroy_unused(sorted(erased))
        return True

    async def _keep_missing(self, clip: ClipRow, rows: Sequence[FrameRow], facts: RecordFacts) -> None:
        kept = [row for row in rows if row.index not in facts.erased_frames]
        confirmed = replace(
            clip,
            txid=facts.txid,
            status="confirmed",
            owner=facts.owner,
            expires_at_ms=facts.expires_at_ms,
            height=facts.height,
        )
        await self._store.stage(confirmed, kept)
        await self._settle_missing(facts)

    async def _settle_missing(self, facts: RecordFacts) -> None:
        """Owe the releases of a clip that is here now, and call it missing no more. Nothing happens while it is away.

        Done again when the store failed, or the node stopped, between the clip's rows and these.
        """
        clip = (await self._store.clips([facts.record_id])).get(facts.record_id)
        if clip is None or clip.status != "confirmed":
            return
        standing = await find_standing(self._store, facts.owner)
        asked = [grant for grant in await self._store.grants_of_owner(facts.owner) if not is_void(grant, standing)]
        covering = [grant for grant in asked if grant_covers(grant, clip)]
        grants = [grant for grant in covering if await may_release(self._store, grant, clip.record_id)]
        owed = tuple([await build_release(self._store, grant, [clip.record_id]) for grant in grants])
        await self._store.apply(BlockEffects(outbox=owed, confirmed=(facts,)))

    # Upkeep

    def reconciliation(self, facts: ChainFacts) -> Reconciliation:
        """Return what brings this custodian's store to a state; only `at_rest`."""
        return Reconciliation(self._store, self._eraser, self._shares, self._member, facts)

    @property
    def eraser(self) -> Eraser:
        """What erases in this custodian's store; only `at_rest`."""
        return self._eraser

    @asynccontextmanager
    async def at_rest(self) -> AsyncIterator[frozenset[int]]:
        """Let nothing change the store meanwhile; yields the slots of erase keys whose frames are still on their way."""
        async with self._writing:
            yield frozenset(self._in_flight)

    async def mend(self, fetched: ClipDownload, read_facts: Callable[[], RecordFacts | None]) -> bool:
        """Put another custodian's whole copy in the place of a confirmed clip whose bytes are damaged or partly gone.

        `read_facts` says what the chain has of the record now, None if nothing is to be kept. The old keys go after the
        new rows are there. False if the copy lacks frames too, or nothing is to be mended any more. Raises as
        `install` for a copy that is not sound.
        """
        taken = await asyncio.to_thread(self._keys.allocate, len(fetched.frames))
        slots = [slot for slot, _ in taken]
        self._in_flight.update(slots)
        try:
            async with self._writing:
                unused = await self._mend_under(fetched, read_facts(), taken)
                await self._eraser.destroy_unused(unused)
        finally:
            wipe_keys(taken)
            self._in_flight.difference_update(slots)
        return not set(slots) <= set(unused)

    async def _mend_under(
        self, fetched: ClipDownload, facts: RecordFacts | None, taken: Sequence[tuple[int, bytes]]
    ) -> list[int]:
        """Return the slots that nothing refers to afterwards: the old ones, or all the new ones if nothing was done."""
        slots = [slot for slot, _ in taken]
        clip = (await self._store.clips([fetched.record_id])).get(fetched.record_id)
        if facts is None or clip is None or clip.status != "confirmed":
            return slots
        if check_clip_download(fetched, facts.commitment_root, facts.ciphertext_root):
            await self._eraser.destroy_unused(slots)
            raise BlockRobotError("UPLOAD_HASH_MISMATCH", "The other custodian's copy is damaged too.")
        present = [frame for frame in fetched.frames if frame.index not in facts.erased_frames]
        if any(frame.erased for frame in present):
            return slots
        old = [place.slot for place in await self._store.frame_places([clip.record_id])]
        used = taken[: len(present)]
        await self._store.replace_frames(clip.record_id, wrap_frames(clip.record_id, parts_of(present), used))
        return old if len(used) == len(taken) else [*old, *slots[len(used) :]]

    # Blocks

    async def on_finalized_block(self, block: FinalizedEvents) -> None:
        """Bring a finalized block into effect, once: blocks up to the checkpoint are passed over.

        Raises CUSTODY_OUT_OF_ORDER if the block does not follow the checkpoint, or is another block of its height.
        """
        async with self._writing:
            if not await self._is_next(block):
                return
            await self._eraser.finish()
            await BlockApplier(self._store, self._eraser, self._shares, self._member, block).apply()
            await self._close_block(block.checkpoint)

    async def reconcile(self, facts: ChainFacts) -> None:
        """Bring the store to what a finalized state says, where the blocks up to it are not there to follow.

        Afterwards the block above is the next one. A state below the checkpoint is passed over.
        """
        point = facts.point
        async with self._writing:
            known = await self._store.checkpoint()
            if known is not None and known.height >= point.height:
                return
            await self._eraser.finish()
            await Reconciliation(self._store, self._eraser, self._shares, self._member, facts).apply()
            await self._close_block(point)

    async def report_expired(self, facts: ChainFacts) -> None:
        """Owe the reports for which expired records still wait, after a custodian was removed that may have owed them."""
        async with self._writing:
            await self.reconciliation(facts).report_expired()
            await self._eraser.finish()

    async def _close_block(self, point: Checkpoint) -> None:
        """Do what time demands at a block: drop what lapsed, erase what expired; then write the checkpoint."""
        while lapsed := await self._store.lapsed(point.timestamp_ms, LAPSED_AT_ONCE_COUNT):
            await self._eraser.drop_staged(lapsed)
        await self._shares.close_block(point.timestamp_ms)
        await self._eraser.erase_expired(point.timestamp_ms, point.height)
        await self._eraser.finish()
        await self._store.apply(BlockEffects(checkpoint=point))

    async def _is_next(self, block: FinalizedEvents) -> bool:
        point = await self._store.checkpoint()
        newest = point.height if point is not None else 0
        if point is not None and block.height == newest and block.block_id != point.block_id:
            raise BlockRobotError("CUSTODY_OUT_OF_ORDER", f"The store followed another block of height {newest}.")
        if block.height > newest + 1:
            raise BlockRobotError("CUSTODY_OUT_OF_ORDER", f"Block {block.height} came after block {newest}.")
        return point is None or block.height > newest

    async def checkpoint(self) -> Checkpoint | None:
        """Return the newest block whose effects are in the store; the next one to hand in is one higher (or 0)."""
        return await self._store.checkpoint()

    # What the chain is owed

    async def owed(self, limit: int) -> list[OutboxRow]:
        """Return transactions to submit; they stay until the chain shows them, so submitting repeats.

        Receipts of erasures and expiries come first, oldest first, but leave a part of the places to words on requests.
        """
        receipts = await self._store.outbox("ready", "erasure", limit)
        words = await self._store.outbox("ready", "access", limit)
        receipts = receipts[: limit - min(len(words), limit // WORDS_DIVISOR)]
        return receipts + words[: limit - len(receipts)]

    async def dismiss(self, row: OutboxRow) -> None:
        """Forget a transaction that the chain refuses for good, because it says what the chain knows already."""
        await self._store.remove_outbox(row.key)

    # Release

    async def download(self, record_id: bytes, access_id: bytes, owner: bytes) -> ClipDownload:
        """Return a clip to its owner (33 bytes, proven by her session) under a final access request of hers.

        Erased frames keep their places, without bytes; one whose row was changed comes as it is, for her to judge.
        Raises ACCESS_NOT_GRANTED, ACCESS_ENDED, CLIP_QUARANTINED, CLIP_ERASED, CLIP_NOT_CONFIRMED (also while it is
        fetched), NOT_FOUND.
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
        require_release(grant, await find_standing(self._store, owner))
        return self._assemble(clip, rows)

    async def _confirmed_clip(self, record_id: bytes) -> ClipRow:
        clip = (await self._store.clips([record_id])).get(record_id)
        if clip is None:
            missing = await self._store.missing_clip(record_id) is not None
            raise BlockRobotError("CLIP_NOT_CONFIRMED" if missing else "NOT_FOUND", "This custodian has no such clip.")
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

    async def put_background(
        self, digest: bytes, content: bytes, terms: UploadTerms | None, require_approved: Callable[[], None]
    ) -> None:
        """Keep an empty frame under its SHA-256; with `terms` it counts for its robot's day.

        `require_approved` is asked while no block is brought into effect, so that a withdrawal comes before or after.
        Raises UPLOAD_HASH_MISMATCH if it has another hash, UPLOAD_QUOTA_EXCEEDED.
        """
        if sha256(content) != digest:
            raise BlockRobotError("UPLOAD_HASH_MISMATCH")
        async with self._writing:
            require_approved()
            if await self._store.background(digest) is not None:
                return
            if terms is not None:
                day = await self.require_quota(len(content), terms)
                await self._store.add_use(DayUse(day, terms.robot, len(content)))
            await self._store.put_background(digest, content)

    async def holds(self, record_id: bytes) -> bool:
        """Tell whether a clip of this id is here, or was."""
        return record_id in await self._store.clips([record_id])

    async def holds_background(self, digest: bytes) -> bool:
        """Tell whether an empty frame is here."""
        return await self._store.background(digest) is not None

    async def get_background(self, digest: bytes) -> bytes | None:
        """Return an empty frame, or None."""
        return await self._store.background(digest)

    # Between custodians

    async def export(self, record_id: bytes) -> ClipDownload:
        """Return a confirmed clip for another custodian (the caller has checked that it is one). Raises as `download`.

        A restricted clip may be copied, since that is storing it; one of a denied visit stays where it is.
        """
        clip = await self._confirmed_clip(record_id)
        rows = await self._store.frames(record_id)
        await self.require_exportable(record_id)  # after the rows and before the keys, as in `download`
        return self._assemble(clip, rows)

    async def require_exportable(self, record_id: bytes) -> None:
        """Raise as `export` if a clip may not leave for another custodian now."""
        clip = await self._confirmed_clip(record_id)
        standing = await find_standing(self._store, clip.owner)
        if standing is not None and standing.quarantined:
            raise BlockRobotError("CLIP_QUARANTINED")

    async def look_at(self, record_id: bytes) -> ClipDownload:
        """Return a confirmed clip as it is, for this custodian's own upkeep. Raises as `download`."""
        clip = await self._confirmed_clip(record_id)
        return self._assemble(clip, await self._store.frames(record_id))

    async def missing(self, limit: int) -> list[RecordFacts]:
        """Return clips that the chain has and this custodian has not, the newest first."""
        return await self._store.missing(limit)

    async def install(self, fetched: ClipDownload) -> bool:
        """Keep a missing clip that another custodian sent; False if it is not missing (any more).

        Raises PROOF_INVALID if its leaves do not lead to the roots on the chain, UPLOAD_HASH_MISMATCH if its bytes do
        not make its leaves, UPLOAD_INVALID for a wrong form.
        """
        facts = await self._store.missing_clip(fetched.record_id)
        if facts is None:
            return False
        damaged = check_clip_download(fetched, facts.commitment_root, facts.ciphertext_root)
        if damaged:
            raise BlockRobotError("UPLOAD_HASH_MISMATCH", f"Frames {damaged} of the fetched clip are damaged.")
        clip = ClipRow(
            record_id=facts.record_id,
            txid=facts.txid,
            valid_until_ms=0,
            status="staged",
            commitment_leaves=tuple(fetched.commitment_leaves),
            ciphertext_leaves=tuple(fetched.ciphertext_leaves),
        )
        present = [frame for frame in fetched.frames if not frame.erased and frame.index not in facts.erased_frames]
        return await self._keep(clip, parts_of(present))

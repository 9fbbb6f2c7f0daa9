"""Takes robots' uploads; a mixin of `Custodian`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from types import MappingProxyType
from typing import TYPE_CHECKING

from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.hashing import sha256
from consensus.records.clips import ClipUpload, check_clip_upload
from consensus.records.commitments import ciphertext_leaves
from node.custody.block_effects import matches_roots
from node.custody.erase_keys import wrap_frames
from node.custody.erasure import Eraser
from node.custody.shares import CLOCK_SLACK_MS
from node.custody.stores.custody_store import Checkpoint, ClipRow, CustodyStore, FrameRow, RecordFacts, Unwritten
from node.custody.uploads.upload_queue import PendingUpload, UploadQueue
from node.custody.uploads.upload_usage import DayUse, UploadTerms, Use, find_day, require_quota


class UploadService:
    """Uploads of clips and of empty frames, within quotas."""

    if TYPE_CHECKING:  # the custodian's own
        _store: CustodyStore
        _eraser: Eraser
        _uploads: UploadQueue
        _clock_ms: Callable[[], int]
        _writing: asyncio.Lock

        async def checkpoint(self) -> Checkpoint | None: ...

        def _taking(self, count: int) -> AbstractAsyncContextManager[list[tuple[int, bytes]]]: ...

        async def _stage(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten: ...

        async def _keep_missing(
            self, found: Sequence[tuple[ClipRow, Sequence[FrameRow], RecordFacts]]
        ) -> Unwritten: ...

        async def _settle_missing(self, missing: Sequence[RecordFacts]) -> None: ...

    async def stage(self, upload: ClipUpload, terms: UploadTerms | None = None, *, is_new: bool = True) -> None:
        """Store a clip until its record is final, or confirm at once. Idempotent.

        With `terms` it counts for its robot's quotas. `is_new`: room was kept for it. Raises UPLOAD_INVALID (sizes,
        expiry), UPLOAD_CONFLICT, UPLOAD_HASH_MISMATCH, CLIP_ERASED, TRANSACTION_EXPIRED, UPLOAD_QUOTA_EXCEEDED.
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
        known, facts = await self._look_up(clip.record_id)
        if known is not None:
            _require_same(clip, known)
            if await self._keep_again(clip):
                return
        if not is_new:
            raise BlockRobotError(
                "STORE_UNAVAILABLE", "The clip was dropped while it was brought again; send it again."
            )
        await self._require_in_time(clip, facts)
        await self.require_quota(clip.size_bytes, terms)  # before any key is made for it, which is flushed to the disk
        _require_awaited(clip, facts)
        pairs = enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True))
        async with self._taking(len(leaves)) as taken:
            rows = wrap_frames(clip.record_id, [(index, text, key) for index, (text, key) in pairs], taken)
            await self._uploads.keep(PendingUpload(clip, rows, terms), self._writing)

    async def _look_up(self, record_id: bytes) -> tuple[ClipRow | None, RecordFacts | None]:
        """What is here of it, and what is awaited."""
        known, awaited = await self._store.clips([record_id]), await self._store.missing_clips([record_id])
        return known.get(record_id), awaited.get(record_id)

    async def _keep_again(self, clip: ClipRow) -> bool:
        """Whether it is here; it may have been dropped since somebody saw it."""
        async with self._writing:
            known, facts = await self._look_up(clip.record_id)
            if known is None:
                return False
            await self._keep_known(clip, known, facts)
            await self._settle_missing([] if facts is None else [facts])
        return True

    async def _keep_known(self, clip: ClipRow, known: ClipRow, facts: RecordFacts | None) -> None:
        """While writing only."""
        _require_same(clip, known)
        if known.status == "staged" and clip.valid_until_ms > known.valid_until_ms:
            await self._require_in_time(clip, facts)
            await self._store.extend_staged(clip.record_id, clip.txid, clip.valid_until_ms)

    async def _require_in_time(self, clip: ClipRow, facts: RecordFacts | None) -> None:
        block_ms = await self._block_time_ms()
        # A clock that is behind the chain is wrong; nobody's upload is refused for it.
        now_ms = max(self._clock_ms(), block_ms)
        if clip.valid_until_ms > now_ms + TRANSACTION_LIFETIME_MAX_MS + CLOCK_SLACK_MS:
            raise BlockRobotError("UPLOAD_INVALID", "The transaction's expiry is more than ten minutes ahead.")
        if clip.valid_until_ms <= block_ms and facts is None:
            raise BlockRobotError("TRANSACTION_EXPIRED", "The record's transaction can no longer become final.")

    async def require_quota(
        self, size_bytes: int, terms: UploadTerms | None, in_flight: Mapping[bytes, Use] = MappingProxyType({})
    ) -> None:
        """Beside those `in_flight`; no check without `terms`. Raises UPLOAD_QUOTA_EXCEEDED."""
        if terms is not None:
            staged, days = await self._store.use_by_robot("staged"), await self._store.day_uses()
            require_quota(size_bytes, terms, staged, days, await self._block_time_ms(), in_flight)

    async def _add_use(self, robot: bytes, size_bytes: int) -> None:
        await self._store.add_use(DayUse(find_day(await self._block_time_ms()), robot, size_bytes))

    async def _block_time_ms(self) -> int:
        point = await self.checkpoint()
        return 0 if point is None else point.timestamp_ms

    async def _write_uploads(self, uploads: Sequence[PendingUpload]) -> None:
        """Of what is surely not written the keys are destroyed, and it is not counted."""
        new = dict[PendingUpload, RecordFacts | None]()
        try:
            new = await self._let_in(uploads)
        finally:
            await self._eraser.destroy_unused(
                [slot for upload in uploads if upload not in new for slot in upload.slots]
            )
        staged = [(upload.clip, upload.rows) for upload, facts in new.items() if facts is None]
        awaited = [(upload.clip, upload.rows, facts) for upload, facts in new.items() if facts is not None]
        unwritten = {
            **(await self._stage(staged) if staged else {}),
            **(await self._keep_missing(awaited) if awaited else {}),
        }
        refused = [upload for upload in new if upload.clip.record_id in unwritten]
        for upload in refused:
            upload.refusal = unwritten[upload.clip.record_id]
        for robot, use in sorted(_sum_uses(refused).items()):
            await self._add_use(robot, -use.size_bytes)

    async def _let_in(self, uploads: Sequence[PendingUpload]) -> dict[PendingUpload, RecordFacts | None]:
        """Count and return the new ones, with what is awaited; the others are refused, or were here already."""
        record_ids = [upload.clip.record_id for upload in uploads]
        known, awaited = await self._store.clips(record_ids), await self._store.missing_clips(record_ids)
        staged, days = await self._store.use_by_robot("staged"), await self._store.day_uses()
        block_ms = await self._block_time_ms()
        new, here = dict[PendingUpload, RecordFacts | None](), list[RecordFacts]()
        for upload in uploads:
            clip, facts = upload.clip, awaited.get(upload.clip.record_id)
            try:
                _require_awaited(clip, facts)
                if (held := known.get(clip.record_id)) is not None:
                    await self._keep_known(clip, held, facts)
                    here += [] if facts is None else [facts]
                    continue
                if upload.terms is not None:
                    require_quota(clip.size_bytes, upload.terms, staged, days, block_ms, _sum_uses(new))
            except BlockRobotError as refusal:
                upload.refusal = refusal
            else:
                new[upload] = facts
        await self._settle_missing(here)
        for robot, use in sorted(_sum_uses(new).items()):
            await self._add_use(robot, use.size_bytes)
        return new

    async def put_background(
        self, digest: bytes, content: bytes, terms: UploadTerms | None, require_approved: Callable[[], None]
    ) -> None:
        """Store an empty frame under its SHA-256; `terms` count for the robot's day.

        `require_approved` runs between blocks, never during a withdrawal. Raises UPLOAD_HASH_MISMATCH,
        UPLOAD_QUOTA_EXCEEDED.
        """
        if sha256(content) != digest:
            raise BlockRobotError("UPLOAD_HASH_MISMATCH")
        async with self._writing:
            require_approved()
            if await self._store.background(digest) is not None:
                return
            if terms is not None:
                await self.require_quota(len(content), terms)
                await self._add_use(terms.robot, len(content))
            await self._store.put_background(digest, content)


def _require_same(clip: ClipRow, known: ClipRow) -> None:
    """Raises CLIP_ERASED, UPLOAD_CONFLICT."""
    if known.status == "erased":
        raise BlockRobotError("CLIP_ERASED", "The record of this clip is erased; it is not kept again.")
    if (known.commitment_leaves, known.ciphertext_leaves) != (clip.commitment_leaves, clip.ciphertext_leaves):
        raise BlockRobotError("UPLOAD_CONFLICT")


def _require_awaited(clip: ClipRow, facts: RecordFacts | None) -> None:
    """Raises UPLOAD_HASH_MISMATCH."""
    if facts is not None and not matches_roots(clip, facts):
        raise BlockRobotError("UPLOAD_HASH_MISMATCH", "The clip is not the one that its record commits to.")


def _sum_uses(uploads: Iterable[PendingUpload]) -> dict[bytes, Use]:
    found = dict[bytes, Use]()
    for upload in uploads:
        if upload.terms is not None:
            robot = upload.clip.robot
            found[robot] = found.get(robot, Use()) + Use(1, upload.clip.size_bytes)
    return found

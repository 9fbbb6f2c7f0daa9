"""Takes robots' uploads; a mixin of `Custodian`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
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
from node.custody.stores.custody_store import Checkpoint, ClipRow, CustodyStore, FrameRow, RecordFacts
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

        async def _stage(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> None: ...

        async def _keep_missing(self, found: Sequence[tuple[ClipRow, Sequence[FrameRow], RecordFacts]]) -> None: ...

        async def _settle_missing(self, missing: Sequence[RecordFacts]) -> None: ...

    async def stage(self, upload: ClipUpload, terms: UploadTerms | None = None) -> None:
        """Store a clip until its record is final, or confirm at once. Idempotent.

        With `terms` it counts for its robot's quotas. Raises UPLOAD_INVALID (sizes, expiry), UPLOAD_CONFLICT,
        UPLOAD_HASH_MISMATCH, CLIP_ERASED, TRANSACTION_EXPIRED, UPLOAD_QUOTA_EXCEEDED.
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
                await self._settle_missing(list((await self._store.missing_clips([clip.record_id])).values()))
            return
        await self._check_in_time(clip)
        await self.require_quota(clip.size_bytes, terms)  # before any key is made for it, which is flushed to the disk
        await self._find_missing(clip)
        pairs = enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True))
        async with self._taking(len(leaves)) as taken:
            rows = wrap_frames(clip.record_id, [(index, text, key) for index, (text, key) in pairs], taken)
            await self._uploads.keep(PendingUpload(clip, rows, terms), self._writing)

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
        """Raises UPLOAD_HASH_MISMATCH."""
        facts = (await self._store.missing_clips([clip.record_id])).get(clip.record_id)
        if facts is not None and not matches_roots(clip, facts):
            raise BlockRobotError("UPLOAD_HASH_MISMATCH", "The clip is not the one that its record commits to.")
        return facts

    async def _check_in_time(self, clip: ClipRow) -> None:
        block_ms = await self._block_time_ms()
        # A clock that is behind the chain is wrong; nobody's upload is refused for it.
        now_ms = max(self._clock_ms(), block_ms)
        if clip.valid_until_ms > now_ms + TRANSACTION_LIFETIME_MAX_MS + CLOCK_SLACK_MS:
            raise BlockRobotError("UPLOAD_INVALID", "The transaction's expiry is more than ten minutes ahead.")
        if clip.valid_until_ms <= block_ms and not await self._store.missing_clips([clip.record_id]):
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

    async def _keep_uploads(self, uploads: Sequence[PendingUpload]) -> None:
        in_flight, unused, here = dict[bytes, Use](), list[int](), list[RecordFacts]()
        staged, missing = list[PendingUpload](), list[tuple[PendingUpload, RecordFacts]]()
        for upload in uploads:
            clip = upload.clip
            try:
                is_known = await self._is_known(clip)
                facts = await self._find_missing(clip)
                if not is_known:
                    await self.require_quota(clip.size_bytes, upload.terms, in_flight)
            except BlockRobotError as refusal:
                upload.refusal = refusal
                unused += upload.slots
                continue
            if is_known:
                unused += upload.slots
                here += [] if facts is None else [facts]
                continue
            if upload.terms is not None:
                in_flight[clip.robot] = in_flight.get(clip.robot, Use()) + Use(1, clip.size_bytes)
            if facts is None:
                staged.append(upload)
            else:
                missing.append((upload, facts))
        await self._eraser.destroy_unused(unused)
        await self._settle_missing(here)
        for robot in sorted(in_flight):
            await self._add_use(robot, in_flight[robot].size_bytes)
        # From here on a failure leaves the slots alone: the store may hold the rows although it did not answer.
        if staged:
            await self._stage([(upload.clip, upload.rows) for upload in staged])
        if missing:
            await self._keep_missing([(upload.clip, upload.rows, facts) for upload, facts in missing])

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

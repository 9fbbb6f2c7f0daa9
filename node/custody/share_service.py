"""Serves clients' shares; a mixin of `Custodian`.

Parts leave without the owner's sealed key, only to grantees the caller verified.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from functools import partial
from typing import TYPE_CHECKING

from consensus.errors import BlockRobotError
from consensus.records.clips import ClipDownload
from consensus.records.sharing import (
    GrantUpload,
    SharedDownload,
    SharedRequest,
    build_shared_download,
    check_grant_upload,
)
from node.custody.block_effects import build_release
from node.custody.erasure import Eraser
from node.custody.restrictions import find_restrictions, is_void, require_release
from node.custody.shares import CheckedPart, Shares, find_record, grant_covers
from node.custody.stores.custody_store import BlockEffects, ClipRow, CustodyStore, FrameRow, RecordFacts
from node.custody.stores.share_store import PartRow, PartStatus


class ShareService:
    """Uploads of key parts and downloads of shared clips."""

    if TYPE_CHECKING:  # the custodian's own
        _store: CustodyStore
        _eraser: Eraser
        _shares: Shares
        _member: bytes
        _clock_ms: Callable[[], int]
        _writing: asyncio.Lock

        def _taking(self, count: int) -> AbstractAsyncContextManager[list[tuple[int, bytes]]]: ...

        def _assemble(self, clip: ClipRow, rows: Sequence[FrameRow]) -> ClipDownload: ...

    async def stage_part(
        self, upload: GrantUpload, owner: bytes, require_open: Callable[[], None] = lambda: None
    ) -> PartStatus:
        """Store a part of a shared key for the visit's verified owner (33 bytes).

        Staged until its grant is final. `require_open` rejects ended grants by final state. Raises as `Shares.judge`.
        """
        check_grant_upload(upload)
        judge = partial(self._check_part, upload, owner, require_open)
        judged = await judge()  # before a key is made for it, which is flushed to the disk
        if judged.is_known:
            async with self._writing:
                return await self._put_part(await judge(), upload, None)
        async with self._taking(1) as keys:
            (taken,) = keys
            async with self._writing:
                try:
                    judged = await judge()
                except BlockRobotError:
                    await self._eraser.destroy_unused([taken[0]])
                    raise
                status = await self._put_part(judged, upload, taken)
                if judged.is_known:
                    await self._eraser.destroy_unused([taken[0]])
        return status

    async def _check_part(self, upload: GrantUpload, owner: bytes, require_open: Callable[[], None]) -> CheckedPart:
        require_open()
        return await self._shares.check_part(upload, owner, self._clock_ms())

    async def _put_part(self, judged: CheckedPart, upload: GrantUpload, taken: tuple[int, bytes] | None) -> PartStatus:
        await self._shares.put(judged, upload, taken)
        if judged.row.status == "confirmed":
            await self._owe_shared(judged.row)
        return judged.row.status

    async def _owe_shared(self, part: PartRow) -> None:
        record = await find_record(self._store, part.record_id)
        if record is None:
            return
        restrictions = await find_restrictions(self._store, part.owner)
        asked = [grant for grant in await self._store.grants_of_owners([part.owner]) if grant.share == part.grant_id]
        due = [grant for grant in asked if grant_covers(grant, record) and not is_void(grant, restrictions)]
        owed = tuple([await build_release(self._store, grant, [part.record_id]) for grant in due])
        await self._store.apply(BlockEffects(outbox=owed))

    async def download_shared(self, request: SharedRequest, grant_id: bytes) -> SharedDownload:
        """Return a shared clip, package and parts to the verified grantee; of a clip kept elsewhere no frames.

        Raises as `Custodian.download`, and GRANT_ENDED, GRANT_PARTS_MISSING.
        """
        grant = await self._store.grant(request.access_id)
        if grant is None or not grant_id or grant.share != grant_id or request.record_id not in grant.records:
            raise BlockRobotError("ACCESS_NOT_GRANTED")
        record = await find_record(self._store, request.record_id)
        if record is None:
            raise BlockRobotError("NOT_FOUND", "This custodian has no such clip.")
        if not grant_covers(grant, record):
            raise BlockRobotError("ACCESS_NOT_GRANTED")
        if isinstance(record, RecordFacts) and request.with_frames and not record.elsewhere:
            raise BlockRobotError("CLIP_NOT_CONFIRMED")
        rows = await self._store.frames(request.record_id) if request.with_frames else []
        part = await self._store.part(grant_id, request.record_id)
        # After the rows, since a word may have become final while they were read; the keys last, at once.
        require_release(grant, await find_restrictions(self._store, grant.owner))
        await self._shares.require_open_grant(grant_id, self._clock_ms())
        held = self._shares.open(part)
        if isinstance(record, ClipRow):
            found = self._assemble(record, rows)
        else:
            found = ClipDownload(request.record_id, record.txid, frames=[], commitment_leaves=[], ciphertext_leaves=[])
        return build_shared_download(found, self._member, held.package, held.parts, with_frames=request.with_frames)

"""Group commit of uploads: those that wait for the custodian's lock together are written together."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field

from consensus.errors import BlockRobotError
from consensus.limits import MIB_BYTES
from node.custody.stores.custody_store import ClipRow, FrameRow
from node.custody.uploads.upload_usage import UploadTerms

WRITTEN_TOGETHER_MAX_COUNT = 16
WRITTEN_TOGETHER_MAX_BYTES = 3 * MIB_BYTES
"""A larger clip is written alone."""


@dataclass(eq=False, slots=True)
class PendingUpload:
    """A clip that is to be kept, with its frames' rows.

    `turn`: set once it `is_over`, or is the first of those that wait. `refusal`: why it was not kept.
    """

    clip: ClipRow
    rows: Sequence[FrameRow]
    terms: UploadTerms | None
    turn: asyncio.Event = field(default_factory=asyncio.Event)
    is_over: bool = False
    refusal: BlockRobotError | None = None

    @property
    def slots(self) -> list[int]:
        """Erase-key slots of its frames."""
        return [row.slot for row in self.rows]


class UploadQueue:
    """`write` keeps uploads of different records, or sets their `refusal`.

    The first that waits takes the lock, and writes those behind it along.
    """

    def __init__(self, write: Callable[[Sequence[PendingUpload]], Awaitable[None]]) -> None:
        self._write = write
        self._waiting: list[PendingUpload] = []

    async def keep(self, upload: PendingUpload, lock: asyncio.Lock) -> None:
        """Return when it is kept. Raises its refusal; STORE_UNAVAILABLE if the task that wrote it was cancelled."""
        self._waiting.append(upload)
        try:
            if self._waiting[0] is not upload:
                await upload.turn.wait()
            if not upload.is_over:
                async with lock:
                    await self._write_first()
        finally:
            if upload in self._waiting:
                self._waiting.remove(upload)
            if self._waiting:
                self._waiting[0].turn.set()
        if upload.refusal is not None:
            raise upload.refusal

    async def _write_first(self) -> None:
        taken = self._take()
        detail = "The write of several clips was cut off; send the clip again."
        failure: BlockRobotError | None = BlockRobotError("STORE_UNAVAILABLE", detail)
        try:
            await self._write(taken)
            failure = None
        except BlockRobotError as error:
            failure = error
        finally:
            for upload in taken:
                upload.is_over = True
                upload.refusal = upload.refusal or failure
                upload.turn.set()

    def _take(self) -> list[PendingUpload]:
        """The first, and those after it that fit; a record's second upload waits until the first is kept."""
        taken, records, size_bytes = list[PendingUpload](), set[bytes](), 0
        for upload in self._waiting:
            if upload.clip.record_id in records:
                continue
            size_bytes += upload.clip.size_bytes
            if taken and (len(taken) == WRITTEN_TOGETHER_MAX_COUNT or size_bytes > WRITTEN_TOGETHER_MAX_BYTES):
                break
            taken.append(upload)
            records.add(upload.clip.record_id)
        self._waiting = [upload for upload in self._waiting if upload not in taken]
        return taken

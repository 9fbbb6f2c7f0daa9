"""A custodian's store whose ciphertexts lie in a blob store: one blob for each clip; the rest stays in the index.

In the index a frame has a reference in place of its ciphertext. A blob is written before the rows that name it, and goes
before the rows of an erased clip do; what no row names is swept. Rows from before the blob store are read as they are.
"""

from __future__ import annotations

import struct
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import structlog

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from node.custody.blobs.blob_names import GENERATION_BYTES, BlobNames, new_generation
from node.custody.blobs.blob_store import BlobStore
from node.custody.blobs.place_file import take_place
from node.custody.many_at_once import for_each
from node.custody.stores.custody_store import ClipRow, CustodyStore, FrameRow, Unwritten, require_written

Write = Callable[[Mapping[bytes, Sequence[FrameRow]]], Awaitable[Unwritten]]
log = structlog.get_logger(__name__)

LISTED_MAX_COUNT = 1_000
"""Of one record's blobs, deleted before the next are listed; a write ends those before it, so there are more than two only
after many cuts, or if somebody puts them there."""
LISTS_MAX_COUNT = 1_000
NAMES_AT_ONCE_COUNT = 1_024
"""Blobs that a sweep looks up in the index together."""
REFERENCE = struct.Struct(f">{GENERATION_BYTES}sII")
"""Generation, offset and length in bytes; shorter than any ciphertext."""


class BlobBackedStore:
    """A `CustodyStore`; what is not of clips' ciphertexts is the index's."""

    def __init__(self, index: CustodyStore, blobs: BlobStore, names: BlobNames, custody_dir: Path) -> None:
        """`custody_dir`: where the file is that says whether the place has been taken."""
        self._custody_dir = custody_dir
        self._index = index
        self._blobs = blobs
        self._names = names
        self._in_flight: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._index, name)

    async def __aenter__(self) -> Self:
        """Raises STORE_UNAVAILABLE, and as `take_place`."""
        await self._blobs.__aenter__()
        try:
            await take_place(self._blobs, self._names, self._custody_dir)
            await self._blobs.clear_unfinished()
            await self._index.__aenter__()
        except BaseException as error:
            await self._blobs.__aexit__(type(error), error, error.__traceback__)
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            await self._index.__aexit__(kind, error, trace)
        finally:
            await self._blobs.__aexit__(kind, error, trace)

    async def stage(self, clip: ClipRow, frames: Sequence[FrameRow]) -> None:
        require_written(await self.stage_all([(clip, frames)]))

    async def stage_all(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        """A clip whose blob is refused keeps no other away."""

        async def write(rows: Mapping[bytes, Sequence[FrameRow]]) -> Unwritten:
            found = [(clip, rows[clip.record_id]) for clip, _ in clips if clip.record_id in rows]
            return await self._index.stage_all(found) if found else {}

        return await self._write({clip.record_id: frames for clip, frames in clips}, write)

    async def replace_frames(self, record_id: bytes, frames: Sequence[FrameRow]) -> None:
        async def write(rows: Mapping[bytes, Sequence[FrameRow]]) -> Unwritten:
            if record_id in rows:
                await self._index.replace_frames(record_id, rows[record_id])
            return {}

        require_written(await self._write({record_id: frames}, write))

    async def _write(self, clips: Mapping[bytes, Sequence[FrameRow]], write: Write) -> Unwritten:
        """New blobs, the rows, and only then the end of what these named before."""
        before = {place.record_id for place in await self._index.frame_places(list(clips))}
        generations = {record_id: new_generation() for record_id in clips}
        names = {key: self._names.name(key, generations[key]) for key, frames in clips.items() if frames}
        refused = dict[bytes, BlockRobotError]()

        async def put(record_id: bytes) -> None:
            try:
                await self._blobs.put(names[record_id], b"".join(frame.ciphertext for frame in clips[record_id]))
            except BlockRobotError as error:
                refused[record_id] = error

        self._in_flight.update(names.values())
        try:
            await for_each(list(names), put)
            rows = {key: _referring(clips[key], generations[key]) for key in clips if key not in refused}
            unwritten = {**refused, **await write(rows)}
        finally:
            self._in_flight.difference_update(names.values())
        for record_id, frames in clips.items():
            if record_id not in unwritten and (record_id in before or not frames):
                await self._delete_all(record_id, spared=names.values())
        return unwritten

    async def frames(self, record_id: bytes) -> list[FrameRow]:
        """A ciphertext that the blob store has lost is empty."""
        rows = await self._index.frames(record_id)
        found = await self._resolve(record_id, rows)
        if any(not row.ciphertext for row in found):  # written anew while it was read
            rows_now = await self._index.frames(record_id)
            if rows_now != rows:
                return await self._resolve(record_id, rows_now)
        return found

    async def _resolve(self, record_id: bytes, rows: Sequence[FrameRow]) -> list[FrameRow]:
        return await with_ciphertexts(self._blobs, self._names, record_id, rows)

    async def erase_frames(self, record_id: bytes, indexes: Sequence[int]) -> None:
        rows = await self._index.frames(record_id)
        kept = [row for row in rows if row.index not in indexes]
        if kept and len(kept) < len(rows):
            await self.replace_frames(record_id, await self._resolve(record_id, kept))
            return
        await self._index.erase_frames(record_id, indexes)
        spared = self._named_by(record_id, kept)
        await self._delete_all(record_id, self._named_by(record_id, rows) - spared, spared)

    async def erase_clips(self, record_ids: Sequence[bytes]) -> None:
        named = await self._named(record_ids)
        await for_each(record_ids, lambda record_id: self._delete_all(record_id, named[record_id]))
        await self._index.erase_clips(record_ids)

    async def drop_staged(self, record_ids: Sequence[bytes]) -> None:
        clips, named = await self._index.clips(record_ids), await self._named(record_ids)
        await self._index.drop_staged(record_ids)
        gone = [key for key in record_ids if key not in clips or clips[key].status == "staged"]
        await for_each(gone, lambda record_id: self._delete_all(record_id, named[record_id]))

    async def sweep_blobs(self) -> int:
        """Of this custodian's names only. What is being written is in flight until its rows are there."""
        count, batch = 0, dict[str, bytes]()
        async for name in self._blobs.names():
            if (meant := self._names.read(name)) is not None:
                batch[name] = meant[0]
            if len(batch) >= NAMES_AT_ONCE_COUNT:
                count += await self._sweep(batch)
                batch.clear()
        count += await self._sweep(batch)
        if count:
            log.info("custody_blobs_swept", count=count)
        return count

    async def _sweep(self, listed: dict[str, bytes]) -> int:
        """Record ids by the names of their blobs. The rows are read after it was seen that a blob is not in flight."""
        settled = {name: record_id for name, record_id in listed.items() if name not in self._in_flight}
        named = await self._named(sorted(set(settled.values())))
        unnamed = [name for name, record_id in settled.items() if name not in named[record_id]]
        await for_each(unnamed, self._blobs.delete)
        return len(unnamed)

    async def _named(self, record_ids: Sequence[bytes]) -> dict[bytes, set[str]]:
        found = await self._index.references(record_ids, REFERENCE.size)
        return {record_id: self._names_of(record_id, found.get(record_id, ())) for record_id in record_ids}

    def _named_by(self, record_id: bytes, rows: Sequence[FrameRow]) -> set[str]:
        return self._names_of(record_id, [row.ciphertext for row in rows if len(row.ciphertext) == REFERENCE.size])

    def _names_of(self, record_id: bytes, references: Collection[bytes]) -> set[str]:
        generations = {REFERENCE.unpack(reference)[0] for reference in references}
        return {self._names.name(record_id, generation) for generation in generations}

    async def _delete_all(self, record_id: bytes, named: Collection[str] = (), spared: Collection[str] = ()) -> None:
        """All but `spared`; first those that rows have `named`, so that one list is enough to see that none is left.

        Raises STORE_UNAVAILABLE if one is still there, or there are new ones without an end.
        """
        await self._delete(named)
        deleted = set[str]()
        for _ in range(LISTS_MAX_COUNT):
            left = await self._listed(record_id, spared)
            if not left:
                return
            if not deleted.isdisjoint(left):
                detail = "The store of clips still has a blob after it was deleted."
                raise BlockRobotError("STORE_UNAVAILABLE", detail)
            await self._delete(left)
            deleted.update(left)
        raise BlockRobotError("STORE_UNAVAILABLE", "The store of clips names one clip's blobs without an end.")

    async def _delete(self, names: Collection[str]) -> None:
        await for_each(list(names), self._blobs.delete)

    async def _listed(self, record_id: bytes, spared: Collection[str]) -> list[str]:
        """Some of them."""
        found: list[str] = []
        async for name in self._blobs.names(self._names.prefix(record_id)):
            if self._names.read(name) is not None and name not in spared:
                found.append(name)
            if len(found) == LISTED_MAX_COUNT:
                break
        return found


def _referring(frames: Sequence[FrameRow], generation: bytes) -> list[FrameRow]:
    at, rows = 0, []
    for frame in frames:
        rows.append(replace(frame, ciphertext=REFERENCE.pack(generation, at, len(frame.ciphertext))))
        at += len(frame.ciphertext)
    return rows


async def with_ciphertexts(
    blobs: BlobStore, names: BlobNames, record_id: bytes, rows: Sequence[FrameRow]
) -> list[FrameRow]:
    """Rows with the ciphertexts that they refer to; empty where a blob is lost or cut short."""
    read: dict[bytes, bytes] = {}
    found = []
    for row in rows:
        if len(row.ciphertext) != REFERENCE.size:
            found.append(row)
            continue
        generation, start, length = REFERENCE.unpack(row.ciphertext)
        if generation not in read:
            read[generation] = await blobs.get(names.name(record_id, generation), CLIP_SIZE_MAX_BYTES) or b""
        text = read[generation][start : start + length]
        found.append(replace(row, ciphertext=text if len(text) == length else b""))
    return found

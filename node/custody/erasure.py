"""Erasure: destroy keys, delete rows, verify, and only then queue a receipt.

Plans are stored first and rerun after a crash; slots are reusable once plans close.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode, encode_value
from consensus.primitives.hashing import tagged_hash
from node.custody.erase_keys import ErasableKeys
from node.custody.stores.custody_store import ClipRow, CustodyStore, ErasurePart, ErasurePlan, FramePlace, OutboxRow
from node.custody.stores.share_store import PartPlace

RECEIPT_KIND = "erasure.receipt"
EXPIRED_KIND = "erasure.expired"
REMAINS_NOTHING = "nothing"
REMAINS_LEAVES = "commitment-leaves"
RECORDS_A_CALL_MAX_COUNT = 32
_PLANS_AT_ONCE_COUNT = 128

_DIGEST = "blockrobot/erasure-digest"
_EXPIRY = "blockrobot/expiry-subject"


def compute_expiry_subject(record_ids: Sequence[bytes]) -> bytes:
    """Return an expiry report's id: the hash over its ordered record ids."""
    return tagged_hash(_EXPIRY, *record_ids)


def compute_erasure_digest(parts: Sequence[ErasurePart], clips: dict[bytes, ClipRow]) -> bytes:
    """Return a receipt's hash over erased record ids, indexes and ciphertext leaves."""
    listed = []
    for part in parts:
        clip = clips.get(part.record_id)
        leaves = clip.ciphertext_leaves if clip is not None else ()
        listed.append([part.record_id, [[i, leaves[i] if i < len(leaves) else b""] for i in part.indexes]])
    return tagged_hash(_DIGEST, encode_value(listed))


def _parts(record_ids: Sequence[bytes], places: Sequence[FramePlace], frames: Sequence[int]) -> tuple[ErasurePart, ...]:
    parts = []
    for record_id in record_ids:
        chosen = [p for p in places if p.record_id == record_id and (not frames or p.index in frames)]
        indexes, slots = tuple(place.index for place in chosen), tuple(place.slot for place in chosen)
        parts.append(ErasurePart(record_id, indexes, slots, whole=not frames))
    return tuple(parts)


class Eraser:
    """Plans and executes erasures; every use ends with `finish`, before the checkpoint."""

    def __init__(
        self, store: CustodyStore, erase_keys: ErasableKeys, is_frame_approved: Callable[[bytes], bool]
    ) -> None:
        """`is_frame_approved`: the newest final state approves this frame for any robot."""
        self._is_frame_approved = is_frame_approved
        self._store = store
        self._keys = erase_keys
        self._is_swept = True
        self._has_plans = True
        self._executed_plans: set[tuple[str, bytes, int]] = set()
        self.asked_count = 0

    async def erase_requested(
        self, erasure_id: bytes, record_ids: Sequence[bytes], frames: Sequence[int], height: int
    ) -> None:
        """Erase records or frames; queue a receipt of what remains until when."""
        self.asked_count += 1
        await self._destroy_parts_of(record_ids, height if frames else None)
        clips = await self._store.clips(record_ids)
        parts = _parts(record_ids, await self._store.frame_places(record_ids), frames)
        kept_until = [clip.expires_at_ms for clip in clips.values() if clip.status == "confirmed"]
        remains, until = (REMAINS_LEAVES, max(kept_until)) if frames and kept_until else (REMAINS_NOTHING, 0)
        destroyed = sum(len(part.indexes) for part in parts)
        arguments = [erasure_id, destroyed, remains, until, compute_erasure_digest(parts, clips)]
        await self._store_plan(RECEIPT_KIND, erasure_id, "receipt", arguments, height, parts)

    async def erase_expired(self, at_ms: int, height: int) -> None:
        """Erase confirmed clips with `expires_at_ms <= at_ms` and queue their reports.

        Missing clips are reported too.
        """
        while await self.erase_some_expired(at_ms, height):
            pass
        await self.report_expired(await self._store.missing_over(at_ms), height)

    async def erase_some_expired(self, at_ms: int, height: int) -> bool:
        """As many as are reported together; tell whether there may be more."""
        record_ids = await self._store.expired(at_ms, RECORDS_A_CALL_MAX_COUNT)
        if record_ids:
            await self._expire(record_ids, height)
        return len(record_ids) == RECORDS_A_CALL_MAX_COUNT

    async def report_expired(self, record_ids: Sequence[bytes], height: int) -> None:
        for start in range(0, len(record_ids), RECORDS_A_CALL_MAX_COUNT):
            await self._expire(record_ids[start : start + RECORDS_A_CALL_MAX_COUNT], height)

    async def _expire(self, record_ids: Sequence[bytes], height: int) -> None:
        await self._destroy_parts_of(record_ids)
        clips = await self._store.clips(record_ids)
        parts = _parts(record_ids, await self._store.frame_places(record_ids), ())
        arguments = [list(record_ids), compute_erasure_digest(parts, clips)]
        await self._store_plan(EXPIRED_KIND, compute_expiry_subject(record_ids), "expired", arguments, height, parts)

    async def erase_again(self, record_ids: Sequence[bytes]) -> None:
        """Erase records whose erasure the chain has completed; no receipt is due."""
        await self._destroy_parts_of(record_ids)
        parts = _parts(record_ids, await self._store.frame_places(record_ids), ())
        slots = [slot for part in parts for slot in part.slots]
        await asyncio.to_thread(self._keys.destroy, slots)
        self._is_swept = False
        await self._store.erase_clips(record_ids)
        await self._read_back(parts)
        await asyncio.to_thread(self._keys.release, slots)

    async def forget(self, record_id: bytes) -> None:
        """Delete a mismatching clip or mark, without a mark: it becomes missing.

        Rows go before keys; unclaimed frames go too.
        """
        places = await self._store.frame_places([record_id])
        self._is_swept = False
        await self._store.stage(ClipRow(record_id, b"", 0, "staged", (), ()), [])
        await self._store.drop_staged([record_id])
        await self.destroy_unused([place.slot for place in places])

    async def drop_staged(self, record_ids: Sequence[bytes]) -> None:
        """Drop staged clips that no record will name.

        Rows go before keys, so existing rows have keys; orphaned keys go at start.
        """
        slots = [place.slot for place in await self._store.frame_places(record_ids)]
        self._is_swept = False
        await self._store.drop_staged(record_ids)
        await self.destroy_unused(slots)

    async def destroy_parts(self, places: Sequence[PartPlace]) -> None:
        """Destroy shared-key parts: keys first, then rows, then verify."""
        slots = [place.slot for place in places]
        if not slots:
            return
        await asyncio.to_thread(self._keys.destroy, slots)
        self._is_swept = False
        await self._store.erase_parts(slots)
        left = await self._store.parts_of("grant_id", sorted({place.grant_id for place in places}))
        if {place.slot for place in left} & set(slots):
            raise BlockRobotError("STORE_UNAVAILABLE", "The store still returns parts of keys after they were deleted.")
        await asyncio.to_thread(self._keys.release, slots)

    async def delete_backgrounds(self, digests: Sequence[bytes]) -> None:
        """Delete empty frames approved for no robot now, and verify."""
        digests = [digest for digest in digests if not self._is_frame_approved(digest)]
        if not digests:
            return
        self._is_swept = False
        await self._store.delete_backgrounds(digests)
        if set(digests) & set(await self._store.background_digests()):
            raise BlockRobotError("STORE_UNAVAILABLE", "The store still returns empty frames after they were deleted.")

    async def _destroy_parts_of(self, record_ids: Sequence[bytes], up_to_height: int | None = None) -> None:
        places = await self._store.parts_of("record_id", record_ids)
        await self.destroy_parts([p for p in places if up_to_height is None or p.height <= up_to_height])

    async def destroy_unused(self, slots: Sequence[int]) -> None:
        if slots:
            await asyncio.to_thread(self._keys.destroy, slots)
            await asyncio.to_thread(self._keys.release, slots)

    async def finish(self) -> None:
        """Finish interrupted plans, sweep once if anything went, then close plans."""
        while self._has_plans:
            rows = await self._store.outbox("erasing", "erasure", _PLANS_AT_ONCE_COUNT)
            self._has_plans = bool(rows)
            for row in rows:
                if row.key not in self._executed_plans:
                    await self._execute_plan(row)
            await self._sweep()
            for row in rows:
                await self._complete_plan(row)
        await self._sweep()

    async def _sweep(self) -> None:
        if not self._is_swept:
            await self._store.sweep()
            self._is_swept = True

    async def _store_plan(
        self,
        kind: str,
        subject: bytes,
        entry: str,
        arguments: Sequence[object],
        height: int,
        parts: tuple[ErasurePart, ...],
    ) -> None:
        plan = encode(ErasurePlan(parts))
        row = OutboxRow(kind, subject, 0, "erasure", entry, encode_value(list(arguments)), height, "erasing", plan)
        self._has_plans = True
        await self._store.add_outbox(row)
        for known in await self._store.outbox_of(kind, subject):  # an earlier plan of the same stays as it was
            if known.status == "erasing" and known.key not in self._executed_plans:
                await self._execute_plan(known)

    async def _execute_plan(self, row: OutboxRow) -> None:
        parts = decode(row.plan, ErasurePlan).parts
        slots = [slot for part in parts for slot in part.slots]
        await asyncio.to_thread(self._keys.destroy, slots)
        self._is_swept = False
        await self._store.erase_clips([part.record_id for part in parts if part.whole])
        for part in parts:
            if not part.whole:
                await self._store.erase_frames(part.record_id, part.indexes)
        self._executed_plans.add(row.key)

    async def _complete_plan(self, row: OutboxRow) -> None:
        parts = decode(row.plan, ErasurePlan).parts
        self._executed_plans.discard(row.key)
        await self._read_back(parts)
        await self._store.mark_outbox_ready(row.key)
        await asyncio.to_thread(self._keys.release, [slot for part in parts for slot in part.slots])

    async def _read_back(self, parts: Sequence[ErasurePart]) -> None:
        places = await self._store.frame_places([part.record_id for part in parts])
        left = {(place.record_id, place.index) for place in places}
        erased = {(part.record_id, index) for part in parts for index in part.indexes}
        if left & erased:
            raise BlockRobotError("STORE_UNAVAILABLE", "The store still returns frames after they were deleted.")
        for part in parts:
            if any(self._keys.read(slot) is not None for slot in part.slots):
                raise BlockRobotError("ERASE_KEYS_DAMAGED", "An erase key is still there after it was destroyed.")

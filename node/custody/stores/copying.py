"""Copies a custodian's store into an empty one of another kind; the erase keys stay where they are."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

from consensus.errors import BlockRobotError
from node.custody.stores.custody_store import BlockEffects, CustodyStore, OutboxStatus, StoreCounts

Tell = Callable[[int, int], None]
"""Told how many clips are copied, and of how many."""

ABSENT_AT_ONCE_COUNT = 1_000
ROWS_MAX_COUNT = 1 << 31
OUTBOX_CONTRACTS = ("access", "erasure")
OUTBOX_STATUSES: tuple[OutboxStatus, ...] = ("ready", "erasing")


async def copy_store(source: CustodyStore, target: CustodyStore, tell: Tell = lambda _done, _all: None) -> StoreCounts:
    """Copy and compare; the checkpoint is written last, so a copy that was cut off is begun again.

    Nobody else may use the two. Raises FILE_EXISTS if the target is another custodian's or newer, STORE_UNAVAILABLE, also
    for what does not read back as it was written.
    """
    if await target.checkpoint() not in {None, await source.checkpoint()}:
        raise BlockRobotError("FILE_EXISTS", "The new store holds a custodian's clips already: name an empty one.")
    counts, done = await source.counts(), 0
    async for clip in source.all_clips():
        if clip.status == "erased":
            await target.erase_clip(clip.record_id)
        else:
            frames = await source.frames(clip.record_id)
            await target.stage(clip, frames)
            if await target.frames(clip.record_id) != frames:
                raise BlockRobotError("STORE_UNAVAILABLE", "The new store gives back other pictures than it was given.")
        done += 1
        tell(done, counts.staged + counts.confirmed + counts.erased)
    await _copy_grants_and_shares(source, target)
    for digest in await source.background_digests():
        if content := await source.background(digest):
            await target.put_background(digest, content)
    for status, contract in product(OUTBOX_STATUSES, OUTBOX_CONTRACTS):
        for row in await source.outbox(status, contract, ROWS_MAX_COUNT):
            await target.add_outbox(row)
    known = await target.day_uses()
    for use in await source.day_uses():
        if use not in known:
            await target.add_use(use)
    await _copy_absent(source, target)
    await target.apply(
        BlockEffects(
            visit_restrictions=tuple((await source.visit_restrictions()).values()),
            checkpoint=await source.checkpoint(),
        )
    )
    copied = await target.counts()
    if _compared(copied) != _compared(counts):
        raise BlockRobotError("STORE_UNAVAILABLE", "The new store counts other rows than the old one.")
    return copied


async def _copy_absent(source: CustodyStore, target: CustodyStore) -> None:
    after = b""
    while absent := await source.absent(after, ABSENT_AT_ONCE_COUNT):
        await target.apply(BlockEffects(missing=tuple(absent)))
        after = absent[-1].record_id


async def _copy_grants_and_shares(source: CustodyStore, target: CustodyStore) -> None:
    async for grant in source.all_grants():
        await target.apply(BlockEffects(grants=(grant,)))
    async for share in source.all_shares():
        await target.put_share(share)
    async for place in source.all_parts():
        if part := await source.part(place.grant_id, place.record_id):
            await target.put_part(part)


def _compared(counts: StoreCounts) -> tuple[int, ...]:
    held = (counts.staged, counts.confirmed, counts.erased, counts.frames, counts.missing, counts.elsewhere)
    return (*held, counts.outbox_ready, counts.outbox_erasing, counts.shares, counts.parts)

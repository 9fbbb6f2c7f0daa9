"""Copies a custodian's store into an empty one of another kind; the erase keys stay where they are."""

from __future__ import annotations

import dataclasses
from collections.abc import AsyncIterator, Callable
from itertools import product

from consensus.errors import BlockRobotError
from node.custody.stores.custody_store import (
    BlockEffects,
    CustodyStore,
    OutboxRow,
    OutboxStatus,
    RecordFacts,
    StoreCounts,
)

Tell = Callable[[int, int], None]
"""Told how many clips are copied, and of how many."""

ABSENT_AT_ONCE_COUNT = 1_000
ROWS_MAX_COUNT = 1 << 31
OUTBOX_CONTRACTS = ("access", "erasure")
OUTBOX_STATUSES: tuple[OutboxStatus, ...] = ("ready", "erasing")


async def require_empty(store: CustodyStore) -> None:
    """Raise FILE_EXISTS if a custodian has written to it."""
    held = dataclasses.replace(await store.counts(), size_bytes=None)
    if any(dataclasses.astuple(held)) or await store.checkpoint() is not None:
        raise BlockRobotError("FILE_EXISTS", "The new store holds a custodian's clips already: name an empty one.")


async def copy_store(source: CustodyStore, target: CustodyStore, tell: Tell = lambda _done, _all: None) -> StoreCounts:
    """Copy into an empty store and compare; the checkpoint is written last.

    Nobody else may use the two. A clip that is half written is left behind, and its erase keys with it. Raises
    STORE_UNAVAILABLE, also for what does not read back as it was written.
    """
    counts, done = await source.counts(), 0
    async for clip in source.all_clips():
        if clip.status == "erased":
            await target.erase_clips([clip.record_id])
        else:
            frames = await source.frames(clip.record_id)
            await target.stage(clip, frames)
            if await target.frames(clip.record_id) != frames:
                raise _differs("pictures")
        done += 1
        tell(done, counts.staged + counts.confirmed + counts.erased)
    await _copy_grants_and_shares(source, target)
    for digest in await source.background_digests():
        if content := await source.background(digest):
            await target.put_background(digest, content)
    for row in await _outbox(source):
        await target.add_outbox(row)
    for use in await source.day_uses():
        await target.add_use(use)
    async for page in _absent(source):
        await target.apply(BlockEffects(missing=tuple(page)))
    await target.apply(BlockEffects(visit_restrictions=tuple((await source.visit_restrictions()).values())))
    await _require_same(source, target)
    await target.apply(BlockEffects(checkpoint=await source.checkpoint()))
    return await target.counts()


async def _copy_grants_and_shares(source: CustodyStore, target: CustodyStore) -> None:
    async for grant in source.all_grants():
        await target.apply(BlockEffects(grants=(grant,)))
    async for share in source.all_shares():
        await target.put_share(share)
    async for place in source.all_parts():
        if part := await source.part(place.grant_id, place.record_id):
            await target.put_part(part)


async def _require_same(source: CustodyStore, target: CustodyStore) -> None:
    copied = _all_rows(target)
    for what, rows in _all_rows(source).items():
        async for row in rows:
            if await anext(copied[what], None) != row:
                raise _differs(what)
        if await anext(copied[what], None) is not None:
            raise _differs(what)
    if await source.visit_restrictions() != await target.visit_restrictions():
        raise _differs("restrictions")
    if await source.background_digests() != await target.background_digests():
        raise _differs("empty frames")
    if await source.day_uses() != await target.day_uses():
        raise _differs("accounts of uploads")
    if await _outbox(source) != await _outbox(target):
        raise _differs("owed transactions")


def _all_rows(store: CustodyStore) -> dict[str, AsyncIterator[object]]:
    return {
        "clips": store.all_clips(),
        "missing clips": _absent(store),
        "grants": store.all_grants(),
        "shares": store.all_shares(),
        "parts of keys": store.all_parts(),
    }


async def _absent(store: CustodyStore) -> AsyncIterator[list[RecordFacts]]:
    after = b""
    while page := await store.absent(after, ABSENT_AT_ONCE_COUNT):
        yield page
        after = page[-1].record_id


async def _outbox(store: CustodyStore) -> list[OutboxRow]:
    kinds = product(OUTBOX_STATUSES, OUTBOX_CONTRACTS)
    return [row for status, contract in kinds for row in await store.outbox(status, contract, ROWS_MAX_COUNT)]


def _differs(what: str) -> BlockRobotError:
    return BlockRobotError("STORE_UNAVAILABLE", f"The new store gives back other {what} than it was given.")

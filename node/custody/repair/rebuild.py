"""Rebuild: recreates a store's index from finalized state, refetching damaged clips; idempotent."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, field, replace

from consensus.errors import BlockRobotError
from node.custody.block_effects import matches_roots
from node.custody.chain_facts import ChainFacts, RecordState
from node.custody.clip_fetching import PeerCustodian
from node.custody.custodian import Custodian
from node.custody.erase_keys import ErasableKeys
from node.custody.erasure import RECORDS_A_CALL_MAX_COUNT
from node.custody.many_at_once import for_each
from node.custody.repair.scrub import (
    GONE_CODES,
    RECORDS_AT_ONCE_COUNT,
    OpenFacts,
    RecordComparer,
    ScrubReport,
    Tell,
    caught_up,
    find_unclaimed_frames,
    find_unclaimed_keys,
    ignore_progress,
)
from node.custody.stores.custody_store import BlockEffects, ClipRow, CustodyStore, RecordFacts

FRUITLESS_PASSES_MAX_COUNT = 2
_TELL_EVERY_COUNT = 100

FindPeers = Callable[[], Sequence[PeerCustodian]]
Pause = Callable[[], Awaitable[None]]


@dataclass(slots=True)
class RebuildReport:
    """A rebuild's changes by record id (and frame), and what remains missing."""

    height: int = 0
    clips_count: int = 0
    erased_again: list[bytes] = field(default_factory=list)
    corrected: list[bytes] = field(default_factory=list)
    forgotten: list[bytes] = field(default_factory=list)
    unknown_to_chain: list[bytes] = field(default_factory=list)
    keys_destroyed_count: int = 0
    fetched_count: int = 0
    mended: list[bytes] = field(default_factory=list)
    still_damaged: list[bytes] = field(default_factory=list)
    still_missing_count: int = 0

    @property
    def is_whole(self) -> bool:
        return not (self.unknown_to_chain or self.still_damaged or self.still_missing_count)


class Rebuild:
    """One rebuild; `find_peers` returns custodians reachable now."""

    def __init__(
        self,
        custodian: Custodian,
        store: CustodyStore,
        keys: ErasableKeys,
        open_facts: OpenFacts,
        find_peers: FindPeers,
        *,
        pause: Pause,
        tell: Tell = ignore_progress,
    ) -> None:
        self._custodian = custodian
        self._store = store
        self._keys = keys
        self._open_facts = open_facts
        self._find_peers = find_peers
        self._pause = pause
        self._tell = tell
        self._report = RebuildReport()
        self._erased_frames: tuple[int, dict[bytes, frozenset[int]]] | None = None

    async def run(self) -> RebuildReport:
        """Raises CUSTODY_CATCHING_UP, STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED."""
        async with caught_up(self._custodian, self._open_facts) as (facts, in_flight):
            self._report.height = facts.point.height
            await self._custodian.eraser.finish()
            await self._set_right(facts)
            await self._drop_unclaimed(in_flight)
            await self._custodian.reconciliation(facts).apply()
            await self._custodian.eraser.erase_expired(facts.point.timestamp_ms, facts.point.height)
            await self._custodian.eraser.finish()
            await self._store.apply(BlockEffects(checkpoint=facts.point))
        await self._mend()
        await self._fetch_missing()
        return self._report

    async def _set_right(self, facts: ChainFacts) -> None:
        gone: list[bytes] = []
        expired: list[RecordFacts] = []
        async for clip in self._store.all_clips():
            self._report.clips_count += 1
            if self._report.clips_count % _TELL_EVERY_COUNT == 0:
                self._tell("clips", self._report.clips_count, 0)
            record = facts.record(clip.record_id)
            if record is None:
                if clip.status == "confirmed":
                    self._report.unknown_to_chain.append(clip.record_id)
            elif not record.is_kept(facts.point.timestamp_ms):
                is_over = record.facts.expires_at_ms <= facts.point.timestamp_ms
                if is_over and clip.status == "confirmed" and record.status in {"active", "expired"}:
                    expired.append(record.facts)
                elif clip.status != "erased" or await self._store.frame_places([clip.record_id]):
                    gone.append(clip.record_id)
            else:
                await self._set_right_one(clip, record)
        for start in range(0, len(gone), RECORDS_A_CALL_MAX_COUNT):
            await self._custodian.eraser.erase_again(gone[start : start + RECORDS_A_CALL_MAX_COUNT])
        self._report.erased_again += gone
        await self._erase_expired(facts, expired)

    async def _erase_expired(self, facts: ChainFacts, expired: Sequence[RecordFacts]) -> None:
        for record in expired:
            await self._store.correct(record)
            self._report.erased_again.append(record.record_id)
        await self._custodian.eraser.erase_expired(facts.point.timestamp_ms, facts.point.height)

    async def _set_right_one(self, clip: ClipRow, record: RecordState) -> None:
        facts = record.facts
        if clip.status == "erased" or (clip.status == "confirmed" and not matches_roots(clip, facts)):
            await self._custodian.eraser.forget(clip.record_id)
            self._report.forgotten.append(clip.record_id)
            return
        right = replace(
            clip, txid=facts.txid, owner=facts.owner, expires_at_ms=facts.expires_at_ms, height=facts.height
        )
        if clip.status == "confirmed" and clip != right:
            await self._store.correct(facts)
            self._report.corrected.append(clip.record_id)

    async def _drop_unclaimed(self, in_flight: frozenset[int]) -> None:
        for record_id in await find_unclaimed_frames(self._store):
            known = (await self._store.clips([record_id])).get(record_id)
            if known is None:
                await self._custodian.eraser.forget(record_id)
                self._report.forgotten.append(record_id)
            else:
                await self._custodian.eraser.erase_again([record_id])
                self._report.erased_again.append(record_id)
        slots = await find_unclaimed_keys(self._store, self._keys, in_flight)
        await self._custodian.eraser.destroy_unused(slots)
        self._report.keys_destroyed_count = len(slots)

    async def _mend(self) -> None:
        """Some clips at a time: read while the custodian goes on, and judged at rest if they look damaged."""
        done, total = 0, (await self._store.counts()).confirmed
        async for clips in self._confirmed_clips():
            with self._open_facts() as facts:
                suspects = await self._find_damaged(facts, clips)
            if suspects:
                await self._repair(await self._judge([each.record_id for each in suspects]))
            done += len(clips)
            self._tell("compared", done, total)

    async def _confirmed_clips(self) -> AsyncIterator[list[ClipRow]]:
        batch: list[ClipRow] = []
        async for clip in self._store.all_clips():
            if clip.status == "confirmed":
                batch.append(clip)
            if len(batch) >= RECORDS_AT_ONCE_COUNT:
                yield batch
                batch = []
        yield batch

    async def _judge(self, suspects: Sequence[bytes]) -> list[RecordFacts]:
        async with caught_up(self._custodian, self._open_facts) as (facts, _):
            clips = await self._store.clips(suspects)
            return await self._find_damaged(facts, [clip for clip in clips.values() if clip.status == "confirmed"])

    async def _find_damaged(self, facts: ChainFacts, clips: Sequence[ClipRow]) -> list[RecordFacts]:
        judge, damaged = RecordComparer(self._custodian, self._store, facts), list[RecordFacts]()

        async def look(clip: ClipRow) -> None:
            record = facts.record(clip.record_id)
            if record is not None and await _is_damaged(judge, record, clip):
                damaged.append(replace(record.facts, erased_frames=tuple(sorted(judge.erased_frames(record)))))

        await for_each(clips, look)
        return sorted(damaged, key=lambda each: each.record_id)

    async def _repair(self, damaged: Sequence[RecordFacts]) -> None:
        """A damaged clip stays until there is a sound copy: its blobs may only be where nobody looks today."""
        mended = await self._custodian.mend(damaged, self._find_peers(), self._read_kept)
        for facts in damaged:
            (self._report.mended if facts.record_id in mended else self._report.still_damaged).append(facts.record_id)
        self._tell("mended", len(self._report.mended), 0)

    def _read_kept(self, record_ids: Sequence[bytes]) -> dict[bytes, RecordFacts]:
        """While the custodian writes nothing else: what a later block erases it erases itself."""
        with self._open_facts() as facts:
            asked_count = self._custodian.eraser.asked_count
            if self._erased_frames is None or self._erased_frames[0] != asked_count:
                self._erased_frames = asked_count, facts.erased_frames()  # reads all erasures that ever were
            asked, kept = self._erased_frames[1], dict[bytes, RecordFacts]()
            for record_id in record_ids:
                record = facts.record(record_id)
                if record is not None and record.is_kept(facts.point.timestamp_ms):
                    erased = {*record.facts.erased_frames, *asked.get(record_id, ())}
                    kept[record_id] = replace(record.facts, erased_frames=tuple(sorted(erased)))
        return kept

    async def _fetch_missing(self) -> None:
        """What is missing is counted anew only where nothing came: that takes long where much is."""
        total, fruitless = await self._store.count_missing(), 0
        left, passes = total, self._custodian.passes_count
        while left and fruitless < FRUITLESS_PASSES_MAX_COUNT:
            self._tell("fetched", total - left, total)
            before, fetched = left, await self._custodian.fetch_missing(self._find_peers())
            left = left - fetched if 0 < fetched < left else await self._store.count_missing()
            if left < before:
                passes, fruitless = self._custodian.passes_count, 0
            else:
                fruitless = self._custodian.passes_count - passes
                await self._pause()
        self._report.still_missing_count = await self._store.count_missing()
        self._report.fetched_count = max(0, total - self._report.still_missing_count)


async def _is_damaged(judge: RecordComparer, record: RecordState, clip: ClipRow) -> bool:
    seen = ScrubReport()
    try:
        await judge.compare(clip.record_id, record, clip, seen)
    except BlockRobotError as error:
        if error.code not in GONE_CODES:
            raise
    return bool(seen.corrupted)

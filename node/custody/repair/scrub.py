"""Scrub: verifies chain against store both ways, and that erased data is gone.

Repairs nothing; missing clips are listed for fetching, blobs that no row names are deleted.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import AbstractContextManager, asynccontextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import islice
from typing import Protocol

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.records.commitments import ciphertext_leaf
from node.custody.block_effects import matches_roots
from node.custody.chain_facts import ChainFacts, RecordState
from node.custody.custodian import Custodian
from node.custody.erase_keys import ErasableKeys
from node.custody.stores.custody_store import BlockEffects, ClipRow, CustodyStore, Leftovers, RecordFacts

OpenFacts = Callable[[], AbstractContextManager[ChainFacts]]


class Tell(Protocol):
    """Told of progress: what is being looked at, how many are done, and of how many (0: not known); `last`: the record up
    to which a scrub found nothing wrong, after which another can go on.
    """

    def __call__(self, what: str, done: int, total: int, last: bytes = b"") -> None: ...


RECORDS_AT_ONCE_COUNT = 256
SLOTS_AT_ONCE_COUNT = 16_384
KEY_WALKS_MAX_COUNT = 3
SETTLE_MAX_S = 20.0
FACTS_HELD_MAX_S = 60.0
_SETTLE_POLL_S = 0.05
GONE_CODES = frozenset({"CLIP_ERASED", "CLIP_NOT_CONFIRMED", "NOT_FOUND"})


def ignore_progress(what: str, done: int, total: int, last: bytes = b"") -> None: ...


@dataclass(slots=True)
class ScrubReport:
    """A scrub's findings, by record id and frame.

    `after`: records up to it were not looked up, since an earlier scrub did. `corrupted`: frames not matching their leaf,
    or lost. `unclaimed_frames`: records with frames but no clip. `parts_held_though_ended`: grant and record.
    `unclaimed_keys`: keys no frame names. `dirty_slots_count`: keyless slots with bytes.
    """

    height: int = 0
    after: bytes = b""
    records_count: int = 0
    clips_compared_count: int = 0
    frames_compared_count: int = 0
    missing: list[bytes] = field(default_factory=list)
    held_though_erased: list[bytes] = field(default_factory=list)
    frames_held_though_erased: list[tuple[bytes, int]] = field(default_factory=list)
    unknown_to_chain: list[bytes] = field(default_factory=list)
    other_facts: list[bytes] = field(default_factory=list)
    corrupted: list[tuple[bytes, int]] = field(default_factory=list)
    unclaimed_frames: list[bytes] = field(default_factory=list)
    parts_held_though_ended: list[tuple[bytes, bytes]] = field(default_factory=list)
    empty_frames_held_though_withdrawn: list[bytes] = field(default_factory=list)
    unclaimed_keys: list[int] = field(default_factory=list)
    dirty_slots_count: int = 0
    leftovers: Leftovers = field(default_factory=lambda: Leftovers(None, None))

    @property
    def nothing_erased_is_left(self) -> bool:
        held = (self.held_though_erased, self.frames_held_though_erased, self.unknown_to_chain, self.unclaimed_frames)
        files = (self.unclaimed_keys, self.dirty_slots_count, self.leftovers.log_bytes, self.leftovers.dirty_bytes)
        others = (self.parts_held_though_ended, self.empty_frames_held_though_withdrawn)
        return not any(held) and not any(files) and not any(others)

    @property
    def is_record_wrong(self) -> bool:
        """Whether a record has a finding that is told nowhere else; what is missing is in the store's list."""
        frames = (self.frames_held_though_erased, self.corrupted)
        return any((self.held_though_erased, self.unknown_to_chain, self.other_facts, *frames))

    def add_findings(self, other: ScrubReport) -> None:
        for each in fields(self):
            found = getattr(self, each.name)
            if isinstance(found, list):
                found.extend(getattr(other, each.name))

    @property
    def is_clean(self) -> bool:
        return self.nothing_erased_is_left and not any((self.missing, self.other_facts, self.corrupted))


class RecordComparer:
    """Compares one record's state with the store."""

    def __init__(self, custodian: Custodian, store: CustodyStore, facts: ChainFacts) -> None:
        self._custodian = custodian
        self._store = store
        self._facts = facts

    @cached_property
    def _erased_frames(self) -> dict[bytes, frozenset[int]]:
        return self._facts.erased_frames()  # of all erasures that ever were

    def erased_frames(self, record: RecordState) -> frozenset[int]:
        return frozenset(record.facts.erased_frames) | self._erased_frames.get(record.facts.record_id, frozenset())

    async def compare(
        self, record_id: bytes, record: RecordState | None, clip: ClipRow | None, report: ScrubReport
    ) -> bool:
        if record is None:
            if clip is None or clip.status != "confirmed":
                return True
            report.unknown_to_chain.append(record_id)
        elif not record.is_kept(self._facts.point.timestamp_ms):
            if (clip is None or clip.status != "confirmed") and not await self._store.frame_places([record_id]):
                return True
            report.held_though_erased.append(record_id)
        elif clip is None or clip.status != "confirmed":
            if clip is None and not self._custodian.is_keeper(self._facts.placement, record_id):
                return True
            report.missing.append(record_id)
        elif not _is_same(clip, record):
            report.other_facts.append(record_id)
        else:
            return await self._compare_frames(clip, record, report)
        return False

    async def _compare_frames(self, clip: ClipRow, record: RecordState, report: ScrubReport) -> bool:
        report.clips_compared_count += 1
        erased, is_well = self.erased_frames(record), True
        download = await self._custodian.look_at(clip.record_id)
        for frame, leaf in zip(download.frames, clip.ciphertext_leaves, strict=True):
            report.frames_compared_count += 1
            made = ciphertext_leaf(frame.index, sha256(frame.ciphertext), sha256(frame.sealed_key))
            if frame.index in erased:
                if not frame.erased:
                    report.frames_held_though_erased.append((clip.record_id, frame.index))
                    is_well = False
            elif frame.erased or made != leaf:
                report.corrupted.append((clip.record_id, frame.index))
                is_well = False
        return is_well


def _is_same(clip: ClipRow, record: RecordState) -> bool:
    facts = record.facts
    own = (clip.owner, clip.txid, clip.expires_at_ms, clip.height)
    return own == (facts.owner, facts.txid, facts.expires_at_ms, facts.height) and matches_roots(clip, facts)


@asynccontextmanager
async def caught_up(
    custodian: Custodian, open_facts: OpenFacts, max_s: float = SETTLE_MAX_S
) -> AsyncIterator[tuple[ChainFacts, frozenset[int]]]:
    """Pause the custodian when caught up; yields the state and in-flight slots.

    Raises CUSTODY_CATCHING_UP after `max_s`.
    """
    deadline = asyncio.get_running_loop().time() + max_s
    while True:
        async with custodian.at_rest() as in_flight:
            with open_facts() as facts:
                point = await custodian.checkpoint()
                if point is not None and point.height == facts.point.height:
                    yield facts, in_flight
                    return
        if asyncio.get_running_loop().time() > deadline:
            raise BlockRobotError("CUSTODY_CATCHING_UP", "The custodian is still behind its own ledger.")
        await asyncio.sleep(_SETTLE_POLL_S)


async def scrub(
    custodian: Custodian,
    store: CustodyStore,
    keys: ErasableKeys,
    open_facts: OpenFacts,
    tell: Tell = ignore_progress,
    after: bytes = b"",
) -> ScrubReport:
    """Absent clips are listed as missing. All is read while the custodian goes on; what looks wrong is judged at rest.

    `after`: records up to this id, in their order, are not looked up.

    Raises CUSTODY_CATCHING_UP, STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED.
    """
    report = ScrubReport(after=after)
    await _look_at_records(custodian, store, open_facts, report, tell)
    await _judge(await _find_unknown(store, open_facts, tell), custodian, store, open_facts, report)
    with open_facts() as facts:
        may_hold_ended_parts = bool(await find_ended_parts(store, facts))
    frames = await find_unclaimed_frames(store)
    tell("blobs", 0, 0)
    await store.sweep_blobs()
    tell("keys", 0, 0)
    report.dirty_slots_count = await _count_dirty_slots(keys)
    may_hold_unclaimed_keys = await _may_hold_unclaimed_keys(store, keys)
    async with caught_up(custodian, open_facts) as (facts, in_flight):
        report.height = facts.point.height
        report.unclaimed_frames = await _among_unclaimed(store, frames)
        if may_hold_ended_parts:
            report.parts_held_though_ended = await find_ended_parts(store, facts)
        report.empty_frames_held_though_withdrawn = await find_withdrawn_frames(store, facts)
        if may_hold_unclaimed_keys:
            report.unclaimed_keys = await find_unclaimed_keys(store, keys, in_flight)
        report.leftovers = await store.leftovers()
    return report


async def _look_at_records(
    custodian: Custodian, store: CustodyStore, open_facts: OpenFacts, report: ScrubReport, tell: Tell
) -> None:
    """While a version of the ledger is read, its file grows by what blocks change: none is held for long."""
    clock, last, sound = asyncio.get_running_loop().time, report.after, report.after
    is_done = False
    while not is_done:
        suspects: list[bytes] = []
        with open_facts() as facts:
            until, rest = clock() + FACTS_HELD_MAX_S, facts.records(last)
            comparer = RecordComparer(custodian, store, facts)
            while not is_done:
                batch = list(islice(rest, RECORDS_AT_ONCE_COUNT))
                suspects += await _find_suspects(comparer, store, batch, report)
                is_done = len(batch) < RECORDS_AT_ONCE_COUNT
                last = batch[-1].facts.record_id if batch else last
                sound = sound if suspects or report.is_record_wrong else last
                report.records_count += len(batch)
                tell("records", report.records_count, 0, sound)
                if clock() >= until:
                    break
        await _judge(suspects, custodian, store, open_facts, report)
        sound = sound if report.is_record_wrong else last
    tell("records", report.records_count, 0, sound)


async def _find_suspects(
    comparer: RecordComparer, store: CustodyStore, batch: Sequence[RecordState], report: ScrubReport
) -> list[bytes]:
    """`report` counts what is read; findings are for certain only at rest."""
    clips = await store.clips([record.facts.record_id for record in batch])
    found, seen = [], ScrubReport()
    for record in batch:
        record_id = record.facts.record_id
        try:
            is_well = await comparer.compare(record_id, record, clips.get(record_id), seen)
        except BlockRobotError as error:
            if error.code not in GONE_CODES:
                raise
            is_well = False  # erased or expired since the batch was read: to be looked at again
        if not is_well:
            found.append(record_id)
    report.clips_compared_count += seen.clips_compared_count
    report.frames_compared_count += seen.frames_compared_count
    return found


async def _find_unknown(store: CustodyStore, open_facts: OpenFacts, tell: Tell) -> list[bytes]:
    """Return clips of records that the chain does not have; for certain only at rest."""
    found: list[bytes] = []
    batch: list[bytes] = []
    done = 0

    def look_up() -> None:
        with open_facts() as facts:
            found.extend(record_id for record_id in batch if not facts.has_record(record_id))
        batch.clear()

    async for clip in store.all_clips():
        done += 1
        if clip.status == "confirmed":
            batch.append(clip.record_id)
        if len(batch) >= RECORDS_AT_ONCE_COUNT:
            look_up()
            tell("clips", done, 0)
    look_up()
    return found


async def _judge(
    suspects: Sequence[bytes], custodian: Custodian, store: CustodyStore, open_facts: OpenFacts, report: ScrubReport
) -> None:
    """Some at a time, so that blocks and uploads wait for no more than those."""
    for start in range(0, len(suspects), RECORDS_AT_ONCE_COUNT):
        batch, found = suspects[start : start + RECORDS_AT_ONCE_COUNT], ScrubReport()
        async with caught_up(custodian, open_facts) as (facts, _):
            judge, clips = RecordComparer(custodian, store, facts), await store.clips(batch)
            for record_id in batch:
                await judge.compare(record_id, facts.record(record_id), clips.get(record_id), found)
            records = map(facts.record, found.missing)
            absent = tuple(record.facts for record in records if record is not None)
            await store.apply(BlockEffects(missing=await _not_listed(store, absent)))
        report.add_findings(found)


async def _count_dirty_slots(keys: ErasableKeys) -> int:
    parts = range(0, keys.capacity_count, SLOTS_AT_ONCE_COUNT)
    return sum([await asyncio.to_thread(keys.check_destroyed, start, SLOTS_AT_ONCE_COUNT) for start in parts])


async def _may_hold_unclaimed_keys(store: CustodyStore, keys: ErasableKeys) -> bool:
    """A key that comes or goes during a walk looks unclaimed in that one only."""
    suspects = set(await find_unclaimed_keys(store, keys, frozenset()))
    for _ in range(KEY_WALKS_MAX_COUNT - 1):
        if suspects:
            suspects.intersection_update(await find_unclaimed_keys(store, keys, frozenset()))
    return bool(suspects)


async def _among_unclaimed(store: CustodyStore, record_ids: Sequence[bytes]) -> list[bytes]:
    held = {place.record_id for place in await store.frame_places(record_ids)}
    clips = await store.clips(sorted(held))
    return [each for each in record_ids if each in held and _is_unclaimed(clips.get(each))]


def _is_unclaimed(clip: ClipRow | None) -> bool:
    return clip is None or clip.status == "erased"


async def find_withdrawn_frames(store: CustodyStore, facts: ChainFacts) -> list[bytes]:
    return [digest for digest in await store.background_digests() if not facts.is_empty_frame_approved(digest)]


async def _not_listed(store: CustodyStore, absent: Iterable[RecordFacts]) -> tuple[RecordFacts, ...]:
    all_absent = list(absent)
    listed = await store.missing_clips([facts.record_id for facts in all_absent])
    return tuple([facts for facts in all_absent if facts.record_id not in listed])


async def find_unclaimed_frames(store: CustodyStore) -> list[bytes]:
    """Return records with frames but no clip; for certain only at rest."""
    found: list[bytes] = []
    batch: list[bytes] = []

    async def check() -> None:
        clips = await store.clips(batch)
        found.extend(each for each in batch if _is_unclaimed(clips.get(each)))
        batch.clear()

    async for record_id in store.records_with_frames():
        batch.append(record_id)
        if len(batch) >= RECORDS_AT_ONCE_COUNT:
            await check()
    await check()
    return found


async def find_ended_parts(store: CustodyStore, facts: ChainFacts) -> list[tuple[bytes, bytes]]:
    """Return (grant, record) of parts to be destroyed; for certain only at rest."""
    standing, ended = facts.shares()
    denied = {row.owner for row in facts.visit_restrictions() if row.quarantined}
    found: list[tuple[bytes, bytes]] = []
    async for place in store.all_parts():
        was_final = place.status == "confirmed" or place.grant_id in ended
        record = facts.record(place.record_id)
        is_kept = record is not None and record.is_kept(facts.point.timestamp_ms)
        share = standing.get(place.grant_id)
        is_granted = not was_final or (share is not None and place.record_id in share.records)
        if not is_kept or place.owner in denied or not is_granted:
            found.append((place.grant_id, place.record_id))
    return found


async def find_unclaimed_keys(store: CustodyStore, keys: ErasableKeys, in_flight: frozenset[int]) -> list[int]:
    """Return keyed slots neither named nor in flight; for certain only at rest."""
    claimed = bytearray(keys.capacity_count)
    async for slot in store.slots_in_use():
        if slot < len(claimed):
            claimed[slot] = True
    return [slot for slot in await asyncio.to_thread(keys.find_unclaimed, claimed) if slot not in in_flight]

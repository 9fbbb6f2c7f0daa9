"""In-memory custody store and erase keys for the simulator; writes are atomic."""

from __future__ import annotations

import copy
import random
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from consensus.errors import BlockRobotError
from network.sim.world.custody_shares import MemoryShares
from node.custody.erase_keys import ERASE_KEY_BYTES
from node.custody.stores.custody_store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    FramePlace,
    FrameRow,
    Grant,
    Leftovers,
    OutboxRow,
    OutboxStatus,
    RecordFacts,
    StoreCounts,
    VisitRestrictions,
)
from node.custody.uploads import USAGE_KEPT_DAYS, DayUse, Use


class MemoryUploads:
    """In-memory `UploadAccount`, part of `MemoryCustodyStore`."""

    if TYPE_CHECKING:  # the store's own
        _clips: dict[bytes, ClipRow]
        _day_uses: dict[tuple[int, bytes], int]

        def _require_open(self) -> None: ...

        async def _begin_writing(self) -> None: ...

    async def use_by_robot(self, status: str) -> dict[bytes, Use]:
        self._require_open()
        used: dict[bytes, Use] = {}
        for clip in self._clips.values():
            if clip.status == status:
                used[clip.robot] = used.get(clip.robot, Use()) + Use(1, clip.size_bytes)
        return used

    async def add_use(self, use: DayUse) -> None:
        await self._begin_writing()
        place = (use.day, use.robot)
        self._day_uses[place] = self._day_uses.get(place, 0) + use.size_bytes
        for old in [place for place in self._day_uses if place[0] < use.day - USAGE_KEPT_DAYS]:
            del self._day_uses[old]

    async def day_uses(self) -> list[DayUse]:
        self._require_open()
        return [DayUse(*place, size_bytes) for place, size_bytes in sorted(self._day_uses.items())]


Pause = Callable[[], Awaitable[None]]


async def no_pause() -> None:
    """Write at once."""


class MemoryCustodyStore(MemoryShares, MemoryUploads):
    """In-memory `CustodyStore`; `pause` is awaited before each write."""

    def __init__(self, pause: Pause = no_pause) -> None:
        super().__init__()
        self._pause = pause
        self._is_open = True
        self._clips: dict[bytes, ClipRow] = {}
        self._frames: dict[bytes, dict[int, FrameRow]] = {}
        self._missing: dict[bytes, RecordFacts] = {}
        self._grants: dict[bytes, Grant] = {}
        self._standings: dict[bytes, VisitRestrictions] = {}
        self._outbox: dict[tuple[str, bytes, int], OutboxRow] = {}
        self._backgrounds: dict[bytes, bytes] = {}
        self._day_uses: dict[tuple[int, bytes], int] = {}
        self._checkpoint: Checkpoint | None = None

    async def __aenter__(self) -> Self:
        self._is_open = True
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_open = False

    def _require_open(self) -> None:
        if not self._is_open:
            raise BlockRobotError("STORE_UNAVAILABLE", "The store is not open.")

    async def _begin_writing(self) -> None:
        self._require_open()
        await self._pause()

    async def stage(self, clip: ClipRow, frames: Sequence[FrameRow]) -> None:
        await self._begin_writing()
        self._clips[clip.record_id] = clip
        self._frames[clip.record_id] = {frame.index: frame for frame in frames}

    async def correct(self, facts: RecordFacts) -> None:
        await self._begin_writing()
        clip = self._clips.get(facts.record_id)
        if clip is not None and clip.status == "confirmed":
            self._clips[facts.record_id] = replace(
                clip, txid=facts.txid, owner=facts.owner, expires_at_ms=facts.expires_at_ms, height=facts.height
            )

    async def replace_frames(self, record_id: bytes, frames: Sequence[FrameRow]) -> None:
        await self._begin_writing()
        self._frames[record_id] = {frame.index: frame for frame in frames}

    async def extend_staged(self, record_id: bytes, txid: bytes, valid_until_ms: int) -> None:
        await self._begin_writing()
        clip = self._clips.get(record_id)
        if clip is not None and clip.status == "staged":
            self._clips[record_id] = replace(clip, txid=txid, valid_until_ms=valid_until_ms)

    async def apply(self, effects: BlockEffects) -> None:
        await self._begin_writing()
        for row in effects.outbox:
            self._outbox.setdefault(row.key, row)
        self._standings.update({standing.owner: standing for standing in effects.standings})
        for record_id, expires_at_ms in effects.expiries:
            clip = self._clips.get(record_id)
            if clip is not None and clip.status == "confirmed":
                self._clips[record_id] = replace(clip, expires_at_ms=expires_at_ms)
        for facts in effects.confirmed:
            clip = self._clips.get(facts.record_id)
            if clip is not None and clip.status == "staged":
                self._clips[facts.record_id] = replace(
                    clip,
                    status="confirmed",
                    txid=facts.txid,
                    owner=facts.owner,
                    expires_at_ms=facts.expires_at_ms,
                    height=facts.height,
                )
            self._missing.pop(facts.record_id, None)
        self._missing.update({facts.record_id: facts for facts in effects.missing})
        self._grants.update({grant.access_id: grant for grant in effects.grants})
        for key in effects.settled:
            self._outbox.pop(key, None)
        if effects.checkpoint is not None:
            self._checkpoint = point = effects.checkpoint
            for facts in [facts for facts in self._missing.values() if facts.expires_at_ms <= point.timestamp_ms]:
                del self._missing[facts.record_id]

    async def checkpoint(self) -> Checkpoint | None:
        self._require_open()
        return self._checkpoint

    async def clips(self, record_ids: Sequence[bytes]) -> dict[bytes, ClipRow]:
        self._require_open()
        return {record_id: self._clips[record_id] for record_id in record_ids if record_id in self._clips}

    async def clips_of_owner(self, owner: bytes) -> list[ClipRow]:
        self._require_open()
        found = [clip for clip in self._clips.values() if clip.owner == owner and clip.status == "confirmed"]
        return sorted(found, key=lambda clip: clip.record_id)

    async def frames(self, record_id: bytes) -> list[FrameRow]:
        self._require_open()
        return [frame for _, frame in sorted(self._frames.get(record_id, {}).items())]

    async def frame_places(self, record_ids: Sequence[bytes]) -> list[FramePlace]:
        self._require_open()
        return [
            FramePlace(record_id, index, frame.slot)
            for record_id in sorted(record_ids)
            for index, frame in sorted(self._frames.get(record_id, {}).items())
        ]

    async def erase_frames(self, record_id: bytes, indexes: Sequence[int]) -> None:
        await self._begin_writing()
        for index in indexes:
            self._frames.get(record_id, {}).pop(index, None)

    async def erase_clip(self, record_id: bytes) -> None:
        await self._begin_writing()
        self._frames.pop(record_id, None)
        self._missing.pop(record_id, None)
        self._clips[record_id] = ClipRow(record_id, b"", 0, "erased", (), ())

    async def drop_staged(self, record_id: bytes) -> None:
        await self._begin_writing()
        clip = self._clips.get(record_id)
        if clip is not None and clip.status == "staged":
            del self._clips[record_id]
            self._frames.pop(record_id, None)

    async def sweep(self) -> None:
        """There is no file that could hold deleted rows."""

    async def lapsed(self, at_ms: int, limit: int) -> list[bytes]:
        self._require_open()
        due = [clip for clip in self._clips.values() if clip.status == "staged" and clip.valid_until_ms <= at_ms]
        return [clip.record_id for clip in sorted(due, key=lambda clip: (clip.valid_until_ms, clip.record_id))][:limit]

    async def expired(self, at_ms: int, limit: int) -> list[bytes]:
        self._require_open()
        due = [clip for clip in self._clips.values() if clip.status == "confirmed" and clip.expires_at_ms <= at_ms]
        return [clip.record_id for clip in sorted(due, key=lambda clip: (clip.expires_at_ms, clip.record_id))][:limit]

    async def missing(self, limit: int) -> list[RecordFacts]:
        self._require_open()
        return sorted(self._missing.values(), key=lambda facts: (-facts.height, facts.record_id))[:limit]

    async def missing_clip(self, record_id: bytes) -> RecordFacts | None:
        self._require_open()
        return self._missing.get(record_id)

    async def missing_of_owner(self, owner: bytes) -> list[RecordFacts]:
        self._require_open()
        found = [facts for facts in self._missing.values() if facts.owner == owner]
        return sorted(found, key=lambda facts: facts.record_id)

    async def grant(self, access_id: bytes) -> Grant | None:
        self._require_open()
        return self._grants.get(access_id)

    async def grants_of_owner(self, owner: bytes) -> list[Grant]:
        self._require_open()
        found = [grant for grant in self._grants.values() if grant.owner == owner]
        return sorted(found, key=lambda grant: grant.access_id)

    async def standings(self, owners: Sequence[bytes] | None = None) -> dict[bytes, VisitRestrictions]:
        self._require_open()
        asked = self._standings if owners is None else owners
        return {owner: self._standings[owner] for owner in asked if owner in self._standings}

    async def put_background(self, digest: bytes, content: bytes) -> None:
        await self._begin_writing()
        self._backgrounds[digest] = content

    async def background(self, digest: bytes) -> bytes | None:
        self._require_open()
        return self._backgrounds.get(digest)

    async def background_digests(self) -> list[bytes]:
        self._require_open()
        return sorted(self._backgrounds)

    async def delete_backgrounds(self, digests: Sequence[bytes]) -> None:
        await self._begin_writing()
        for digest in digests:
            self._backgrounds.pop(digest, None)

    async def add_outbox(self, row: OutboxRow) -> None:
        await self._begin_writing()
        self._outbox.setdefault(row.key, row)

    async def mark_outbox_ready(self, key: tuple[str, bytes, int]) -> None:
        await self._begin_writing()
        if key in self._outbox:
            self._outbox[key] = replace(self._outbox[key], status="ready", plan=b"")

    async def remove_outbox(self, key: tuple[str, bytes, int]) -> None:
        await self._begin_writing()
        self._outbox.pop(key, None)

    async def outbox(self, status: OutboxStatus, contract: str, limit: int) -> list[OutboxRow]:
        self._require_open()
        rows = [row for row in self._outbox.values() if (row.status, row.contract) == (status, contract)]
        return sorted(rows, key=lambda row: (row.height, *row.key))[:limit]

    async def outbox_of(self, kind: str, subject: bytes) -> list[OutboxRow]:
        self._require_open()
        rows = [row for row in self._outbox.values() if (row.kind, row.subject) == (kind, subject)]
        return sorted(rows, key=lambda row: row.part)

    def image(self) -> dict[str, Any]:
        return {name: copy.deepcopy(value) for name, value in vars(self).items() if name != "_pause"}

    def restore(self, image: dict[str, Any]) -> None:
        """Replace everything by a backup. Only while the node is down."""
        vars(self).update(image)

    def holdings(self) -> Holdings:
        by_status: dict[str, list[bytes]] = {"staged": [], "confirmed": [], "erased": []}
        for record_id, clip in self._clips.items():
            by_status[clip.status].append(record_id)
        slots = {record_id: [frame.slot for frame in frames.values()] for record_id, frames in self._frames.items()}
        return Holdings(
            self._checkpoint,
            by_status["confirmed"],
            list(self._missing),
            by_status["erased"],
            list(self._grants),
            slots,
        )

    async def all_clips(self) -> AsyncIterator[ClipRow]:
        self._require_open()
        for _, clip in sorted(self._clips.items()):
            yield clip

    async def slots_in_use(self) -> AsyncIterator[int]:
        self._require_open()
        slots = [frame.slot for frames in self._frames.values() for frame in frames.values()]
        for slot in sorted([*slots, *(row.slot for row in self._parts.values())]):
            yield slot

    async def records_with_frames(self) -> AsyncIterator[bytes]:
        self._require_open()
        for record_id in sorted(record_id for record_id, frames in self._frames.items() if frames):
            yield record_id

    async def counts(self) -> StoreCounts:
        self._require_open()
        clips = [clip.status for clip in self._clips.values()]
        owed = [row.status for row in self._outbox.values()]
        return StoreCounts(
            staged=clips.count("staged"),
            confirmed=clips.count("confirmed"),
            erased=clips.count("erased"),
            frames=sum(len(kept) for kept in self._frames.values()),
            missing=len(self._missing),
            owed=owed.count("ready"),
            owed_erasures=owed.count("erasing"),
            size_bytes=None,
            shares=len(self._shares),
            parts=len(self._parts),
        )

    async def leftovers(self) -> Leftovers:
        self._require_open()
        return Leftovers(0, 0)


@dataclass(frozen=True, slots=True)
class Holdings:
    """What a store holds at one moment: record ids, access ids, frame slots."""

    checkpoint: Checkpoint | None
    confirmed: list[bytes]
    missing: list[bytes]
    erased: list[bytes]
    granted: list[bytes]
    slots: dict[bytes, list[int]]

    def slots_of(self, record_ids: Iterable[bytes]) -> list[int]:
        return [slot for record_id in sorted(record_ids) for slot in self.slots.get(record_id, [])]


class MemoryEraseKeys:
    """In-memory `ErasableKeys`; keys come from the seeded dice."""

    def __init__(self, dice: random.Random) -> None:
        self._dice = dice
        self._keys: dict[int, bytes] = {}
        self._destroyed: set[int] = set()
        self._next_slot = 0

    def allocate(self, count: int) -> list[tuple[int, bytes]]:
        """Return new slots with keys; slots are never reused."""
        taken = [(self._next_slot + offset, self._dice.randbytes(ERASE_KEY_BYTES)) for offset in range(count)]
        self._next_slot += count
        self._keys.update((slot, bytes(bytearray(key))) for slot, key in taken)  # the caller wipes its own
        return taken

    def read(self, slot: int) -> bytes | None:
        key = self._keys.get(slot)
        return None if key is None else bytes(bytearray(key))

    def destroy(self, slots: Sequence[int]) -> None:
        for slot in slots:
            if self._keys.pop(slot, None) is not None:
                self._destroyed.add(slot)

    def release(self, slots: Sequence[int]) -> None:
        self._destroyed.difference_update(slots)

    def reconcile(self, in_use: Iterable[int]) -> int:
        kept = set(in_use)
        orphans = sorted(slot for slot in (*self._keys, *self._destroyed) if slot not in kept)
        self.destroy(orphans)
        self.release(orphans)
        return len(orphans)

    @property
    def held(self) -> list[int]:
        return sorted(self._keys)

    def check_destroyed(self) -> int:
        return 0

    @property
    def capacity_count(self) -> int:
        return self._next_slot

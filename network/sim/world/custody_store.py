"""The embedded custody store in the simulator's memory, and erase keys that its dice give."""

from __future__ import annotations

import random
import sqlite3
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from node.custody.erase_keys import ERASE_KEY_BYTES
from node.custody.stores.custody_store import Checkpoint, ClipRow, FrameRow, Leftovers, Unwritten
from node.custody.stores.sqlite_schema import SCHEMA
from node.custody.stores.sqlite_store import SqliteStore

T = TypeVar("T")
IN_MEMORY = ":memory:"


class SimCustodyStore(SqliteStore):
    """A `CustodyStore` that outlives its node's lives; `pause` is awaited before each write, which is atomic.

    `note_kept` is told of each clip that comes, staged or fetched.
    """

    def __init__(
        self, pause: Callable[[], Awaitable[None]], note_kept: Callable[[bytes], None] = lambda _record_id: None
    ) -> None:
        super().__init__(Path(IN_MEMORY))
        self._pause, self._note_kept = pause, note_kept
        self._memory = sqlite3.connect(IN_MEMORY)
        self._memory.executescript(SCHEMA)

    def _opened(self) -> sqlite3.Connection:
        return self._memory

    async def _in_worker(self, work: Callable[[], T]) -> T:
        return work()

    async def _write(self, work: Callable[[sqlite3.Connection], None]) -> None:
        await self._pause()
        with self._memory as database:
            work(database)

    async def stage_all(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        unwritten = await super().stage_all(clips)
        for clip, _ in clips:
            if clip.record_id not in unwritten:
                self._note_kept(clip.record_id)
        return unwritten

    async def sweep(self) -> None:
        """There is no file that could hold deleted rows."""

    async def leftovers(self) -> Leftovers:
        return Leftovers(0, 0)

    def close(self) -> None:
        self._memory.close()

    def image(self) -> bytes:
        return self._memory.serialize()

    def restore(self, image: bytes) -> None:
        """Only while the node is down."""
        self._memory.deserialize(image)

    def holdings(self) -> Holdings:
        read = self._memory.execute
        point = read("SELECT height, block_id, timestamp_ms FROM checkpoint").fetchone()
        by_status, slots = defaultdict[str, list[bytes]](list), defaultdict[bytes, list[int]](list)
        for record_id, status in read("SELECT record_id, status FROM clips"):
            by_status[status].append(record_id)
        for record_id, slot in read("SELECT record_id, slot FROM frames"):
            slots[record_id].append(slot)
        return Holdings(
            None if point is None else Checkpoint(*point),
            by_status["staged"],
            by_status["confirmed"],
            [row[0] for row in read("SELECT record_id FROM missing WHERE elsewhere = 0")],
            [row[0] for row in read("SELECT record_id FROM missing WHERE elsewhere = 1")],
            by_status["erased"],
            [row[0] for row in read("SELECT access_id FROM grants")],
            slots,
            read("SELECT count(*) FROM outbox").fetchone()[0],
        )


@dataclass(frozen=True, slots=True)
class Holdings:
    """What a store holds at one moment: record ids, access ids, frame slots, and how much it owes to the chain."""

    checkpoint: Checkpoint | None
    staged: list[bytes]
    confirmed: list[bytes]
    missing: list[bytes]
    elsewhere: list[bytes]
    erased: list[bytes]
    granted: list[bytes]
    slots: dict[bytes, list[int]]
    owed: int

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
        """Slots are never reused."""
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
    def held_count(self) -> int:
        return len(self._keys)

    def find_unclaimed(self, claimed: bytearray) -> list[int]:
        return sorted(slot for slot in self._keys if slot >= len(claimed) or not claimed[slot])

    def check_destroyed(self, first: int = 0, count: int | None = None) -> int:  # noqa: ARG002 - what is gone is gone
        return 0

    @property
    def capacity_count(self) -> int:
        return self._next_slot

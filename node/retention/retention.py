"""Below which height block bodies may be dropped, by block time.

Required: older than the longest retention and transaction lifetime, all records erased or expired (delay limited by
`LIVE_RECORD_HELD_MAX_MS`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

from consensus.chain.block import ContractEvent, Header
from consensus.errors import BlockRobotError
from consensus.limits import RETENTION_MAX_MS, TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.encoding import decode, decode_value
from consensus.state.records import RECORD
from consensus.state.rights import RESTRICTION
from node.custody.restrictions import prolong, restrictions_from_row
from node.snapshot.making import read_header_bytes
from node.storage.ledger_store import EventCursor, LedgerSnapshot, LedgerStore

BLOCKS_KEPT_MS = RETENTION_MAX_MS + TRANSACTION_LIFETIME_MAX_MS
LIVE_RECORD_HELD_MAX_MS = 2 * RETENTION_MAX_MS + TRANSACTION_LIFETIME_MAX_MS
BLOCKS_AT_ONCE_COUNT = 8
"""How many blocks are searched for live records before others may work."""
EVENTS_AT_ONCE_COUNT = 256
_LIVE = frozenset({"active", "erasing"})


class HeldBy(StrEnum):
    """Why a block body that is old enough is still there."""

    NOTHING = ""
    FLOOR = "keep_blocks"
    CUSTODIAN = "custodian"
    RECORD = "record"


class Cutoff(NamedTuple):
    """Bodies below `height` may go; and what keeps the next one."""

    height: int
    held_by: HeldBy


def highest_prunable(head: int, keep: int, followed: int | None) -> int:
    """Return the height below which bodies may go.

    `followed`: custodian's checkpoint height (-1: none yet; None: no custodian).
    """
    below = head - keep + 1
    return max(0, below if followed is None else min(below, followed + 1))


def read_time_ms(view: LedgerSnapshot, height: int) -> int:
    """Raises STORAGE_DAMAGED."""
    data = read_header_bytes(view, height)
    if data is None:
        raise BlockRobotError("STORAGE_DAMAGED", f"The ledger does not hold the header of block {height}.")
    return decode(data, Header).timestamp_ms


def find_first_since(view: LedgerSnapshot, since_ms: int, first: int, last: int) -> int:
    """Return the first height whose block is not older, or `last` + 1."""
    low, high = first, last + 1
    while low < high:
        middle = (low + high) // 2
        if read_time_ms(view, middle) < since_ms:
            low = middle + 1
        else:
            high = middle
    return low


def find_live_record(view: LedgerSnapshot, height: int, now_ms: int) -> bytes | None:
    return next((record_id for record_id in _recorded_in(view, height) if is_live(view, record_id, now_ms)), None)


def is_live(view: LedgerSnapshot, record_id: bytes, now_ms: int) -> bool:
    """Neither erased nor expired (restrictions included)."""
    row = RECORD.at(view, record_id)
    if row is None or row.status not in _LIVE:
        return False
    restricted = restrictions_from_row(row.owner, RESTRICTION.at(view, row.owner))
    return prolong(restricted, record_id, row.expires_at_ms) > now_ms


def _recorded_in(view: LedgerSnapshot, height: int) -> Iterator[bytes]:
    place = EventCursor(height, 0)
    while True:
        rows = view.events(place, EVENTS_AT_ONCE_COUNT)
        for at, data in rows:
            if at.height != height:
                return
            event = decode(data, ContractEvent)
            if (event.contract, event.name) == ("records", "recorded"):
                record_id = decode_value(event.data).get("record_id")
                if isinstance(record_id, bytes):
                    yield record_id
        if len(rows) < EVENTS_AT_ONCE_COUNT:
            return
        place = rows[-1][0].next


class Retention:
    """Finds one ledger's cut-off repeatedly; each block is searched for live records once."""

    def __init__(self, ledger: LedgerStore) -> None:
        self._ledger = ledger
        self._searched_below = 0
        """No block below holds a live record, and none will again; the block of this height may hold `_live`."""
        self._live: bytes | None = None
        self._earliest: tuple[int, int] | None = None

    def earliest(self) -> tuple[int, int]:
        """Height and time (ms) of the oldest block with a body."""
        with self._ledger.snapshot() as view:
            if self._earliest is None or self._earliest[0] != view.earliest_height:
                self._earliest = view.earliest_height, read_time_ms(view, view.earliest_height)
        return self._earliest

    async def find_cutoff(self, keep: int, followed: int | None) -> Cutoff:
        """Return the cut-off at the newest block; `followed` as in `highest_prunable`. Raises STORAGE_DAMAGED."""
        position = self._ledger.position
        if position is None:
            return Cutoff(0, HeldBy.NOTHING)
        earliest, earliest_ms = self.earliest()
        if earliest_ms >= position.timestamp_ms - BLOCKS_KEPT_MS:
            return Cutoff(earliest, HeldBy.NOTHING)
        with self._ledger.snapshot() as view:
            old = find_first_since(view, position.timestamp_ms - BLOCKS_KEPT_MS, earliest, position.height)
            older = find_first_since(view, position.timestamp_ms - LIVE_RECORD_HELD_MAX_MS, earliest, old)
        floor = highest_prunable(position.height, keep, None)
        below = min(old, highest_prunable(position.height, keep, followed))
        live = await self._find_live(older, below, position.timestamp_ms)
        if live < below:
            return Cutoff(live, HeldBy.RECORD)
        if below < min(old, floor):
            return Cutoff(below, HeldBy.CUSTODIAN)
        return Cutoff(below, HeldBy.FLOOR if below < old else HeldBy.NOTHING)

    async def _find_live(self, first: int, below: int, now_ms: int) -> int:
        if first > self._searched_below:
            self._searched_below, self._live = first, None
        while self._searched_below < below:
            with self._ledger.snapshot() as view:
                if self._live is None or not is_live(view, self._live, now_ms):
                    self._search(view, min(below, self._searched_below + BLOCKS_AT_ONCE_COUNT), now_ms)
            if self._live is not None:
                return self._searched_below
            await asyncio.sleep(0)
        return below

    def _search(self, view: LedgerSnapshot, below: int, now_ms: int) -> None:
        while self._searched_below < below:
            self._live = find_live_record(view, self._searched_below, now_ms)
            if self._live is not None:
                return
            self._searched_below += 1

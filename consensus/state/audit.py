"""State of the contract `audit`: numbered visit entries and daily counts."""

from __future__ import annotations

from typing import Any

from consensus.state.keys import HASH_BYTES, KEY_BYTES, TEXT, U32_BYTES, ListRow, Prefix, Reader, Row

AUDIT = "audit"


class EntryRow(Row, frozen=True):
    """An event of a visit; `record_id` is empty for several, `data` depends on the kind."""

    record_id: bytes
    kind: str
    time: int
    height: int
    data: dict[str, Any]


class DayRow(ListRow, frozen=True):
    """Number of statements on the last day with one (UTC days since 1970)."""

    day: int
    count: int


ENTRY: Prefix[EntryRow] = Prefix(AUDIT, "entry/", (KEY_BYTES, U32_BYTES), EntryRow)
COUNT: Prefix[int] = Prefix(AUDIT, "count/", (KEY_BYTES,), int)
"""How many entries a visit has."""
DAY_OF_VISIT: Prefix[DayRow] = Prefix(AUDIT, "day/", (TEXT, b"/", KEY_BYTES), DayRow)
"""By contract and visit."""
DAY_OF_GRANT: Prefix[DayRow] = Prefix(AUDIT, "day/", (TEXT, b"/", HASH_BYTES), DayRow)
"""By contract and grant."""
DAY_OF_OFFICERS: Prefix[DayRow] = Prefix(AUDIT, "day/", (TEXT, b"/officers/", KEY_BYTES), DayRow)
"""By contract and visit, of what officers say of it."""
LAYOUT = (ENTRY, COUNT, DAY_OF_VISIT, DAY_OF_GRANT, DAY_OF_OFFICERS)


def entry_keys(owner: bytes, count: int, first: int = 0) -> list[bytes]:
    return [ENTRY.key(owner, number) for number in range(first, count)]


def entry_count(state: Reader, owner: bytes) -> int:
    return COUNT.at(state, owner) or 0

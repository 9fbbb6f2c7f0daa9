"""What the contract `audit` keeps: the numbered entries of each visit, and how many words of a day were said."""

from __future__ import annotations

from typing import Any

from consensus.state.keys import HASH, KEY, TEXT, U32, ListRow, Prefix, Reader, Row

AUDIT = "audit"


class EntryRow(Row, frozen=True):
    """One event of a visit; `record_id` is empty if it is about several, and `data` depends on the kind."""

    record_id: bytes
    kind: str
    time: int
    height: int
    data: dict[str, Any]


class DayRow(ListRow, frozen=True):
    """How many words were said on the last day (UTC, in days since 1970) on which one was."""

    day: int
    count: int


ENTRY: Prefix[EntryRow] = Prefix(AUDIT, "entry/", (KEY, U32), EntryRow)
COUNT: Prefix[int] = Prefix(AUDIT, "count/", (KEY,), int)
"""How many entries a visit has."""
DAY_OF_VISIT: Prefix[DayRow] = Prefix(AUDIT, "day/", (TEXT, b"/", KEY), DayRow)
"""By contract and visit."""
DAY_OF_GRANT: Prefix[DayRow] = Prefix(AUDIT, "day/", (TEXT, b"/", HASH), DayRow)
"""By contract and grant."""
DAY_OF_OFFICERS: Prefix[DayRow] = Prefix(AUDIT, "day/", (TEXT, b"/officers/", KEY), DayRow)
"""By contract and visit, of what officers say of it."""
LAYOUT = (ENTRY, COUNT, DAY_OF_VISIT, DAY_OF_GRANT, DAY_OF_OFFICERS)


def entry_keys(owner: bytes, count: int, first: int = 0) -> list[bytes]:
    """Return the keys of a visit's entries from number `first` to before `count`, in order."""
    return [ENTRY.key(owner, number) for number in range(first, count)]


def entry_count(state: Reader, owner: bytes) -> int:
    """Return how many entries a visit has."""
    return COUNT.at(state, owner) or 0

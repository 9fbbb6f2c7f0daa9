"""State of the contract `mandates`: representatives and their acts."""

from __future__ import annotations

from typing import Any, Literal

from consensus.state.audit import DayRow
from consensus.state.identity import HANDLE, REMOVED, SUBJECT, active_role
from consensus.state.keys import HASH_BYTES, U32_BYTES, U64_BYTES, Prefix, Reader, Row, StateKey

MANDATES = "mandates"
REPRESENTATIVE_ROLES = frozenset({"officer", "staff", "subject"})

Status = Literal["proposed", "approved", "active", "ended"]
Standing = Literal["proposed", "approved", "active", "ended", "lapsed", "resting"]


class MandateRow(Row, frozen=True):
    """A mandate or proposal; persons are handles, officers their former keys; times not reached are 0."""

    number: int
    handle: bytes
    representative: bytes
    org: str
    papers: bytes
    acts: list[str]
    until_ms: int
    status: Status
    proposer: bytes
    approver: bytes
    proposed_ms: int
    approved_ms: int
    accepted_ms: int
    ends_ms: int
    ended_ms: int
    ended_by: bytes


class ActRow(Row, frozen=True):
    """What was done under a mandate."""

    kind: str
    time: int
    height: int
    txid: bytes
    data: dict[str, Any]


MANDATE: Prefix[MandateRow] = Prefix(MANDATES, "mandate/", (HASH_BYTES,), MandateRow)
MANDATE_NUMBER: Prefix[bytes] = Prefix(MANDATES, "mandate-number/", (U64_BYTES,), bytes)
"""The id of a mandate by its number, from 0."""
MANDATE_COUNT: StateKey[int] = StateKey(MANDATES, "mandate-count", int)
"""How many were ever proposed."""
OF: Prefix[bytes] = Prefix(MANDATES, "of/", (HASH_BYTES,), bytes)
"""The mandate of a represented person that has not ended."""
ACT: Prefix[ActRow] = Prefix(MANDATES, "act/", (HASH_BYTES, U32_BYTES), ActRow)
ACT_COUNT: Prefix[int] = Prefix(MANDATES, "act-count/", (HASH_BYTES,), int)
"""How many acts a mandate has."""
DAY: Prefix[DayRow] = Prefix(MANDATES, "day/", (HASH_BYTES,), DayRow)
"""The acts of a mandate."""
PROPOSALS_DAY: Prefix[DayRow] = Prefix(MANDATES, "proposals/", (HASH_BYTES,), DayRow)
"""By the handle of the officer who proposed."""
PERSON: Prefix[bytes] = Prefix(MANDATES, "person/", (HASH_BYTES, U32_BYTES), bytes)
"""The mandates in which a person was ever named."""
PERSON_COUNT: Prefix[int] = Prefix(MANDATES, "person-count/", (HASH_BYTES,), int)
"""In how many mandates a person was ever named."""
LAYOUT = (MANDATE, MANDATE_NUMBER, MANDATE_COUNT, OF, ACT, ACT_COUNT, DAY, PROPOSALS_DAY, PERSON, PERSON_COUNT)


def is_represented(state: Reader, handle: bytes, now_ms: int) -> bool:
    mandate_id = OF.at(state, handle)
    row = None if mandate_id is None else MANDATE.at(state, mandate_id)
    return row is not None and row.status == "active" and now_ms < row.until_ms


def standing(state: Reader, row: MandateRow, now_ms: int) -> Standing:
    """Return a mandate's effective status.

    Lapsed: expired, or a party or the organisation gone; resting: the representative is represented.
    """
    last_ms = row.until_ms - 1
    if row.status in ("proposed", "approved"):
        last_ms = min(last_ms, row.ends_ms)
    if row.status != "ended" and now_ms > last_ms:
        return "lapsed"
    if row.status != "active":
        return row.status
    removed_ms = REMOVED.at(state, row.org)
    if removed_ms is not None and removed_ms >= row.proposed_ms:
        return "lapsed"
    if _role_of(state, row.handle) != SUBJECT or _role_of(state, row.representative) not in REPRESENTATIVE_ROLES:
        return "lapsed"
    return "resting" if is_represented(state, row.representative, now_ms) else "active"


def acting_for(state: Reader, handle: bytes, key: bytes, act: str, now_ms: int) -> bytes | None:
    mandate_id = OF.at(state, handle)
    row = None if mandate_id is None else MANDATE.at(state, mandate_id)
    if row is None or act not in row.acts or HANDLE.at(state, row.representative) != key:
        return None
    return mandate_id if standing(state, row, now_ms) == "active" else None


def _role_of(state: Reader, handle: bytes) -> str:
    member = HANDLE.at(state, handle)
    return "" if member is None else active_role(state, member)

"""State of the contract `rights`: restrictions, objections, corrections, quarantines, breaches."""

from __future__ import annotations

from typing import Literal

from consensus.state.keys import HASH_BYTES, KEY_BYTES, U32_BYTES, U64_BYTES, Prefix, Reader, Row, StateKey

RIGHTS = "rights"


class RestrictionRow(Row, frozen=True):
    """A visit's restriction: named records or `whole`; `until_ms` is 0 if nothing is kept longer."""

    ground: str
    whole: bool
    whole_since_ms: int
    until_ms: int
    records: list[bytes]
    time: int

    def covers(self, record_id: bytes) -> bool:
        return self.whole or record_id in self.records


class CorrectionRow(Row, frozen=True):
    """A correction: salted content hash and previous txid (empty for the first)."""

    records: list[bytes]
    kind: str
    commitment: bytes
    previous: bytes
    txid: bytes
    time: int
    height: int


class AssessedRow(Row, frozen=True):
    """A breach's last assessor, time and reason."""

    time: int
    officer: bytes
    reason: str


class NotifiedRow(Row, frozen=True):
    """Who notified a breach, when, and whether late."""

    time: int
    officer: bytes
    reason: str
    late: bool


class ClosedRow(Row, frozen=True):
    """Who closed a breach, when and how."""

    time: int
    officer: bytes
    outcome: Literal["erased", "released"]
    reason: str


class BreachRow(Row, frozen=True):
    """A breach; `notified` is by recipient."""

    number: int
    owner: bytes
    robot: bytes
    org: str
    kind: str
    status: Literal["opened", "assessed", "notified", "closed"]
    risk: Literal["", "none", "risk", "high"]
    opened_ms: int
    due_ms: int
    assessed: AssessedRow | None
    notified: dict[str, NotifiedRow]
    closed: ClosedRow | None


RESTRICTION: Prefix[RestrictionRow] = Prefix(RIGHTS, "restriction/", (KEY_BYTES,), RestrictionRow)
OBJECTION: Prefix[dict[str, int]] = Prefix(RIGHTS, "objection/", (KEY_BYTES,), dict[str, int])
"""Since when (ms) a purpose is objected to."""
CORRECTION: Prefix[CorrectionRow] = Prefix(RIGHTS, "correction/", (KEY_BYTES, U32_BYTES), CorrectionRow)
CORRECTION_COUNT: Prefix[int] = Prefix(RIGHTS, "correction-count/", (KEY_BYTES,), int)
"""How many corrections a visit has."""
QUARANTINE: Prefix[bytes] = Prefix(RIGHTS, "quarantine/", (KEY_BYTES,), bytes)
"""The id of the breach by which a visit is quarantined."""
BREACH: Prefix[BreachRow] = Prefix(RIGHTS, "breach/", (HASH_BYTES,), BreachRow)
BREACH_NUMBER: Prefix[bytes] = Prefix(RIGHTS, "breach-number/", (U64_BYTES,), bytes)
"""The id of a breach by its number, from 0."""
BREACH_COUNT: StateKey[int] = StateKey(RIGHTS, "breach-count", int)
"""How many breaches there ever were."""
LAYOUT = (
    RESTRICTION,
    OBJECTION,
    CORRECTION,
    CORRECTION_COUNT,
    QUARANTINE,
    BREACH,
    BREACH_NUMBER,
    BREACH_COUNT,
)


def correction_keys(owner: bytes, count: int) -> list[bytes]:
    return [CORRECTION.key(owner, number) for number in range(count)]


def is_held(state: Reader, owner: bytes, record_id: bytes, expires_at_ms: int, now_ms: int) -> bool:
    row = RESTRICTION.at(state, owner)
    if row is None or row.until_ms <= now_ms:
        return False
    return record_id in row.records or (row.whole and row.whole_since_ms < expires_at_ms)

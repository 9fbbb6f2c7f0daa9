"""What the contract `access` keeps: requests, releases, verdicts and grants; and whether a grant stands."""

from __future__ import annotations

from typing import Literal

from consensus.limits import GRANT_NOTICE_MS
from consensus.state.keys import HASH, KEY, RECORD_ID, U64, Prefix, Reader, Row, StateKey

ACCESS = "access"


class AccessRow(Row, frozen=True):
    """A request: how many records each custodian released, and why others refused. `grant` only if a grantee asked."""

    owner: bytes
    records: list[bytes]
    purpose: str
    time: int
    released: dict[bytes, int]
    refused: dict[bytes, str]
    grant: bytes = b""


class VerdictRow(Row, frozen=True):
    """The owner's last verdict on a record, and the frames that were changed."""

    verdict: Literal["verified", "corrupted"]
    frames: list[int]
    time: int


class GrantRow(Row, frozen=True):
    """A grant: records of a visit for one key of a grantee, for a purpose and until a time (ms)."""

    owner: bytes
    records: list[bytes]
    grantee: bytes
    ephemeral: bytes
    view_tag: int
    member_hash: bytes
    purpose: str
    until_ms: int
    ended_ms: int
    time: int
    height: int
    status: Literal["active", "revoked"]
    noticed: list[bytes]
    notices: int

    def is_open(self, now_ms: int) -> bool:
        """Whether it was not revoked, and its time is not over."""
        return self.status == "active" and now_ms < self.until_ms


REQUEST: Prefix[AccessRow] = Prefix(ACCESS, "access/", (HASH,), AccessRow)
VERDICT: Prefix[VerdictRow] = Prefix(ACCESS, "verdict/", (RECORD_ID,), VerdictRow)
RELEASE: Prefix[bool] = Prefix(ACCESS, "release/", (HASH, KEY, RECORD_ID), bool)
"""By request, custodian and record."""
GRANT: Prefix[GrantRow] = Prefix(ACCESS, "grant/", (HASH,), GrantRow)
GRANT_NUMBER: Prefix[bytes] = Prefix(ACCESS, "grant-number/", (U64,), bytes)
"""The id of a grant by its number, from 0."""
GRANT_COUNT: StateKey[int] = StateKey(ACCESS, "grant-count", int)
"""How many grants there ever were."""
OPEN_GRANTS: Prefix[dict[bytes, int]] = Prefix(ACCESS, "open-grants/", (KEY,), dict[bytes, int])
"""When the grants of a visit end, by id."""
LAYOUT = (REQUEST, VERDICT, RELEASE, GRANT, GRANT_NUMBER, GRANT_COUNT, OPEN_GRANTS)


def grant_of(state: Reader, grant_id: bytes, key: bytes, now_ms: int) -> GrantRow | None:
    """Return the grant of this id if it is this one-time key's: while it stands, and as long after as notices count.

    By its id, never by the key: another grant to the same key, or a visit under it, takes nothing from this one.
    """
    grant = GRANT.at(state, grant_id) if len(grant_id) == HASH else None
    if grant is None or grant.grantee != key or now_ms >= grant.ended_ms + GRANT_NOTICE_MS:
        return None
    return grant

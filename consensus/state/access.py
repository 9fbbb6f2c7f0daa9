"""State of the contract `access`: requests, releases, verdicts and grants."""

from __future__ import annotations

from typing import Literal

from consensus.limits import GRANT_NOTICE_MS
from consensus.state.keys import HASH_BYTES, KEY_BYTES, RECORD_ID_BYTES, U64_BYTES, Prefix, Reader, Row, StateKey

ACCESS = "access"


class AccessRow(Row, frozen=True):
    """A request: records released per custodian and refusal reasons; `grant` only for grantees."""

    owner: bytes
    records: list[bytes]
    purpose: str
    time: int
    released: dict[bytes, int]
    refused: dict[bytes, str]
    grant: bytes = b""


class VerdictRow(Row, frozen=True):
    """The owner's last verdict on a record, and its changed frames."""

    verdict: Literal["verified", "corrupted"]
    frames: list[int]
    time: int


class GrantRow(Row, frozen=True):
    """A grant: a visit's records for one grantee key, purpose and end time (ms)."""

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
        return self.status == "active" and now_ms < self.until_ms


REQUEST: Prefix[AccessRow] = Prefix(ACCESS, "access/", (HASH_BYTES,), AccessRow)
VERDICT: Prefix[VerdictRow] = Prefix(ACCESS, "verdict/", (RECORD_ID_BYTES,), VerdictRow)
RELEASE: Prefix[bool] = Prefix(ACCESS, "release/", (HASH_BYTES, KEY_BYTES, RECORD_ID_BYTES), bool)
"""By request, custodian and record."""
GRANT: Prefix[GrantRow] = Prefix(ACCESS, "grant/", (HASH_BYTES,), GrantRow)
GRANT_NUMBER: Prefix[bytes] = Prefix(ACCESS, "grant-number/", (U64_BYTES,), bytes)
"""The id of a grant by its number, from 0."""
GRANT_COUNT: StateKey[int] = StateKey(ACCESS, "grant-count", int)
"""How many grants there ever were."""
OPEN_GRANTS: Prefix[dict[bytes, int]] = Prefix(ACCESS, "open-grants/", (KEY_BYTES,), dict[bytes, int])
"""When the grants of a visit end, by id."""
LAYOUT = (REQUEST, VERDICT, RELEASE, GRANT, GRANT_NUMBER, GRANT_COUNT, OPEN_GRANTS)


def grant_of(state: Reader, grant_id: bytes, key: bytes, now_ms: int) -> GrantRow | None:
    """Return the grant if the key's, while open or within notice time; look up by id only."""
    grant = GRANT.at(state, grant_id) if len(grant_id) == HASH_BYTES else None
    if grant is None or grant.grantee != key or now_ms >= grant.ended_ms + GRANT_NOTICE_MS:
        return None
    return grant

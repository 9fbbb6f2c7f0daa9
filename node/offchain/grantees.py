"""Who may fetch what was shared, by the final state. Must never take a grantee's word for who she is.

Her one-time key says nothing of her; she shows the handle and the salt that make the hash on the chain, and the member
under that handle has to be of the staff, or an officer, now.
"""

from __future__ import annotations

from typing import Any

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.records.sharing import GRANTEE_ROLES, SharedRequest, hash_grant_member
from contracts.execution.standing import Reader, find_role


def _read(state: Reader, key: bytes) -> Any:
    value = state.get(key)
    return None if value is None else decode_value(value)


def require_open_grant(state: Reader, grant_id: bytes, now_ms: int) -> None:
    """Refuse parts for a grant that was revoked or is over; one that is not final yet passes. Raises GRANT_ENDED."""
    grant = _read(state, b"access\x00grant/" + grant_id)
    if grant is not None and (grant["status"] != "active" or grant["until_ms"] <= now_ms):
        raise BlockRobotError("GRANT_ENDED")


def require_grantee(state: Reader, request: SharedRequest, grant_id: bytes, grantee: bytes, now_ms: int) -> None:
    """Refuse unless this key (33 bytes, proven) is that of a grant that stands, asked under it, and shows who she is.

    Raises ACCESS_NOT_GRANTED, NOT_PERMITTED, GRANT_ENDED, GRANTEE_NOT_A_MEMBER.
    """
    grant = _read(state, b"access\x00grant/" + grant_id)
    if grant is None or grant["grantee"] != grantee:
        raise BlockRobotError("NOT_PERMITTED", "The grant is for another key.")
    asked = _read(state, b"access\x00access/" + request.access_id)
    if asked is None or asked.get("grant", b"") != grant_id or request.record_id not in asked["records"]:
        raise BlockRobotError("ACCESS_NOT_GRANTED")
    if grant["status"] != "active" or grant["until_ms"] <= now_ms:
        raise BlockRobotError("GRANT_ENDED")
    try:
        is_hers = hash_grant_member(request.salt, request.handle) == grant["member_hash"]
    except BlockRobotError:
        is_hers = False
    member = _read(state, b"identity\x00handle/" + request.handle) if is_hers else None
    if member is None or find_role(state, member) not in GRANTEE_ROLES:
        raise BlockRobotError("GRANTEE_NOT_A_MEMBER")

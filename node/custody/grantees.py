"""Checks grantees by the handle and salt they reveal, against final state."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.records.sharing import GRANTEE_ROLES, SharedRequest, hash_grant_member
from consensus.state.access import GRANT, REQUEST
from consensus.state.identity import HANDLE, active_role
from consensus.state.keys import Reader


def require_open_grant(state: Reader, grant_id: bytes, now_ms: int) -> None:
    """Raise GRANT_ENDED for a revoked or ended grant; unfinalized ones pass."""
    grant = GRANT.at(state, grant_id)
    if grant is not None and not grant.is_open(now_ms):
        raise BlockRobotError("GRANT_ENDED")


def require_grantee(state: Reader, request: SharedRequest, grant_id: bytes, grantee: bytes, now_ms: int) -> None:
    """Check that this proven 33-byte key holds a standing grant and its request.

    Raises ACCESS_NOT_GRANTED, NOT_PERMITTED, GRANT_ENDED, GRANTEE_NOT_A_MEMBER.
    """
    grant = GRANT.at(state, grant_id)
    if grant is None or grant.grantee != grantee:
        raise BlockRobotError("NOT_PERMITTED", "The grant is for another key.")
    asked = REQUEST.at(state, request.access_id)
    if asked is None or asked.grant != grant_id or request.record_id not in asked.records:
        raise BlockRobotError("ACCESS_NOT_GRANTED")
    if not grant.is_open(now_ms):
        raise BlockRobotError("GRANT_ENDED")
    try:
        is_theirs = hash_grant_member(request.salt, request.handle) == grant.member_hash
    except BlockRobotError:
        is_theirs = False
    member = HANDLE.at(state, request.handle) if is_theirs else None
    if member is None or active_role(state, member) not in GRANTEE_ROLES:
        raise BlockRobotError("GRANTEE_NOT_A_MEMBER")

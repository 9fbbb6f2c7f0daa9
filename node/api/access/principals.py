"""Resolves keys on the finalized state: member, custodian, visit owner, grantee."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from consensus.errors import BlockRobotError
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES
from consensus.state.access import grant_of
from consensus.state.identity import ADMIN, CUSTODIAN, CUSTODIANS, REGISTRAR, active_role
from consensus.state.keys import flat_prefix
from consensus.state.membership import MEMBERSHIP
from consensus.state.records import EMPTY_FRAME, decided_root
from contracts.execution.sender_admission import name_grantees, name_key
from node.storage.ledger_view import LedgerView

SessionKind = Literal["member", "owner", "grantee", "former-grantee"]
ROLE_ADMIN = "admin"
ROLE_REGISTRAR = "registrar"
ROLE_CUSTODIAN = "custodian"
_OPEN_ALWAYS = (flat_prefix(MEMBERSHIP),)
_OPEN_TO_GRANTEES = (*_OPEN_ALWAYS, CUSTODIANS.flat, CUSTODIAN.flat, EMPTY_FRAME.flat)


@dataclass(frozen=True, slots=True)
class Principal:
    """A key's kind and roles; all grantees of a visit share an `account`."""

    kind: SessionKind
    roles: frozenset[str]
    account: str = field(default="", compare=False)


def resolve_principal(snapshot: LedgerView, key: bytes, grant_id: bytes = b"") -> Principal | None:
    """Return what this 33-byte key stands for, or None.

    With a grant's id: only as its grantee, whatever else the key is.
    """
    if len(key) != PUBLIC_KEY_SIZE_BYTES:
        return None
    if grant_id:
        return _find_grantee_standing(snapshot, key, grant_id)
    roles: set[str] = set()
    role = active_role(snapshot, key)
    if role:
        roles.add(role)
    if REGISTRAR.has(snapshot, key):
        roles.add(ROLE_REGISTRAR)
    if CUSTODIAN.has(snapshot, key):
        roles.add(ROLE_CUSTODIAN)
    if not roles and ADMIN.has(snapshot, key):
        roles.add(ROLE_ADMIN)
    if roles:
        return Principal(kind="member", roles=frozenset(roles), account=name_key(snapshot, key))
    if decided_root(snapshot, key) is not None:
        return Principal(kind="owner", roles=frozenset(), account=name_key(snapshot, key))
    return None


def _find_grantee_standing(snapshot: LedgerView, key: bytes, grant_id: bytes) -> Principal | None:
    now_ms = snapshot.header.timestamp_ms
    grant = grant_of(snapshot, grant_id, key, now_ms)
    if grant is None:
        return None
    kind: SessionKind = "grantee" if now_ms < grant.ended_ms else "former-grantee"
    return Principal(kind=kind, roles=frozenset(), account=name_grantees(grant.owner))


def require_readable(
    snapshot: LedgerView, standing: SessionKind, reader: bytes, grant_id: bytes, keys: Iterable[bytes]
) -> None:
    """Raise NOT_PERMITTED for a grantee reading state outside their visit.

    Nodes, custodians and empty-frame approvals are readable while the grant stands.
    """
    if standing not in {"grantee", "former-grantee"}:
        return
    open_to_grantee = _OPEN_ALWAYS if standing == "former-grantee" else _OPEN_TO_GRANTEES
    grant = grant_of(snapshot, grant_id, reader, snapshot.header.timestamp_ms)
    if grant is None:
        raise BlockRobotError("NOT_PERMITTED")
    own = (grant.owner, grant_id, *grant.records)
    for key in keys:
        if not key.startswith(open_to_grantee) and not any(name in key for name in own):
            raise BlockRobotError(
                "NOT_PERMITTED", "The key of a grant reads only what is of its visit and its records."
            )

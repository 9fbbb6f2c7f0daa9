"""Who a key is on the finalized state: an active member, a custodian, who decides of a visit now, or a grantee.

Must never look at anything but finalized state: what could still be undone gives nobody a right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES
from contracts.execution.standing import find_role, find_root, has_grant
from node.api.services import LedgerSnapshot

SessionKind = Literal["member", "owner", "grantee"]
ROLE_ADMIN = "admin"
ROLE_REGISTRAR = "registrar"
ROLE_CUSTODIAN = "custodian"
_ORGANISATIONS_MAX_COUNT = 256


@dataclass(frozen=True, slots=True)
class Standing:
    """What a key may be: its kind, and the roles of a member."""

    kind: SessionKind
    roles: frozenset[str]


def state_key(contract: str, key: bytes) -> bytes:
    """Return the flat key of a contract's own key."""
    return contract.encode() + b"\x00" + key


def read_value(snapshot: LedgerSnapshot, contract: str, key: bytes) -> Any:
    """Return the decoded value under a contract's key, or None."""
    data = snapshot.get(state_key(contract, key))
    return None if data is None else decode_value(data)


def _is_admin(snapshot: LedgerSnapshot, key: bytes) -> bool:
    organisations = snapshot.scan(state_key("identity", b"org/"), _ORGANISATIONS_MAX_COUNT)
    return any(key in decode_value(value).get("admins", ()) for _, value in organisations)


def find_standing(snapshot: LedgerSnapshot, key: bytes) -> Standing | None:
    """Return what this 33-byte key stands for, or None. A key is a member or an owner, never both by design."""
    if len(key) != PUBLIC_KEY_SIZE_BYTES:
        return None
    roles: set[str] = set()
    role = find_role(snapshot, key)
    if role:
        roles.add(role)
    if read_value(snapshot, "identity", b"registrar/" + key) is not None:
        roles.add(ROLE_REGISTRAR)
    if read_value(snapshot, "identity", b"custodian/" + key) is not None:
        roles.add(ROLE_CUSTODIAN)
    if not roles and _is_admin(snapshot, key):
        roles.add(ROLE_ADMIN)
    if roles:
        return Standing(kind="member", roles=frozenset(roles))
    if find_root(snapshot, key) is not None:
        return Standing(kind="owner", roles=frozenset())
    if has_grant(snapshot, key):
        return Standing(kind="grantee", roles=frozenset())
    return None

"""What the contract `identity` keeps: members, handles, organisations' keys, custodians; and which role a key has now."""

from __future__ import annotations

from typing import Literal

from consensus.state.keys import HASH, KEY, TEXT, Prefix, Reader, Row, StateKey

IDENTITY = "identity"
SHORT_HANDLE = 10
SUBJECT = "subject"


class MemberRow(Row, frozen=True):
    """A member: the public keys are empty once the membership ended; `since` (ms) is when it got this status."""

    handle: bytes
    role: str
    org: str
    spend: bytes
    view: bytes
    sealing: bytes
    status: Literal["active", "rotated", "left", "revoked"]
    since: int

    @property
    def is_active(self) -> bool:
        """Whether the key is a member's still, whatever became of the organisation that let the member in."""
        return self.status == "active"


class OrganisationKeysRow(Row, frozen=True):
    """The keys that speak for an organisation; none once it was removed."""

    admins: list[bytes]
    registrars: list[bytes]


class CustodianRow(Row, frozen=True):
    """A custodian: the node's name and its organisation."""

    name: str
    org: str


class RobotNameRow(Row, frozen=True):
    """What an organisation calls a robot, and since when (ms)."""

    name: str
    place: str
    organisation: str
    time: int


MEMBER: Prefix[MemberRow] = Prefix(IDENTITY, "member/", (KEY,), MemberRow)
HANDLE: Prefix[bytes] = Prefix(IDENTITY, "handle/", (HASH,), bytes)
"""The member key of a handle."""
SHORT: Prefix[bytes] = Prefix(IDENTITY, "short-handle/", (SHORT_HANDLE,), bytes)
"""The handle that begins so."""
ORGANISATION: Prefix[OrganisationKeysRow] = Prefix(IDENTITY, "org/", (TEXT,), OrganisationKeysRow)
ADMIN: Prefix[str] = Prefix(IDENTITY, "admin/", (KEY,), str)
"""The organisation of an admin's key."""
REGISTRAR: Prefix[str] = Prefix(IDENTITY, "registrar/", (KEY,), str)
"""The organisation of a registrar's key."""
REMOVED: Prefix[int] = Prefix(IDENTITY, "removed/", (TEXT,), int)
"""When (ms) an organisation was last removed."""
CUSTODIAN: Prefix[CustodianRow] = Prefix(IDENTITY, "custodian/", (KEY,), CustodianRow)
CUSTODIANS: StateKey[list[bytes]] = StateKey(IDENTITY, "custodians", list[bytes])
"""The keys of all custodians, sorted."""
ROBOT_NAME: Prefix[RobotNameRow] = Prefix(IDENTITY, "robot-name/", (KEY,), RobotNameRow)
PURPOSE: Prefix[bool] = Prefix(IDENTITY, "purpose/", (TEXT,), bool)
"""There for each purpose that the genesis file names."""
CHANGES: StateKey[int] = StateKey(IDENTITY, "changes", int)
"""How often a member's keys or status changed."""
LAYOUT = (
    MEMBER,
    HANDLE,
    SHORT,
    ORGANISATION,
    ADMIN,
    REGISTRAR,
    REMOVED,
    CUSTODIAN,
    CUSTODIANS,
    ROBOT_NAME,
    PURPOSE,
    CHANGES,
)


def role_now(member: MemberRow | None, removed_ms: int | None) -> str:
    """Return the role of a member whose organisation was last removed at a time (None: never); empty if she has none.

    Only subjects outlast their organisation; who was registered before its removal stays out, should it come back.
    """
    if member is None or not member.is_active:
        return ""
    if member.role != SUBJECT and removed_ms is not None and member.since <= removed_ms:
        return ""
    return member.role


def active_role(state: Reader, member: bytes) -> str:
    """Return the role that a member key has now, or an empty text: what the view `role_of` says."""
    row = MEMBER.at(state, member)
    return "" if row is None else role_now(row, REMOVED.at(state, row.org))


def is_registered(state: Reader, member: bytes) -> bool:
    """Tell whether the key is an active member's, whatever became of the organisation that let the member in."""
    row = MEMBER.at(state, member)
    return row is not None and row.is_active


def member_with(state: Reader, handle: bytes) -> MemberRow | None:
    """Return the member who has, or had last, this handle; None for a handle of nobody."""
    key = HANDLE.at(state, handle)
    return None if key is None else MEMBER.at(state, key)


def handle_from(state: Reader, start: bytes) -> bytes | None:
    """Return the handle that begins so (10 bytes), or None: the one to which its short form leads."""
    handle = SHORT.at(state, start)
    return handle if handle is not None and handle.startswith(start) else None


def handle_of(state: Reader, key: bytes) -> bytes:
    """Return the handle under which this key is, or was, a member's; empty for a key of no member."""
    row = MEMBER.at(state, key)
    return b"" if row is None else row.handle


def organisation_of(state: Reader, member: bytes) -> str:
    """Return the organisation that registered a member, also a former one; empty for a key of no member."""
    row = MEMBER.at(state, member)
    return "" if row is None else row.org


def office_of(state: Reader, key: bytes) -> tuple[str, str] | None:
    """Return whose custodian, registrar or admin a key is: the office and a name, in this order; None for no office.

    A custodian's name is its node's, the others' that of their organisation.
    """
    custodian = CUSTODIAN.at(state, key)
    if custodian is not None:
        return "custodian", custodian.name
    for office, prefix in (("registrar", REGISTRAR), ("admin", ADMIN)):
        organisation = prefix.at(state, key)
        if organisation is not None:
            return office, organisation
    return None


def custodians(state: Reader) -> list[bytes]:
    """Return the keys of all who are custodians now, sorted."""
    return CUSTODIANS.read(state) or []

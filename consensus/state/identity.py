"""State of the contract `identity`: members, handles, organisation keys, custodians, roles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from consensus.state.audit import DayRow
from consensus.state.keys import HASH_BYTES, KEY_BYTES, TEXT, Prefix, Reader, Row, StateKey
from consensus.visible_text import find_hidden

IDENTITY = "identity"
SHORT_HANDLE_BYTES = 10
ROBOT_NAME_MAX_CHARS = 32
ROBOT_PLACE_MAX_CHARS = 48
ROOM_MAX_GIB = 16_777_216
SUBJECT = "subject"


class MemberRow(Row, frozen=True):
    """A member; public keys are empty after the membership ended, `since` (ms) dates the status."""

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
        return self.status == "active"


class OrganisationKeysRow(Row, frozen=True):
    """An organisation's keys; none once it was removed."""

    admins: list[bytes]
    registrars: list[bytes]


class CustodianRow(Row, frozen=True):
    """A custodian: the node's name and its organisation."""

    name: str
    org: str


class RoomRow(Row, frozen=True):
    """The room (GiB) that a custodian declares, 0: none, and since when (ms)."""

    gib: int
    time: int


class RobotNameRow(Row, frozen=True):
    """An organisation's name for a robot, and since when (ms)."""

    name: str
    place: str
    organisation: str
    time: int


MEMBER: Prefix[MemberRow] = Prefix(IDENTITY, "member/", (KEY_BYTES,), MemberRow)
HANDLE: Prefix[bytes] = Prefix(IDENTITY, "handle/", (HASH_BYTES,), bytes)
"""The member key of a handle."""
SHORT: Prefix[bytes] = Prefix(IDENTITY, "short-handle/", (SHORT_HANDLE_BYTES,), bytes)
"""The handle that begins so."""
ORGANISATION: Prefix[OrganisationKeysRow] = Prefix(IDENTITY, "org/", (TEXT,), OrganisationKeysRow)
ADMIN: Prefix[str] = Prefix(IDENTITY, "admin/", (KEY_BYTES,), str)
"""The organisation of an admin's key."""
REGISTRAR: Prefix[str] = Prefix(IDENTITY, "registrar/", (KEY_BYTES,), str)
"""The organisation of a registrar's key."""
REMOVED: Prefix[int] = Prefix(IDENTITY, "removed/", (TEXT,), int)
"""When (ms) an organisation was last removed."""
CUSTODIAN: Prefix[CustodianRow] = Prefix(IDENTITY, "custodian/", (KEY_BYTES,), CustodianRow)
CUSTODIANS: StateKey[list[bytes]] = StateKey(IDENTITY, "custodians", list[bytes])
"""The keys of all custodians, sorted."""
ROOM: Prefix[RoomRow] = Prefix(IDENTITY, "room/", (KEY_BYTES,), RoomRow)
"""Only of custodians that declared one."""
ROBOT_NAME: Prefix[RobotNameRow] = Prefix(IDENTITY, "robot-name/", (KEY_BYTES,), RobotNameRow)
PURPOSE: Prefix[bool] = Prefix(IDENTITY, "purpose/", (TEXT,), bool)
"""There for each purpose that the genesis file names."""
ROTATIONS: Prefix[DayRow] = Prefix(IDENTITY, "rotations/", (HASH_BYTES,), DayRow)
"""By handle: how often a member changed keys; each former key keeps its row."""
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
    ROOM,
    ROBOT_NAME,
    PURPOSE,
    ROTATIONS,
    CHANGES,
)


def role_now(member: MemberRow | None, removed_ms: int | None) -> str:
    """Return the role after the organisation's last removal (None: never), or empty; only subjects outlast it."""
    if member is None or not member.is_active:
        return ""
    if member.role != SUBJECT and removed_ms is not None and member.since <= removed_ms:
        return ""
    return member.role


def active_role(state: Reader, member: bytes) -> str:
    row = MEMBER.at(state, member)
    return "" if row is None else role_now(row, REMOVED.at(state, row.org))


def is_registered(state: Reader, member: bytes) -> bool:
    row = MEMBER.at(state, member)
    return row is not None and row.is_active


def member_with(state: Reader, handle: bytes) -> MemberRow | None:
    key = HANDLE.at(state, handle)
    return None if key is None else MEMBER.at(state, key)


def handle_from(state: Reader, start: bytes) -> bytes | None:
    handle = SHORT.at(state, start)
    return handle if handle is not None and handle.startswith(start) else None


def handle_of(state: Reader, key: bytes) -> bytes:
    """Return a present or former member's handle, or empty."""
    row = MEMBER.at(state, key)
    return b"" if row is None else row.handle


def organisation_of(state: Reader, member: bytes) -> str:
    """Return a present or former member's registering organisation, or empty."""
    row = MEMBER.at(state, member)
    return "" if row is None else row.org


def office_of(state: Reader, key: bytes) -> tuple[str, str] | None:
    """Return (office, name) of a custodian (node's name), registrar or admin (organisation's), or None."""
    custodian = CUSTODIAN.at(state, key)
    if custodian is not None:
        return "custodian", custodian.name
    for office, prefix in (("registrar", REGISTRAR), ("admin", ADMIN)):
        organisation = prefix.at(state, key)
        if organisation is not None:
            return office, organisation
    return None


def custodians(state: Reader) -> list[bytes]:
    return CUSTODIANS.read(state) or []


def custodian_organisations(state: Reader) -> dict[bytes, str]:
    rows = {key: CUSTODIAN.at(state, key) for key in custodians(state)}
    return {key: row.org for key, row in rows.items() if row is not None}


def custodian_rooms(state: Reader) -> dict[bytes, int]:
    """Declared room (GiB, 0: none) by custodian."""
    rows = {key: ROOM.at(state, key) for key in custodians(state)}
    return {key: 0 if row is None else row.gib for key, row in rows.items()}


@dataclass(frozen=True, slots=True)
class RobotName:
    """A robot's name and place, possibly empty."""

    name: str
    place: str


def read_robot_name(value: Any) -> RobotName | None:
    if not isinstance(value, dict):
        return None
    name, place = value.get("name"), value.get("place")
    if not isinstance(name, str) or not isinstance(place, str) or not name:
        return None
    if len(name) > ROBOT_NAME_MAX_CHARS or len(place) > ROBOT_PLACE_MAX_CHARS:
        return None
    return None if any(True for _ in find_hidden(name + place)) else RobotName(name, place)

"""State of the contract `records`: visits, records, announcements and deciding keys."""

from __future__ import annotations

from typing import Literal

from consensus.state.keys import (
    HASH_BYTES,
    KEY_BYTES,
    RECORD_ID_BYTES,
    U64_BYTES,
    ListRow,
    Prefix,
    Reader,
    Row,
    StateKey,
)

RECORDS = "records"


class VisitRow(Row, frozen=True):
    """A visit, under its first owner key."""

    robot: bytes
    ephemeral: bytes
    view_tag: int
    bucket_ms: int
    purpose: str
    status: Literal["open", "closed"]
    record_count: int
    height: int
    sequence: int


class RecordRow(Row, frozen=True):
    """A record; roots and metadata are empty once "expired" or "erased"; `awaited` have yet to report expiry."""

    owner: bytes
    robot: bytes
    commitment_root: bytes
    ciphertext_root: bytes
    sealed_metadata: bytes
    bucket_ms: int
    expires_at_ms: int
    height: int
    txid: bytes
    status: Literal["active", "erasing", "erased", "expired"]
    erased_frames: list[int]
    awaited: list[bytes]


class CurrentRow(Row, frozen=True):
    """A transferred visit's deciding key, and the number of transfers."""

    owner: bytes
    transfers: int


class AnnouncementRow(ListRow, frozen=True):
    """An announced owner key; for a takeover, `root` is the visit's first key."""

    owner: bytes
    ephemeral: bytes
    view_tag: int
    bucket_ms: int
    robot: bytes
    root: bytes = b""


class EmptyFrameRow(ListRow, frozen=True):
    """A publishable picture of a robot's empty scene: approver and time (ms)."""

    digest: bytes
    approver: bytes
    time: int


VISIT: Prefix[VisitRow] = Prefix(RECORDS, "visit/", (KEY_BYTES,), VisitRow)
RECORD: Prefix[RecordRow] = Prefix(RECORDS, "record/", (RECORD_ID_BYTES,), RecordRow)
ROOT: Prefix[bytes] = Prefix(RECORDS, "root/", (KEY_BYTES,), bytes)
"""The first key of the visit to which a later owner key leads."""
CURRENT: Prefix[CurrentRow] = Prefix(RECORDS, "current/", (KEY_BYTES,), CurrentRow)
OF_VISIT: Prefix[bool] = Prefix(RECORDS, "of-visit/", (KEY_BYTES, RECORD_ID_BYTES), bool)
"""There while a record of the visit is active."""
ASKED_FRAMES: Prefix[list[int]] = Prefix(RECORDS, "asked-frames/", (RECORD_ID_BYTES,), list[int])
"""The frames of a record whose erasure was asked for, sorted."""
ANNOUNCEMENT: Prefix[AnnouncementRow] = Prefix(RECORDS, "announcement/", (U64_BYTES,), AnnouncementRow)
"""By its number, from 0."""
ANNOUNCEMENT_COUNT: StateKey[int] = StateKey(RECORDS, "announcement-count", int)
"""How many announcements there are."""
EMPTY_FRAMES: Prefix[list[EmptyFrameRow]] = Prefix(RECORDS, "empty-frames/", (KEY_BYTES,), list[EmptyFrameRow])
"""By robot."""
EMPTY_FRAME: Prefix[int] = Prefix(RECORDS, "empty-frame/", (HASH_BYTES,), int)
"""For how many robots an empty frame is approved."""
LAYOUT = (
    VISIT,
    RECORD,
    ROOT,
    CURRENT,
    OF_VISIT,
    ASKED_FRAMES,
    ANNOUNCEMENT,
    ANNOUNCEMENT_COUNT,
    EMPTY_FRAMES,
    EMPTY_FRAME,
)


def deciding_key(root: bytes, current: CurrentRow | None) -> bytes:
    return root if current is None else current.owner


def current_owner(state: Reader, root: bytes) -> bytes:
    return deciding_key(root, CURRENT.at(state, root))


def decided_root(state: Reader, key: bytes) -> bytes | None:
    """Return the visit's first key, as view `root_of`; None if unknown or replaced."""
    root = ROOT.at(state, key) or key
    if not VISIT.has(state, root):
        return None
    return root if current_owner(state, root) == key else None


def is_frame_approved(state: Reader, robot: bytes, digest: bytes) -> bool:
    return any(row.digest == digest for row in EMPTY_FRAMES.at(state, robot) or [])

"""What a custodian tells its operator, as JSON; ids and keys in hexadecimal, lists of ids end after a thousand."""

from __future__ import annotations

import msgspec
from msgspec import UNSET, UnsetType

from consensus.api_documents import Document


class RobotUploads(Document, frozen=True):
    """A robot's uploads (empty `robot`: fetched from custodians); what is held is absent if it was not counted,
    what was refused in the last minutes by code.
    """

    organisation: str
    robot: str
    staged_clips: int
    staged_bytes: int
    today_bytes: int
    bytes_a_day: int
    refused: int
    refused_lately: dict[str, int]
    held_clips: int | UnsetType = UNSET
    held_bytes: int | UnsetType = UNSET


class UploadReport(Document, frozen=True):
    """Uploads by organisation and robot, quotas by setting, and room; null: no disk to look at, or no end in sight."""

    uploads: list[RobotUploads]
    quotas: dict[str, int]
    bytes_a_day: int
    disk_free_bytes: int | None
    disk_reserve_bytes: int | None
    uploads_paused: bool
    days_until_reserve: float | None


class OverdueErasure(Document, frozen=True):
    """An erasure that a custodian should have confirmed long ago."""

    erasure_id: str
    age_s: int
    records: int


class MissingReceipts(Document, frozen=True):
    """How many erasures a custodian has yet to confirm, and which of them are overdue."""

    receipts: int
    overdue: list[OverdueErasure]


class WorkFailure(Document, frozen=True):
    """What fails for want of the store: `following` the chain, taking `uploads`, or `fetching` clips from others."""

    work: str
    code: str
    detail: str
    failing_s: int


class CustodyStatus(UploadReport, frozen=True):
    """Heights, whether the chain names it a custodian, what fails, holdings, and missing receipts by custodian's key."""

    name: str
    member: str
    checkpoint_height: int | None
    finalized_height: int
    behind_blocks: int
    custodian: bool
    failing: list[WorkFailure]
    serving: bool
    busy: bool
    clips_held: int
    clips_staged: int
    clips_missing: int
    clips_erased: int
    frames: int
    shares: int
    key_parts: int
    outbox_ready: int
    outbox_erasing: int
    slots_used: int
    slots_total: int
    store_bytes: int | None
    waiting_for: dict[str, MissingReceipts]


class FrameName(Document, frozen=True):
    """One frame of a record."""

    record: str
    frame: int


class PartName(Document, frozen=True):
    """A share's part of a record's key."""

    grant: str
    record: str


class ScrubAnswer(Document, frozen=True):
    """A scrub's findings (`ScrubReport`), among records after that one if `after` names one. Null: the store's files
    cannot be looked into. `counts`: of whole lists.
    """

    ok: bool
    nothing_erased_is_left: bool
    height: int
    after: str
    records_count: int
    clips_compared_count: int
    frames_compared_count: int
    missing: list[str]
    held_though_erased: list[str]
    frames_held_though_erased: list[FrameName]
    unknown_to_chain: list[str]
    other_facts: list[str]
    corrupted: list[FrameName]
    unclaimed_frames: list[str]
    parts_held_though_ended: list[PartName]
    empty_frames_held_though_withdrawn: list[str]
    unclaimed_keys: list[int]
    dirty_slots_count: int
    log_bytes: int | None
    dirty_bytes: int | None
    counts: dict[str, int] = msgspec.field(default_factory=dict)


class RebuildAnswer(Document, frozen=True):
    """A rebuild's changes (`RebuildReport`), and what is still missing. `counts`: of whole lists."""

    ok: bool
    height: int
    clips_count: int
    erased_again: list[str]
    corrected: list[str]
    forgotten: list[str]
    unknown_to_chain: list[str]
    keys_destroyed_count: int
    fetched_count: int
    mended: list[str]
    still_damaged: list[str]
    still_missing_count: int
    counts: dict[str, int] = msgspec.field(default_factory=dict)


class Progress(Document, frozen=True):
    """What is looked at, how many are done, and of how many (0: not known); `last`: after which record a scrub could go on
    if it broke off, empty for other work.
    """

    what: str
    done: int
    total: int
    last: str = ""


class CustodyProblem(Document, frozen=True):
    """Why a request was refused, or work broke off."""

    code: str
    detail: str
    next_step: str


class WorkLine(Document, frozen=True):
    """A line of what a long task says: progress, then its report or why it broke off."""

    progress: Progress | UnsetType = UNSET
    report: msgspec.Raw | UnsetType = UNSET
    error: CustodyProblem | UnsetType = UNSET

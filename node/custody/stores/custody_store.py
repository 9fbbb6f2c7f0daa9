"""Protocol of a custodian's store, limited to what SQLite and MongoDB share.

Writes are idempotent; a clip's row follows its frames, a checkpoint its effects.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, Protocol, Self

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire
from node.custody.stores.share_store import ShareStore
from node.custody.uploads.upload_usage import UploadAccount

ClipStatus = Literal["staged", "confirmed", "erased"]
OutboxStatus = Literal["erasing", "ready"]
Unwritten = Mapping[bytes, BlockRobotError]
"""Clips, by record, of which a store knows that nothing was written, and why."""


def require_written(unwritten: Unwritten) -> None:
    """Raise the first one's error."""
    for error in unwritten.values():
        raise error


@dataclass(frozen=True, slots=True)
class ClipRow:
    """A clip; an erased one is a mark without owner, leaves or expiry.

    `owner` (33 bytes), `expires_at_ms`, `height`: empty or 0 until confirmed. `record_id`: 16 bytes; `txid`, leaves:
    32; `robot`: 33, none if fetched.
    """

    record_id: bytes
    txid: bytes
    valid_until_ms: int
    status: ClipStatus
    commitment_leaves: tuple[bytes, ...]
    ciphertext_leaves: tuple[bytes, ...]
    owner: bytes = b""
    expires_at_ms: int = 0
    height: int = 0
    robot: bytes = b""
    size_bytes: int = 0


@dataclass(frozen=True, slots=True)
class FrameRow:
    """A frame: ciphertext, sealed data key wrapped under an erase key, slot."""

    record_id: bytes
    index: int
    ciphertext: bytes
    wrapped_key: bytes
    slot: int


@dataclass(frozen=True, slots=True)
class FramePlace:
    """Where a frame and its erase key are, without bytes."""

    record_id: bytes
    index: int
    slot: int


@dataclass(frozen=True, slots=True)
class RecordFacts:
    """A kept record's chain facts; as a store row, a clip that is not here.

    `erased_frames` were erased before the clip arrived. `elsewhere`: others are its keepers, so it is not missing.
    """

    record_id: bytes
    txid: bytes
    owner: bytes
    commitment_root: bytes
    ciphertext_root: bytes
    expires_at_ms: int
    height: int
    erased_frames: tuple[int, ...] = ()
    elsewhere: bool = False


@dataclass(frozen=True, slots=True)
class Grant:
    """A final access request for these records (none: all up to `height`).

    With a `share` (grant's id), only its grantee may fetch.
    """

    access_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    height: int
    share: bytes = b""


class VisitRestrictions(Wire, frozen=True):
    """A visit owner's (33 bytes) last statements.

    Requests up to `narrowed_height` are void. Restricted: named records, or (`whole`) those expiring after
    `whole_since_ms`, kept until `until_ms` (0: no). `natural`: unprolonged expiries, ms.
    """

    owner: bytes
    narrowed_height: int = 0
    quarantined: bool = False
    whole: bool = False
    whole_since_ms: int = 0
    until_ms: int = 0
    records: tuple[bytes, ...] = ()
    natural: tuple[tuple[bytes, int], ...] = ()


class ErasurePart(Wire, frozen=True):
    """A record's frames to erase with their key slots; `whole`: the clip too."""

    record_id: bytes
    indexes: tuple[int, ...]
    slots: tuple[int, ...]
    whole: bool


class ErasurePlan(Wire, frozen=True):
    """One erasure's parts, fixed before the first key is destroyed."""

    parts: tuple[ErasurePart, ...]


@dataclass(frozen=True, slots=True)
class OutboxRow:
    """A pending transaction, keyed by kind, subject and part (0: single).

    `erasing`: plan unfinished, not submitted; `ready`: submitted until on chain.
    """

    kind: str
    subject: bytes
    part: int
    contract: str
    entry: str
    arguments: bytes
    height: int
    status: OutboxStatus = "ready"
    plan: bytes = b""

    @property
    def key(self) -> tuple[str, bytes, int]:
        return self.kind, self.subject, self.part

    def is_same_call(self, other: OutboxRow) -> bool:
        """Whether it is owed for the same reason; what is owed later may have the same key."""
        return (self.key, self.arguments, self.height) == (other.key, other.arguments, other.height)


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The newest finalized block applied to the store; times in ms."""

    height: int
    block_id: bytes
    timestamp_ms: int


@dataclass(frozen=True, slots=True)
class BlockEffects:
    """Changes of consecutive events, written in this order, checkpoint last.

    Existing outbox rows stay; `confirmed` clips, and those of `found` (record ids), stop being missing; `settled`: keys
    of outbox rows on chain; `expiries`: ms. A checkpoint drops expired missing clips.
    """

    outbox: tuple[OutboxRow, ...] = ()
    confirmed: tuple[RecordFacts, ...] = ()
    found: tuple[bytes, ...] = ()
    missing: tuple[RecordFacts, ...] = ()
    grants: tuple[Grant, ...] = ()
    settled: tuple[tuple[str, bytes, int], ...] = ()
    visit_restrictions: tuple[VisitRestrictions, ...] = ()
    expiries: tuple[tuple[bytes, int], ...] = ()
    checkpoint: Checkpoint | None = None


@dataclass(frozen=True, slots=True)
class StoreCounts:
    """Store counts; `elsewhere`: kept by others; `outbox_erasing`: planned, unfinished; `size_bytes`: None if unknown."""

    staged: int
    confirmed: int
    erased: int
    frames: int
    missing: int
    outbox_ready: int
    outbox_erasing: int
    size_bytes: int | None
    shares: int = 0
    parts: int = 0
    elsewhere: int = 0


@dataclass(frozen=True, slots=True)
class Leftovers:
    """Bytes in files outside rows: write-ahead log, free pages not overwritten (None: unknown)."""

    log_bytes: int | None
    dirty_bytes: int | None


class ReceiptOutbox(Protocol):
    """A custodian's pending transactions, kept across crashes."""

    async def add_outbox(self, row: OutboxRow) -> None:
        """An existing one stays unchanged."""
        ...

    async def mark_outbox_ready(self, key: tuple[str, bytes, int]) -> None:
        """Mark a row's erasure as done: submit it, drop its plan."""
        ...

    async def remove_outbox(self, key: tuple[str, bytes, int]) -> None: ...

    async def outbox(self, status: OutboxStatus, contract: str, limit: int) -> list[OutboxRow]:
        """By height, then key."""
        ...

    async def outbox_of(self, kind: str, subject: bytes) -> list[OutboxRow]: ...


class CustodyStore(ReceiptOutbox, ShareStore, UploadAccount, Protocol):
    """A custodian's store; methods raise STORE_UNAVAILABLE."""

    async def __aenter__(self) -> Self: ...

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    async def stage(self, clip: ClipRow, frames: Sequence[FrameRow]) -> None: ...

    async def stage_all(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        """Many at once; interrupted, each clip is there with all its frames, or not there.

        Where it raises, each may have been written or not, or be written later.
        """
        ...

    async def correct(self, facts: RecordFacts) -> None:
        """Only of confirmed clips."""
        ...

    async def replace_frames(self, record_id: bytes, frames: Sequence[FrameRow]) -> None:
        """Replace a clip's frames; interrupted, each index has old or new."""
        ...

    async def extend_staged(self, record_id: bytes, txid: bytes, valid_until_ms: int) -> None:
        """Update a staged clip's transaction; others stay unchanged."""
        ...

    async def apply(self, effects: BlockEffects) -> None:
        """Write a block's changes; checkpoint last, or all at once."""
        ...

    async def checkpoint(self) -> Checkpoint | None:
        """None in a new store."""
        ...

    async def clips(self, record_ids: Sequence[bytes]) -> dict[bytes, ClipRow]: ...

    async def clips_of_owner(self, owner: bytes) -> list[ClipRow]: ...

    async def frames(self, record_id: bytes) -> list[FrameRow]: ...

    async def frame_places(self, record_ids: Sequence[bytes]) -> list[FramePlace]:
        """By record and index."""
        ...

    async def references(self, record_ids: Sequence[bytes], size_bytes: int) -> dict[bytes, set[bytes]]:
        """What rows of frames have in place of ciphertexts: whatever has this length, by record."""
        ...

    async def erase_frames(self, record_id: bytes, indexes: Sequence[int]) -> None: ...

    async def erase_clips(self, record_ids: Sequence[bytes]) -> None:
        """Leaves a mark of each; interrupted, some are erased and the others are not."""
        ...

    async def drop_staged(self, record_ids: Sequence[bytes]) -> None:
        """Without marks; others stay. Interrupted, some are dropped and the others are not."""
        ...

    async def sweep(self) -> None:
        """Clear deleted rows' remains from the store's files, where possible."""
        ...

    async def sweep_blobs(self) -> int:
        """Delete ciphertexts outside the store that no row names; return their number. Uploads go on meanwhile."""
        ...

    async def lapsed(self, at_ms: int, limit: int) -> list[bytes]:
        """Staged clips with `valid_until_ms <= at_ms`."""
        ...

    async def expired(self, at_ms: int, limit: int) -> list[bytes]:
        """Confirmed clips with `expires_at_ms <= at_ms`, oldest expiry first."""
        ...

    async def missing(self, limit: int, after: tuple[int, bytes] | None = None) -> list[RecordFacts]:
        """Those that are to be kept here, newest first; `after` the one of that height and record id."""
        ...

    async def absent(self, after: bytes, limit: int) -> list[RecordFacts]:
        """All that are not here, `elsewhere` or missing, with record ids above `after`, in order."""
        ...

    async def count_missing(self) -> int:
        """Those that are to be kept here."""
        ...

    async def missing_clips(self, record_ids: Sequence[bytes]) -> dict[bytes, RecordFacts]: ...

    async def missing_of_owner(self, owner: bytes) -> list[RecordFacts]:
        """As `missing_clips`: wherever they are kept."""
        ...

    async def grant(self, access_id: bytes) -> Grant | None: ...

    async def grants_of_owners(self, owners: Sequence[bytes]) -> list[Grant]:
        """By owner, then access id."""
        ...

    def all_grants(self) -> AsyncIterator[Grant]: ...

    async def visit_restrictions(self, owners: Sequence[bytes] | None = None) -> dict[bytes, VisitRestrictions]:
        """Of these owners' visits, or all; only existing ones."""
        ...

    async def put_background(self, digest: bytes, content: bytes) -> None: ...

    async def background(self, digest: bytes) -> bytes | None: ...

    async def background_digests(self) -> list[bytes]: ...

    async def delete_backgrounds(self, digests: Sequence[bytes]) -> None: ...

    def all_clips(self) -> AsyncIterator[ClipRow]:
        """By record id, erased ones too."""
        ...

    def slots_in_use(self) -> AsyncIterator[int]: ...

    def records_with_frames(self) -> AsyncIterator[bytes]: ...

    async def counts(self) -> StoreCounts: ...

    async def leftovers(self) -> Leftovers:
        """Sweep, then look for unreferenced bytes in the store's files."""
        ...

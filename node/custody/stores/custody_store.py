"""What a custodian needs of its store, in words of the domain. Must never ask for what SQLite and MongoDB do not both have.

Every write is idempotent: repeated after a crash, it leaves what it left the first time. A clip's row is written after
its frames and a block's checkpoint after all its effects, so that what is visible is whole. Nothing here opens a frame:
ciphertexts are sealed to owners, and wrapped keys open only with erase keys, which live outside of the store.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, Protocol, Self

from consensus.primitives.encoding import Wire
from node.custody.stores.share_store import ShareStore
from node.custody.uploads import UploadAccount

ClipStatus = Literal["staged", "confirmed", "erased"]
OutboxStatus = Literal["erasing", "ready"]


@dataclass(frozen=True, slots=True)
class ClipRow:
    """One clip. An erased one is a mark without owner, leaves or expiry, so that its id is never filled again.

    `owner` (33 bytes), `expires_at_ms` and `height` come from the chain with the confirmation; until then they are
    empty and 0. `record_id` has 16 bytes, `txid` and each leaf 32. `robot` (33 bytes) uploaded `size_bytes`; a clip that
    was fetched from another custodian has none.
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
    """One frame: its ciphertext, its sealed data key wrapped under an erase key, and that key's slot."""

    record_id: bytes
    index: int
    ciphertext: bytes
    wrapped_key: bytes
    slot: int


@dataclass(frozen=True, slots=True)
class FramePlace:
    """Where a frame and its erase key are, without its bytes."""

    record_id: bytes
    index: int
    slot: int


@dataclass(frozen=True, slots=True)
class RecordFacts:
    """What the chain says of a record that is to be kept. As a row of the store: a clip that is still missing.

    `erased_frames` are those that the owner had erased before the clip arrived.
    """

    record_id: bytes
    txid: bytes
    owner: bytes
    commitment_root: bytes
    ciphertext_root: bytes
    expires_at_ms: int
    height: int
    erased_frames: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Grant:
    """A final access request: the owner may fetch these records (none named: all of hers up to `height`).

    With a `share`, a grant's id, it is the grantee who asked, and she alone may fetch them.
    """

    access_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    height: int
    share: bytes = b""


class VisitRestrictions(Wire, frozen=True):
    """What a visit's owner (33 bytes) said of it last: restricted, kept beyond its expiry, objected to, denied.

    Requests up to `narrowed_height` are void. Restricted are the named records, or (`whole`) all those that would expire
    after `whole_since_ms`; with `until_ms` (0: no) they are kept until then. `natural` are the record ids and expiries of
    clips that are kept longer now than they would be, ms.
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
    """What is erased of one record: these frames, whose keys are in these slots; `whole` if the clip goes with them."""

    record_id: bytes
    indexes: tuple[int, ...]
    slots: tuple[int, ...]
    whole: bool


class ErasurePlan(Wire, frozen=True):
    """All parts of one erasure, fixed before the first key is destroyed."""

    parts: tuple[ErasurePart, ...]


@dataclass(frozen=True, slots=True)
class OutboxRow:
    """A transaction that this custodian owes the chain.

    It is identified by kind, subject (an access or erasure id, or a digest) and part (0 unless it takes several).
    While `erasing`, the plan is not carried out and nothing may be said; `ready` rows are submitted until the chain
    shows them. `arguments` is the encoded list of the call's arguments.
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
        """What identifies the row."""
        return self.kind, self.subject, self.part


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The newest finalized block whose effects the store holds. Times are the block's, ms."""

    height: int
    block_id: bytes
    timestamp_ms: int


@dataclass(frozen=True, slots=True)
class BlockEffects:
    """What a stretch of a block's events changes, written together and in this order; the checkpoint is last.

    Outbox rows that are already there stay as they are; `confirmed` clips stop being missing; `settled` are keys of
    outbox rows that the chain has shown. `standings` come before the clips that they prolong; `expiries` are confirmed
    clips and when they expire now, ms. A checkpoint also gives up missing clips that expired by its time.
    """

    outbox: tuple[OutboxRow, ...] = ()
    confirmed: tuple[RecordFacts, ...] = ()
    missing: tuple[RecordFacts, ...] = ()
    grants: tuple[Grant, ...] = ()
    settled: tuple[tuple[str, bytes, int], ...] = ()
    standings: tuple[VisitRestrictions, ...] = ()
    expiries: tuple[tuple[bytes, int], ...] = ()
    checkpoint: Checkpoint | None = None


@dataclass(frozen=True, slots=True)
class StoreCounts:
    """How much a store holds: clips by status, frames with their bytes, clips to be fetched, transactions owed.

    `owed_erasures` are erasures planned and not yet carried out, `shares` grants that stand, `parts` what is held of their
    keys. `size_bytes` is what the store takes up on disk, None
    where only its server knows.
    """

    staged: int
    confirmed: int
    erased: int
    frames: int
    missing: int
    owed: int
    owed_erasures: int
    size_bytes: int | None
    shares: int = 0
    parts: int = 0


@dataclass(frozen=True, slots=True)
class Leftovers:
    """What a store's own files keep beside its rows; `log_bytes` in a write-ahead log, `dirty_bytes` on free pages that
    are not overwritten. None where only the store's server knows.
    """

    log_bytes: int | None
    dirty_bytes: int | None


class ReceiptOutbox(Protocol):
    """Where a custodian keeps the transactions that it owes, so that no crash loses one."""

    async def add_outbox(self, row: OutboxRow) -> None:
        """Keep a row; one that is already there stays as it is."""
        ...

    async def mark_outbox_ready(self, key: tuple[str, bytes, int]) -> None:
        """Say that the row's erasure is carried out: the row may be submitted, its plan is forgotten."""
        ...

    async def remove_outbox(self, key: tuple[str, bytes, int]) -> None:
        """Forget a row; one that is not there is no error."""
        ...

    async def outbox(self, status: OutboxStatus, contract: str, limit: int) -> list[OutboxRow]:
        """Return up to `limit` rows of this status that call this contract, by height, then by key."""
        ...

    async def outbox_of(self, kind: str, subject: bytes) -> list[OutboxRow]:
        """Return the rows of one kind about one subject, by part."""
        ...


class CustodyStore(ReceiptOutbox, ShareStore, UploadAccount, Protocol):
    """A custodian's store. Every method raises STORE_UNAVAILABLE if the store does not answer."""

    async def __aenter__(self) -> Self:
        """Open the store, making it if it is new."""
        ...

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the store."""
        ...

    async def stage(self, clip: ClipRow, frames: Sequence[FrameRow]) -> None:
        """Keep a clip and its frames, in place of any rows of the same record."""
        ...

    async def correct(self, facts: RecordFacts) -> None:
        """Write what the chain says of a confirmed clip, its frames untouched; another stays as it is."""
        ...

    async def replace_frames(self, record_id: bytes, frames: Sequence[FrameRow]) -> None:
        """Put these frames in the place of all that a clip has. Cut off, each index has its old frame or its new one."""
        ...

    async def extend_staged(self, record_id: bytes, txid: bytes, valid_until_ms: int) -> None:
        """Note the newer transaction of a staged clip; one that is not staged stays as it is."""
        ...

    async def apply(self, effects: BlockEffects) -> None:
        """Write what a block changes; the checkpoint last, or all at once."""
        ...

    async def checkpoint(self) -> Checkpoint | None:
        """Return the newest block whose effects are in the store, or None in a new one."""
        ...

    async def clips(self, record_ids: Sequence[bytes]) -> dict[bytes, ClipRow]:
        """Return the clips among these ids that the store has."""
        ...

    async def clips_of_owner(self, owner: bytes) -> list[ClipRow]:
        """Return the confirmed clips of an owner, by record id."""
        ...

    async def frames(self, record_id: bytes) -> list[FrameRow]:
        """Return a clip's frames that are not erased, by index."""
        ...

    async def frame_places(self, record_ids: Sequence[bytes]) -> list[FramePlace]:
        """Return where the frames of these clips are, by record and index, without their bytes."""
        ...

    async def erase_frames(self, record_id: bytes, indexes: Sequence[int]) -> None:
        """Delete frames of a clip with their bytes."""
        ...

    async def erase_clip(self, record_id: bytes) -> None:
        """Delete a clip, its frames and its entry among the missing; leave the mark of an erased one."""
        ...

    async def drop_staged(self, record_id: bytes) -> None:
        """Delete a staged clip and its frames without a mark; one that is not staged stays."""
        ...

    async def sweep(self) -> None:
        """Clear what the store's own files still hold of deleted rows, as far as that is in its power."""
        ...

    async def lapsed(self, at_ms: int, limit: int) -> list[bytes]:
        """Return staged clips whose transaction can no longer be included: `valid_until_ms <= at_ms`."""
        ...

    async def expired(self, at_ms: int, limit: int) -> list[bytes]:
        """Return confirmed clips with `expires_at_ms <= at_ms`, the oldest expiry first."""
        ...

    async def missing(self, limit: int) -> list[RecordFacts]:
        """Return clips that the chain has and this store has not, the newest first."""
        ...

    async def missing_clip(self, record_id: bytes) -> RecordFacts | None:
        """Return what the chain says of one missing clip, or None if it is not missing."""
        ...

    async def missing_of_owner(self, owner: bytes) -> list[RecordFacts]:
        """Return all missing clips of an owner, by record id."""
        ...

    async def grant(self, access_id: bytes) -> Grant | None:
        """Return a final access request, or None."""
        ...

    async def grants_of_owner(self, owner: bytes) -> list[Grant]:
        """Return the final access requests of an owner, by access id."""
        ...

    async def standings(self, owners: Sequence[bytes] | None = None) -> dict[bytes, VisitRestrictions]:
        """Return what was said of the visits of these owners, or of all; nothing for those of which nothing was."""
        ...

    async def put_background(self, digest: bytes, content: bytes) -> None:
        """Keep an empty frame under its SHA-256."""
        ...

    async def background(self, digest: bytes) -> bytes | None:
        """Return an empty frame, or None."""
        ...

    async def background_digests(self) -> list[bytes]:
        """Return the SHA-256 of every empty frame, sorted."""
        ...

    async def delete_backgrounds(self, digests: Sequence[bytes]) -> None:
        """Delete empty frames; those that are not there are passed over."""
        ...

    def all_clips(self) -> AsyncIterator[ClipRow]:
        """Yield every clip, erased ones too, by record id."""
        ...

    def slots_in_use(self) -> AsyncIterator[int]:
        """Yield the slot of every frame, and of every part of a shared key."""
        ...

    def records_with_frames(self) -> AsyncIterator[bytes]:
        """Yield the record id of every frame, each once, also of frames that no clip claims."""
        ...

    async def counts(self) -> StoreCounts:
        """Return how much the store holds."""
        ...

    async def leftovers(self) -> Leftovers:
        """Sweep, then look into the store's own files for bytes that no row holds any more."""
        ...

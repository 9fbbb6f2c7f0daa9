"""MongoDB documents of a custodian's rows; frames are separate documents (16 MB limit)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from typing import Any, TypeVar

from bson.int64 import Int64
from pymongo import ReplaceOne, UpdateOne
from pymongo.errors import PyMongoError

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode, u32
from node.custody.stores.custody_store import (
    Checkpoint,
    ClipRow,
    FramePlace,
    FrameRow,
    Grant,
    OutboxRow,
    RecordFacts,
    VisitRestrictions,
)

Document = dict[str, Any]
Row = TypeVar("Row")

STAGING = "staging"
STATUSES: dict[str, tuple[str, ...]] = {
    "staged": ("staged", STAGING),
    "confirmed": ("confirmed",),
    "erased": ("erased",),
}
"""What a clip's document may say for a status: one that is half written, or was cut off, counts as staged."""


def _plain(document: Document) -> Document:
    return {name: int(value) if isinstance(value, Int64) else value for name, value in document.items()}


def rows(convert: Callable[[Document], Row], documents: Iterable[Document]) -> list[Row]:
    """Raises STORAGE_DAMAGED for a document with a missing or wrong field."""
    try:
        return [convert(_plain(document)) for document in documents]
    except (KeyError, TypeError) as error:
        raise _damage(error) from error


def in_order(documents: Iterable[Document], fields: Sequence[str]) -> list[Document]:
    """Raises as `rows`."""
    try:
        return sorted(documents, key=itemgetter(*fields))
    except (KeyError, TypeError) as error:
        raise _damage(error) from error


def _damage(error: Exception) -> BlockRobotError:
    return BlockRobotError("STORAGE_DAMAGED", f"The store has a document that is not whole: {error!r}.")


def frame_id(record_id: bytes, index: int) -> bytes:
    return record_id + u32(index)


def frame_key(record_id: bytes, index: int) -> Document:
    """With what frames are sharded by, which an upsert has to name, and by which one shard is asked."""
    return {"_id": frame_id(record_id, index), "record_id": record_id}


def outbox_id(key: tuple[str, bytes, int]) -> bytes:
    kind, subject, part = key
    return kind.encode() + b"\x00" + subject + u32(part)


def clip_document(clip: ClipRow, status: str | None = None) -> Document:
    return {
        "_id": clip.record_id,
        "txid": clip.txid,
        "valid_until_ms": clip.valid_until_ms,
        "status": status or clip.status,
        "commitment_leaves": list(clip.commitment_leaves),
        "ciphertext_leaves": list(clip.ciphertext_leaves),
        "owner": clip.owner,
        "expires_at_ms": clip.expires_at_ms,
        "height": clip.height,
        "robot": clip.robot,
        "size_bytes": clip.size_bytes,
    }


def clip_replacement(clip: ClipRow, status: str | None = None) -> ReplaceOne[Document]:
    return ReplaceOne({"_id": clip.record_id}, clip_document(clip, status), upsert=True)


def clip_row(found: Document) -> ClipRow:
    return ClipRow(
        record_id=found["_id"],
        txid=found["txid"],
        valid_until_ms=found["valid_until_ms"],
        status=found["status"],
        commitment_leaves=tuple(found["commitment_leaves"]),
        ciphertext_leaves=tuple(found["ciphertext_leaves"]),
        owner=found["owner"],
        expires_at_ms=found["expires_at_ms"],
        height=found["height"],
        robot=found["robot"],
        size_bytes=found["size_bytes"],
    )


def _told(facts: RecordFacts) -> Document:
    return {
        "txid": facts.txid,
        "owner": facts.owner,
        "expires_at_ms": facts.expires_at_ms,
        "height": facts.height,
    }


def confirmed(facts: RecordFacts) -> Document:
    return {"status": "confirmed"} | _told(facts)


def confirmation(facts: RecordFacts) -> UpdateOne:
    return UpdateOne({"_id": facts.record_id, "status": {"$in": ["staged", "confirmed"]}}, {"$set": confirmed(facts)})


def correction(facts: RecordFacts) -> UpdateOne:
    return UpdateOne({"_id": facts.record_id, "status": "confirmed"}, {"$set": _told(facts)})


def expiry(record_id: bytes, expires_at_ms: int) -> UpdateOne:
    return UpdateOne({"_id": record_id, "status": "confirmed"}, {"$set": {"expires_at_ms": expires_at_ms}})


def restrictions_document(restrictions: VisitRestrictions) -> Document:
    return {"_id": restrictions.owner, "restrictions": encode(restrictions)}


def restrictions_row(found: Document) -> VisitRestrictions:
    return decode(bytes(found["restrictions"]), VisitRestrictions)


def frame_document(row: FrameRow) -> Document:
    return {
        "_id": frame_id(row.record_id, row.index),
        "record_id": row.record_id,
        "index": row.index,
        "slot": row.slot,
        "wrapped_key": row.wrapped_key,
        "ciphertext": row.ciphertext,
    }


def replacement(row: FrameRow) -> ReplaceOne[Document]:
    return ReplaceOne(frame_key(row.record_id, row.index), frame_document(row), upsert=True)


def frame_row(found: Document) -> FrameRow:
    return FrameRow(found["record_id"], found["index"], found["ciphertext"], found["wrapped_key"], found["slot"])


def frame_place(found: Document) -> FramePlace:
    return FramePlace(found["record_id"], found["index"], found["slot"])


def missing_document(facts: RecordFacts) -> Document:
    return {
        "_id": facts.record_id,
        "txid": facts.txid,
        "owner": facts.owner,
        "commitment_root": facts.commitment_root,
        "ciphertext_root": facts.ciphertext_root,
        "expires_at_ms": facts.expires_at_ms,
        "height": facts.height,
        "erased_frames": list(facts.erased_frames),
        "elsewhere": facts.elsewhere,
    }


def missing_row(found: Document) -> RecordFacts:
    return RecordFacts(
        record_id=found["_id"],
        txid=found["txid"],
        owner=found["owner"],
        commitment_root=found["commitment_root"],
        ciphertext_root=found["ciphertext_root"],
        expires_at_ms=found["expires_at_ms"],
        height=found["height"],
        erased_frames=tuple(found["erased_frames"]),
        elsewhere=found["elsewhere"],
    )


def grant_document(grant: Grant) -> Document:
    return {
        "_id": grant.access_id,
        "owner": grant.owner,
        "records": list(grant.records),
        "height": grant.height,
        "share": grant.share,
    }


def grant_row(found: Document) -> Grant:
    return Grant(found["_id"], found["owner"], tuple(found["records"]), found["height"], found["share"])


def outbox_document(row: OutboxRow) -> Document:
    return {
        "kind": row.kind,
        "subject": row.subject,
        "part": row.part,
        "contract": row.contract,
        "entry": row.entry,
        "arguments": row.arguments,
        "height": row.height,
        "status": row.status,
        "plan": row.plan,
    }


def outbox_row(found: Document) -> OutboxRow:
    return OutboxRow(**{name: value for name, value in found.items() if name != "_id"})


def checkpoint_document(point: Checkpoint) -> Document:
    return {"height": point.height, "block_id": point.block_id, "timestamp_ms": point.timestamp_ms}


def checkpoint_row(found: Document) -> Checkpoint:
    return Checkpoint(found["height"], found["block_id"], found["timestamp_ms"])


def is_passing(cause: BaseException | None) -> bool:
    """Return whether a transaction failed for a transient reason."""
    labels = ("TransientTransactionError", "UnknownTransactionCommitResult")
    return isinstance(cause, PyMongoError) and any(cause.has_error_label(label) for label in labels)

"""The networked custody store, on MongoDB by PyMongo's asynchronous client. Must never rest on what needs a transaction.

Each write waits for the majority and their journals, is idempotent, and comes in an order in which a crash between two
leaves nothing half visible: frames before their clip, effects before their checkpoint. Frames are documents of their
own, far below the limit of 16 MB. A server's files may hold deleted bytes for a while; without the erase keys, which
no server has, these open nothing. The same code serves a replica set or a sharded cluster: its URI says which.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

from pymongo import ASCENDING, AsyncMongoClient, DeleteOne, InsertOne, ReplaceOne, UpdateOne
from pymongo.asynchronous.collection import AsyncCollection
from pymongo.asynchronous.database import AsyncDatabase
from pymongo.errors import PyMongoError
from pymongo.write_concern import WriteConcern

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u32
from node.offchain.store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    FramePlace,
    FrameRow,
    Grant,
    OutboxRow,
    OutboxStatus,
    RecordFacts,
)

Document = dict[str, Any]

DATABASE_NAME = "blockrobot_custody"
ARRIVING = "arriving"
SERVER_SELECTION_MAX_MS = 5_000
SOCKET_MAX_MS = 30_000

_INDEXES: Mapping[str, Sequence[Sequence[str]]] = {
    "clips": (("owner", "_id"), ("status", "valid_until_ms", "_id"), ("status", "expires_at_ms", "_id")),
    "frames": (("record_id", "place"), ("slot",)),
    "grants": (("owner", "_id"),),
    "missing": (("height", "_id"), ("expires_at_ms",)),
    "outbox": (("status", "height", "kind", "subject", "part"), ("kind", "subject", "part")),
}


@contextmanager
def _answering() -> Iterator[None]:
    try:
        yield
    except PyMongoError as error:
        # The message of the driver may quote the URI, which may hold a password.
        raise BlockRobotError("STORE_UNAVAILABLE", f"The store's server failed ({type(error).__name__}).") from error


def _frame_id(record_id: bytes, index: int) -> bytes:
    return record_id + u32(index)


def _outbox_id(key: tuple[str, bytes, int]) -> bytes:
    kind, subject, part = key
    return kind.encode() + b"\x00" + subject + u32(part)


def _clip_document(clip: ClipRow) -> Document:
    return {
        "_id": clip.record_id,
        "txid": clip.txid,
        "valid_until_ms": clip.valid_until_ms,
        "status": clip.status,
        "commitment_leaves": list(clip.commitment_leaves),
        "ciphertext_leaves": list(clip.ciphertext_leaves),
        "owner": clip.owner,
        "expires_at_ms": clip.expires_at_ms,
        "height": clip.height,
    }


def _clip(found: Document) -> ClipRow:
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
    )


def _missing_document(facts: RecordFacts) -> Document:
    return {
        "_id": facts.record_id,
        "txid": facts.txid,
        "owner": facts.owner,
        "commitment_root": facts.commitment_root,
        "ciphertext_root": facts.ciphertext_root,
        "expires_at_ms": facts.expires_at_ms,
        "height": facts.height,
        "erased_frames": list(facts.erased_frames),
    }


def _missing(found: Document) -> RecordFacts:
    return RecordFacts(
        record_id=found["_id"],
        txid=found["txid"],
        owner=found["owner"],
        commitment_root=found["commitment_root"],
        ciphertext_root=found["ciphertext_root"],
        expires_at_ms=found["expires_at_ms"],
        height=found["height"],
        erased_frames=tuple(found["erased_frames"]),
    )


def _outbox_document(row: OutboxRow) -> Document:
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


def _outbox_row(found: Document) -> OutboxRow:
    return OutboxRow(**{name: value for name, value in found.items() if name != "_id"})


def _confirmation(facts: RecordFacts) -> UpdateOne:
    changes = {
        "status": "confirmed",
        "txid": facts.txid,
        "owner": facts.owner,
        "expires_at_ms": facts.expires_at_ms,
        "height": facts.height,
    }
    return UpdateOne({"_id": facts.record_id, "status": "staged"}, {"$set": changes})


class MongoStore:
    """A `CustodyStore` in one database of a MongoDB server. Rules of the interface: `store.py`."""

    def __init__(self, uri: str, database: str | None = None) -> None:
        """Name the server by its URI; the database is the URI's own unless it is named here."""
        self._uri = uri
        self._database_name = database
        self._client: AsyncMongoClient[Document] | None = None
        self._database: AsyncDatabase[Document] | None = None

    async def __aenter__(self) -> Self:
        """Connect and make the indexes. Raises STORE_UNAVAILABLE if no server answers in five seconds."""
        with _answering():
            client: AsyncMongoClient[Document] = AsyncMongoClient(
                self._uri,
                serverSelectionTimeoutMS=SERVER_SELECTION_MAX_MS,
                connectTimeoutMS=SERVER_SELECTION_MAX_MS,
                socketTimeoutMS=SOCKET_MAX_MS,
            )
            try:
                name = self._database_name or client.get_default_database(DATABASE_NAME).name
                database = client.get_database(name, write_concern=WriteConcern(w="majority", j=True))
                for collection, indexes in _INDEXES.items():
                    for fields in indexes:
                        await database[collection].create_index([(field, ASCENDING) for field in fields])
            except BaseException:
                await client.close()
                raise
        self._client, self._database = client, database
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connections."""
        if self._client is not None:
            await self._client.close()
        self._client = self._database = None

    def _collection(self, name: str) -> AsyncCollection[Document]:
        if self._database is None:
            raise BlockRobotError("STORE_UNAVAILABLE", "The store is not open.")
        return self._database[name]

    async def _bulk(self, name: str, operations: Sequence[Any]) -> None:
        if operations:
            with _answering():
                await self._collection(name).bulk_write(list(operations), ordered=True)

    async def _one(self, name: str, key: Any) -> Document | None:
        with _answering():
            return await self._collection(name).find_one({"_id": key})

    async def _many(
        self,
        name: str,
        where: Document,
        *,
        sort: Sequence[str] = ("_id",),
        descending: bool = False,
        limit: int = 0,
        fields: Sequence[str] | None = None,
    ) -> list[Document]:
        order = [(field, -1 if descending and field == sort[0] else ASCENDING) for field in sort]
        with _answering():
            return await self._collection(name).find(where, fields).sort(order).limit(limit).to_list(None)

    async def stage(self, clip: ClipRow, frames: Sequence[FrameRow]) -> None:
        """See `CustodyStore.stage`; a clip is seen only when all its frames are there.

        Until then it stands as `arriving`, so that one whose upload was cut off is purged like a staged one.
        """
        arriving = _clip_document(clip) | {"status": ARRIVING}
        await self._bulk("clips", [ReplaceOne({"_id": clip.record_id}, arriving, upsert=True)])
        with _answering():
            await self._collection("frames").delete_many({"record_id": clip.record_id})
        documents = [
            {
                "_id": _frame_id(row.record_id, row.index),
                "record_id": row.record_id,
                "place": row.index,
                "slot": row.slot,
                "wrapped_key": row.wrapped_key,
                "ciphertext": row.ciphertext,
            }
            for row in frames
        ]
        await self._bulk("frames", [InsertOne(document) for document in documents])
        await self._bulk("clips", [ReplaceOne({"_id": clip.record_id}, _clip_document(clip), upsert=True)])

    async def extend_staged(self, record_id: bytes, txid: bytes, valid_until_ms: int) -> None:
        """See `CustodyStore.extend_staged`."""
        changes = {"$set": {"txid": txid, "valid_until_ms": valid_until_ms}}
        await self._bulk("clips", [UpdateOne({"_id": record_id, "status": "staged"}, changes)])

    async def apply(self, effects: BlockEffects) -> None:
        """See `CustodyStore.apply`; here in order, each step idempotent."""
        await self._bulk(
            "outbox",
            [
                UpdateOne({"_id": _outbox_id(row.key)}, {"$setOnInsert": _outbox_document(row)}, upsert=True)
                for row in effects.outbox
            ],
        )
        await self._bulk("clips", [_confirmation(facts) for facts in effects.confirmed])
        await self._bulk("missing", [DeleteOne({"_id": facts.record_id}) for facts in effects.confirmed])
        await self._bulk(
            "missing",
            [ReplaceOne({"_id": facts.record_id}, _missing_document(facts), upsert=True) for facts in effects.missing],
        )
        await self._bulk(
            "grants",
            [
                ReplaceOne(
                    {"_id": grant.access_id},
                    {"owner": grant.owner, "records": list(grant.records), "height": grant.height},
                    upsert=True,
                )
                for grant in effects.grants
            ],
        )
        await self._bulk("outbox", [DeleteOne({"_id": _outbox_id(key)}) for key in effects.settled])
        if effects.checkpoint is not None:
            point = effects.checkpoint
            with _answering():
                await self._collection("missing").delete_many({"expires_at_ms": {"$lte": point.timestamp_ms}})
            document = {"height": point.height, "block_id": point.block_id, "timestamp_ms": point.timestamp_ms}
            await self._bulk("checkpoint", [ReplaceOne({"_id": 1}, document, upsert=True)])

    async def checkpoint(self) -> Checkpoint | None:
        """See `CustodyStore.checkpoint`."""
        found = await self._one("checkpoint", 1)
        return Checkpoint(found["height"], found["block_id"], found["timestamp_ms"]) if found else None

    async def clips(self, record_ids: Sequence[bytes]) -> dict[bytes, ClipRow]:
        """See `CustodyStore.clips`."""
        where = {"_id": {"$in": list(record_ids)}, "status": {"$ne": ARRIVING}}
        found = await self._many("clips", where) if record_ids else []
        return {document["_id"]: _clip(document) for document in found}

    async def clips_of_owner(self, owner: bytes) -> list[ClipRow]:
        """See `CustodyStore.clips_of_owner`."""
        return [_clip(found) for found in await self._many("clips", {"owner": owner, "status": "confirmed"})]

    async def frames(self, record_id: bytes) -> list[FrameRow]:
        """See `CustodyStore.frames`."""
        rows = await self._many("frames", {"record_id": record_id}, sort=("place",))
        return [
            FrameRow(row["record_id"], row["place"], row["ciphertext"], row["wrapped_key"], row["slot"]) for row in rows
        ]

    async def frame_places(self, record_ids: Sequence[bytes]) -> list[FramePlace]:
        """See `CustodyStore.frame_places`."""
        where = {"record_id": {"$in": list(record_ids)}}
        fields = ("record_id", "place", "slot")
        rows = await self._many("frames", where, sort=("record_id", "place"), fields=fields) if record_ids else []
        return [FramePlace(row["record_id"], row["place"], row["slot"]) for row in rows]

    async def erase_frames(self, record_id: bytes, indexes: Sequence[int]) -> None:
        """See `CustodyStore.erase_frames`."""
        await self._bulk("frames", [DeleteOne({"_id": _frame_id(record_id, index)}) for index in indexes])

    async def erase_clip(self, record_id: bytes) -> None:
        """See `CustodyStore.erase_clip`; the mark comes first, so that a half-erased clip is never served."""
        mark = ClipRow(record_id, b"", 0, "erased", (), ())
        await self._bulk("clips", [ReplaceOne({"_id": record_id}, _clip_document(mark), upsert=True)])
        with _answering():
            await self._collection("frames").delete_many({"record_id": record_id})
        await self._bulk("missing", [DeleteOne({"_id": record_id})])

    async def drop_staged(self, record_id: bytes) -> None:
        """See `CustodyStore.drop_staged`; the clip goes last, so that a drop that was cut off is repeated."""
        found = await self._one("clips", record_id)
        if found is not None and found["status"] in {"staged", ARRIVING}:
            with _answering():
                await self._collection("frames").delete_many({"record_id": record_id})
            await self._bulk("clips", [DeleteOne({"_id": record_id})])

    async def sweep(self) -> None:
        """See `CustodyStore.sweep`; a server's files are its own, so there is nothing to do from here."""

    async def lapsed(self, at_ms: int, limit: int) -> list[bytes]:
        """See `CustodyStore.lapsed`."""
        where = {"status": {"$in": ["staged", ARRIVING]}, "valid_until_ms": {"$lte": at_ms}}
        found = await self._many("clips", where, sort=("valid_until_ms", "_id"), limit=limit, fields=("_id",))
        return [document["_id"] for document in found]

    async def expired(self, at_ms: int, limit: int) -> list[bytes]:
        """See `CustodyStore.expired`."""
        where = {"status": "confirmed", "expires_at_ms": {"$lte": at_ms}}
        found = await self._many("clips", where, sort=("expires_at_ms", "_id"), limit=limit, fields=("_id",))
        return [document["_id"] for document in found]

    async def missing(self, limit: int) -> list[RecordFacts]:
        """See `CustodyStore.missing`."""
        found = await self._many("missing", {}, sort=("height", "_id"), descending=True, limit=limit)
        return [_missing(document) for document in found]

    async def missing_clip(self, record_id: bytes) -> RecordFacts | None:
        """See `CustodyStore.missing_clip`."""
        found = await self._one("missing", record_id)
        return _missing(found) if found else None

    async def grant(self, access_id: bytes) -> Grant | None:
        """See `CustodyStore.grant`."""
        found = await self._one("grants", access_id)
        return Grant(access_id, found["owner"], tuple(found["records"]), found["height"]) if found else None

    async def grants_of_owner(self, owner: bytes) -> list[Grant]:
        """See `CustodyStore.grants_of_owner`."""
        found = await self._many("grants", {"owner": owner})
        return [Grant(row["_id"], row["owner"], tuple(row["records"]), row["height"]) for row in found]

    async def put_background(self, digest: bytes, content: bytes) -> None:
        """See `CustodyStore.put_background`."""
        await self._bulk("backgrounds", [ReplaceOne({"_id": digest}, {"content": content}, upsert=True)])

    async def background(self, digest: bytes) -> bytes | None:
        """See `CustodyStore.background`."""
        found = await self._one("backgrounds", digest)
        return bytes(found["content"]) if found else None

    async def add_outbox(self, row: OutboxRow) -> None:
        """See `ReceiptOutbox.add_outbox`."""
        await self.apply(BlockEffects(outbox=(row,)))

    async def mark_outbox_ready(self, key: tuple[str, bytes, int]) -> None:
        """See `ReceiptOutbox.mark_outbox_ready`."""
        changes = {"$set": {"status": "ready", "plan": b""}}
        await self._bulk("outbox", [UpdateOne({"_id": _outbox_id(key)}, changes)])

    async def remove_outbox(self, key: tuple[str, bytes, int]) -> None:
        """See `ReceiptOutbox.remove_outbox`."""
        await self.apply(BlockEffects(settled=(key,)))

    async def outbox(self, status: OutboxStatus, limit: int) -> list[OutboxRow]:
        """See `ReceiptOutbox.outbox`."""
        order = ("height", "kind", "subject", "part")
        return [_outbox_row(row) for row in await self._many("outbox", {"status": status}, sort=order, limit=limit)]

    async def outbox_of(self, kind: str, subject: bytes) -> list[OutboxRow]:
        """See `ReceiptOutbox.outbox_of`."""
        found = await self._many("outbox", {"kind": kind, "subject": subject}, sort=("part",))
        return [_outbox_row(row) for row in found]

    async def all_clips(self) -> AsyncIterator[ClipRow]:
        """See `CustodyStore.all_clips`."""
        with _answering():
            async for document in self._collection("clips").find({"status": {"$ne": ARRIVING}}).sort("_id", ASCENDING):
                yield _clip(document)

    async def slots_in_use(self) -> AsyncIterator[int]:
        """See `CustodyStore.slots_in_use`."""
        with _answering():
            async for document in self._collection("frames").find({}, ("slot",)):
                yield document["slot"]

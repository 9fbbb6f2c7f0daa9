"""Networked custody store on MongoDB (asynchronous PyMongo).

Correct without transactions: idempotent majority-journaled writes, ordered to be crash-safe (frames before a clip
leaves `staging`, effects before checkpoint). Reads use majority concern.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from types import TracebackType
from typing import Any, Self

from bson.errors import BSONError
from pymongo import ASCENDING, DESCENDING, AsyncMongoClient, DeleteOne, ReplaceOne, UpdateOne
from pymongo.asynchronous.client_session import AsyncClientSession
from pymongo.asynchronous.collection import AsyncCollection
from pymongo.asynchronous.database import AsyncDatabase
from pymongo.errors import ConfigurationError, InvalidName, OperationFailure, PyMongoError
from pymongo.read_concern import ReadConcern
from pymongo.read_preferences import ReadPreference
from pymongo.write_concern import WriteConcern

from consensus.errors import BlockRobotError
from node.custody.keyed_reads import KeyedReads
from node.custody.stores import mongo_documents as documents
from node.custody.stores.custody_store import (
    BlockEffects,
    Checkpoint,
    ClipRow,
    FramePlace,
    FrameRow,
    Grant,
    Leftovers,
    OutboxRow,
    OutboxStatus,
    RecordFacts,
    StoreCounts,
    Unwritten,
    VisitRestrictions,
    require_written,
)
from node.custody.stores.mongo_documents import STAGING, STATUSES, Document, is_passing, rows
from node.custody.stores.mongo_shares import BY_SLOT, SHARES_INDEXES, MongoShares
from node.custody.stores.mongo_uploads import BY_ROBOT, MongoUploads

Order = Sequence[tuple[str, int]]

FORMAT_VERSION = 6
SERVER_SELECTION_MAX_MS = 3_000
MAJORITY_MAX_MS = 20_000
SOCKET_MAX_MS = 30_000
_PAGE_DOCUMENTS_COUNT = 500
_ONE = "one"
TRANSACTION_ATTEMPTS_MAX_COUNT = 3
TRANSACTION_MAX_BYTES = 4 * 1024 * 1024
_MAJORITY = ReadConcern("majority")
_DURABLE = WriteConcern(w="majority", j=True, wtimeout=MAJORITY_MAX_MS)
_SESSION: ContextVar[AsyncClientSession | None] = ContextVar("custody_transaction", default=None)


def _rising(*fields: str) -> Order:
    return tuple((field, ASCENDING) for field in fields)


_BY_KEY = _rising("_id")
_BY_PLACE = _rising("record_id", "index", "slot")
_BY_CONTRACT = _rising("status", "contract", "height", "kind", "subject", "part")
_READ_BY = {"clips": "_id", "frames": "record_id", "restrictions": "_id"}
_NEWEST_FIRST: Order = (("elsewhere", ASCENDING), ("height", DESCENDING), ("_id", ASCENDING))
_INDEXES: Mapping[str, Sequence[Order]] = {
    "clips": (
        _rising("owner", "status", "_id"),
        _rising("status", "valid_until_ms", "_id"),
        _rising("status", "expires_at_ms", "_id"),
        BY_ROBOT,
    ),
    "day_uses": (_rising("day"),),
    "frames": (_BY_PLACE,),
    "grants": (_rising("owner", "_id"),),
    "missing": (_NEWEST_FIRST, _rising("expires_at_ms"), _rising("owner", "_id")),
    "restrictions": (),
    "outbox": (_BY_CONTRACT, _rising("kind", "subject", "part")),
    **SHARES_INDEXES,
}


@contextmanager
def _answering() -> Iterator[None]:
    try:
        yield
    except (PyMongoError, BSONError) as error:
        # The message of the driver may quote the URI, which may hold a password.
        raise BlockRobotError("STORE_UNAVAILABLE", f"The store's server failed ({type(error).__name__}).") from error


def _tells_of_transactions(hello: Mapping[str, Any]) -> bool:
    is_cluster = "setName" in hello or hello.get("msg") == "isdbgrid"
    return is_cluster and "logicalSessionTimeoutMinutes" in hello


def _up_to(at_ms: int) -> Document:
    """Return `<= at_ms` as `< at_ms + 1`: a test server mishandles `$lte`."""
    return {"$lt": at_ms + 1}


def _connect(uri: str) -> tuple[AsyncMongoClient[Document], AsyncDatabase[Document]]:
    try:
        client: AsyncMongoClient[Document] = AsyncMongoClient(
            uri,
            appname="blockrobot",
            serverSelectionTimeoutMS=SERVER_SELECTION_MAX_MS,
            connectTimeoutMS=SERVER_SELECTION_MAX_MS,
            socketTimeoutMS=SOCKET_MAX_MS,
            # Streamed monitoring measures round trips over one more connection, which the driver's `close` loses, open,
            # if it is just being made. A write that meets a new primary makes the driver look again at once anyway.
            serverMonitoringMode="poll",
        )
        database = client.get_default_database(
            read_preference=ReadPreference.PRIMARY,
            read_concern=_MAJORITY,
            write_concern=_DURABLE,
        )
    except (ConfigurationError, InvalidName, ValueError):
        # Not chained: the driver's message may quote the URI, which may hold a password.
        raise BlockRobotError(
            "CONFIGURATION_INVALID", "The store is named by a MongoDB URI with a database: mongodb://host:port/name."
        ) from None
    return client, database


async def _check_format(database: AsyncDatabase[Document]) -> None:
    """Mark a new database, after its indexes exist. Raises STORAGE_DAMAGED for a foreign one."""
    found = await database["format"].find_one({"_id": _ONE})
    if found is None and set(await database.list_collection_names()) - {"format", *_INDEXES}:
        raise BlockRobotError("STORAGE_DAMAGED", "The store's database has collections but no mark of their format.")
    if found is not None and found.get("version") != FORMAT_VERSION:
        detail = f"The store has format {found.get('version')!r}, not {FORMAT_VERSION}."
        raise BlockRobotError("STORAGE_DAMAGED", detail)
    for collection, indexes in _INDEXES.items():
        for fields in indexes:
            await database[collection].create_index(list(fields))
    if found is None:
        await database["format"].replace_one({"_id": _ONE}, {"version": FORMAT_VERSION}, upsert=True)


class MongoStore(MongoShares, MongoUploads):
    """A `CustodyStore` in one database of a MongoDB server."""

    def __init__(self, uri: str) -> None:
        """Take a URI of server and database: `mongodb://host:port/database`."""
        self._uri = uri
        self.has_transactions = False
        self._abandoned: list[Mapping[str, Any]] = []
        self._client: AsyncMongoClient[Document] | None = None
        self._database: AsyncDatabase[Document] | None = None
        self._keyed = {name: KeyedReads(field, partial(self._having, name, field)) for name, field in _READ_BY.items()}

    async def __aenter__(self) -> Self:
        """Raises STORE_UNAVAILABLE after three seconds, STORAGE_DAMAGED (format), CONFIGURATION_INVALID (no database)."""
        client, database = _connect(self._uri)
        try:
            with _answering():
                await _check_format(database)
                self.has_transactions = _tells_of_transactions(await client.admin.command("hello"))
        except BaseException:
            await client.close()
            raise
        self._client, self._database = client, database
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for reads in self._keyed.values():
            await reads.close()
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
                await self._collection(name).bulk_write(list(operations), ordered=True, session=_SESSION.get())

    async def _insert(self, name: str, found: Sequence[Document]) -> None:
        if found:
            with _answering():
                await self._collection(name).insert_many(found, session=_SESSION.get())

    async def _delete(self, name: str, where: Document) -> None:
        with _answering():
            await self._collection(name).delete_many(where, session=_SESSION.get())

    async def _together(self, write: Callable[[], Awaitable[None]]) -> None:
        if not self.has_transactions or self._client is None:
            await write()
            return
        for attempt in range(1, TRANSACTION_ATTEMPTS_MAX_COUNT + 1):
            try:
                with _answering():
                    await self._end_abandoned(self._client)
                    async with self._client.start_session() as session:
                        await self._in_transaction(session, write)
                return
            except BlockRobotError as error:
                if attempt == TRANSACTION_ATTEMPTS_MAX_COUNT or not is_passing(error.__cause__):
                    raise

    async def _end_abandoned(self, client: AsyncMongoClient[Document]) -> None:
        """Abort transactions whose locks would last up to a minute."""
        if doomed := self._abandoned[:]:
            with suppress(OperationFailure):  # it is known to be over, or the server does not let us: time ends it
                await client.admin.command("killSessions", doomed)
            self._abandoned = [session for session in self._abandoned if session not in doomed]

    async def _in_transaction(self, session: AsyncClientSession, write: Callable[[], Awaitable[None]]) -> None:
        options = {"read_concern": _MAJORITY, "write_concern": _DURABLE, "read_preference": ReadPreference.PRIMARY}
        token = _SESSION.set(session)
        try:
            async with await session.start_transaction(**options):  # type: ignore[arg-type]
                await write()
        except BaseException:
            self._abandoned.append(session.session_id)
            raise
        finally:
            _SESSION.reset(token)

    async def _one(self, name: str, key: Any) -> list[Document]:
        return await self._many(name, {"_id": key})

    async def _many(
        self, name: str, where: Document, *, sort: Order = _BY_KEY, limit: int = 0, fields: Sequence[str] | None = None
    ) -> list[Document]:
        """In this order; all there are come as the server finds them and are sorted here."""
        wanted = None if fields is None else {"_id": "_id" in fields, **dict.fromkeys(fields, True)}
        with _answering():
            found = self._collection(name).find(where, wanted, session=_SESSION.get())
            if limit:
                return await found.sort(list(sort)).limit(limit).to_list(None)
            return documents.in_order(await found.to_list(None), [field for field, _ in sort])

    async def _having(self, name: str, field: str, keys: Sequence[bytes]) -> list[Document]:
        return await self._many(name, {field: {"$in": list(keys)}}, sort=_BY_PLACE if name == "frames" else _BY_KEY)

    async def _with_keys(self, name: str, keys: Sequence[bytes]) -> list[Document]:
        """What has one of these keys; of one key together with others that are asked for meanwhile."""
        if len(keys) == 1:
            return await self._keyed[name].of(keys[0])
        return await self._having(name, _READ_BY[name], keys) if keys else []

    async def _walk(self, name: str, order: Order, field: str) -> AsyncIterator[int]:
        """One number of each document, read from the index of this order alone."""
        with _answering():
            async for found in self._collection(name).find({}, {"_id": False, field: True}).sort(list(order)):
                [number] = rows(lambda document: int(document[field]), [found])
                yield number

    async def _summed(self, name: str, where: Document, groups: Document) -> list[Document]:
        with _answering():
            found = await self._collection(name).aggregate([{"$match": where}, {"$group": groups}])
            return await found.to_list(None)

    async def stage(self, clip: ClipRow, frames: Sequence[FrameRow]) -> None:
        require_written(await self.stage_all([(clip, frames)]))

    async def stage_all(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> Unwritten:
        size_bytes = sum(len(row.ciphertext) for _, frames in clips for row in frames)
        if not self.has_transactions or size_bytes > TRANSACTION_MAX_BYTES:
            await self._stage_in_order(clips)
            return {}
        is_committing = False

        async def stage() -> None:
            nonlocal is_committing
            await self._stage_in_order(clips)
            is_committing = True

        try:
            await self._together(stage)
        except BlockRobotError as error:
            if is_committing:
                raise
            return {clip.record_id: error for clip, _ in clips}
        return {}

    async def _stage_in_order(self, clips: Sequence[tuple[ClipRow, Sequence[FrameRow]]]) -> None:
        record_ids, is_transaction = [clip.record_id for clip, _ in clips], _SESSION.get() is not None
        if is_transaction:
            await self._delete("clips", {"_id": {"$in": record_ids}})
        else:
            await self._bulk("clips", [documents.clip_replacement(clip, STAGING) for clip, _ in clips])
        await self._delete("frames", {"record_id": {"$in": record_ids}})
        await self._insert("frames", [documents.frame_document(row) for _, frames in clips for row in frames])
        if is_transaction:
            await self._insert("clips", [documents.clip_document(clip) for clip, _ in clips])
        else:
            await self._bulk("clips", [documents.clip_replacement(clip) for clip, _ in clips])

    async def correct(self, facts: RecordFacts) -> None:
        await self._bulk("clips", [documents.correction(facts)])

    async def replace_frames(self, record_id: bytes, frames: Sequence[FrameRow]) -> None:
        await self._bulk("frames", [documents.replacement(row) for row in frames])
        written = {row.index for row in frames}
        held = [place.index for place in await self.frame_places([record_id])]
        await self.erase_frames(record_id, [index for index in held if index not in written])

    async def extend_staged(self, record_id: bytes, txid: bytes, valid_until_ms: int) -> None:
        changes = {"$set": {"txid": txid, "valid_until_ms": valid_until_ms}}
        await self._bulk("clips", [UpdateOne({"_id": record_id, "status": "staged"}, changes)])

    async def apply(self, effects: BlockEffects) -> None:
        await self._together(lambda: self._apply_in_order(effects))

    async def _apply_in_order(self, effects: BlockEffects) -> None:
        await self._bulk(
            "outbox",
            [
                UpdateOne(
                    {"_id": documents.outbox_id(row.key)},
                    {"$setOnInsert": documents.outbox_document(row)},
                    upsert=True,
                )
                for row in effects.outbox
            ],
        )
        visit_restrictions = [documents.restrictions_document(row) for row in effects.visit_restrictions]
        await self._replace("restrictions", visit_restrictions)
        await self._bulk("clips", [documents.expiry(*change) for change in effects.expiries])
        await self._confirm(effects.confirmed)
        if found := [*(facts.record_id for facts in effects.confirmed), *effects.found]:
            await self._delete("missing", {"_id": {"$in": found}})
        await self._replace("missing", [documents.missing_document(facts) for facts in effects.missing])
        await self._replace("grants", [documents.grant_document(grant) for grant in effects.grants])
        await self._bulk("outbox", [DeleteOne({"_id": documents.outbox_id(key)}) for key in effects.settled])
        if effects.checkpoint is not None:
            await self._delete("missing", {"expires_at_ms": _up_to(effects.checkpoint.timestamp_ms)})
            await self._replace("checkpoint", [{"_id": _ONE, **documents.checkpoint_document(effects.checkpoint)}])

    async def _replace(self, name: str, rows: Sequence[Document]) -> None:
        """Many in a transaction by two commands for all of them: a server looks for each one that it is to replace."""
        if _SESSION.get() is not None and len(rows) > 1:
            last = {row["_id"]: row for row in rows}
            await self._delete(name, {"_id": {"$in": list(last)}})
            await self._insert(name, [*last.values()])
        else:
            await self._bulk(name, [ReplaceOne({"_id": row["_id"]}, row, upsert=True) for row in rows])

    async def _confirm(self, confirmed: Sequence[RecordFacts]) -> None:
        if _SESSION.get() is None or len(confirmed) < 2:
            await self._bulk("clips", [documents.confirmation(facts) for facts in confirmed])
            return
        held = await self._many("clips", {"_id": {"$in": [facts.record_id for facts in confirmed]}})
        told = {facts.record_id: documents.confirmed(facts) for facts in confirmed}
        changed = [row | told[row["_id"]] for row in held if row["status"] in {"staged", "confirmed"}]
        await self._replace("clips", changed)

    async def checkpoint(self) -> Checkpoint | None:
        found = rows(documents.checkpoint_row, await self._one("checkpoint", _ONE))
        return found[0] if found else None

    async def clips(self, record_ids: Sequence[bytes]) -> dict[bytes, ClipRow]:
        found = await self._with_keys("clips", record_ids)
        whole = [document for document in found if document.get("status") != STAGING]
        return {clip.record_id: clip for clip in rows(documents.clip_row, whole)}

    async def clips_of_owner(self, owner: bytes) -> list[ClipRow]:
        return rows(documents.clip_row, await self._many("clips", {"owner": owner, "status": "confirmed"}))

    async def frames(self, record_id: bytes) -> list[FrameRow]:
        return rows(documents.frame_row, await self._with_keys("frames", [record_id]))

    async def frame_places(self, record_ids: Sequence[bytes]) -> list[FramePlace]:
        where = {"record_id": {"$in": list(record_ids)}}
        fields = ("record_id", "index", "slot")
        found = await self._many("frames", where, sort=_BY_PLACE, fields=fields) if record_ids else []
        return rows(documents.frame_place, found)

    async def references(self, record_ids: Sequence[bytes], size_bytes: int) -> dict[bytes, set[bytes]]:
        where, fields = {"record_id": {"$in": list(record_ids)}}, ("record_id", "ciphertext")
        held = await self._many("frames", where, sort=_rising("record_id"), fields=fields) if record_ids else []
        found: dict[bytes, set[bytes]] = {}
        for record_id, text in rows(
            lambda document: (bytes(document["record_id"]), bytes(document["ciphertext"])), held
        ):
            if len(text) == size_bytes:
                found.setdefault(record_id, set()).add(text)
        return found

    async def erase_frames(self, record_id: bytes, indexes: Sequence[int]) -> None:
        await self._bulk("frames", [DeleteOne(documents.frame_key(record_id, index)) for index in indexes])

    async def erase_clips(self, record_ids: Sequence[bytes]) -> None:
        """See `CustodyStore.erase_clips`; marks first, so a half-erased clip is never served."""
        ids = list(dict.fromkeys(record_ids))
        marks = [documents.clip_document(ClipRow(record_id, b"", 0, "erased", (), ())) for record_id in ids]

        async def erase() -> None:
            await self._replace("clips", marks)
            await self._delete("frames", {"record_id": {"$in": ids}})
            await self._delete("missing", {"_id": {"$in": ids}})

        if ids:
            await self._together(erase)

    async def drop_staged(self, record_ids: Sequence[bytes]) -> None:
        """See `CustodyStore.drop_staged`; the clips go last, so no frame is orphaned."""
        staged = {"_id": {"$in": list(record_ids)}, "status": {"$in": STATUSES["staged"]}}
        with _answering():
            hidden = await self._collection("clips").update_many(staged, {"$set": {"status": STAGING}})
        if hidden.matched_count:
            rows_now = await self._many("clips", {"_id": staged["_id"]}, fields=("_id", "status"))
            found = [row["_id"] for row in rows_now if row["status"] == STAGING]
            await self._delete("frames", {"record_id": {"$in": found}})
            await self._delete("clips", {"_id": {"$in": found}})

    async def sweep(self) -> None:
        """See `CustodyStore.sweep`; a server's files are its own, so there is nothing to do from here."""

    async def sweep_blobs(self) -> int:
        return 0

    async def lapsed(self, at_ms: int, limit: int) -> list[bytes]:
        """See `CustodyStore.lapsed`; includes clips whose staging was cut off."""
        found: list[Document] = []
        for status in STATUSES["staged"]:
            where = {"status": status, "valid_until_ms": _up_to(at_ms)}
            order = _rising("status", "valid_until_ms", "_id")
            found += await self._many("clips", where, sort=order, limit=limit, fields=("_id", "valid_until_ms"))
        found.sort(key=lambda document: (document["valid_until_ms"], document["_id"]))
        return [document["_id"] for document in found[:limit]]

    async def expired(self, at_ms: int, limit: int) -> list[bytes]:
        where = {"status": "confirmed", "expires_at_ms": _up_to(at_ms)}
        order = _rising("status", "expires_at_ms", "_id")
        found = await self._many("clips", where, sort=order, limit=limit, fields=("_id",))
        return [document["_id"] for document in found]

    async def missing(self, limit: int, after: tuple[int, bytes] | None = None) -> list[RecordFacts]:
        wanted: Document = {"elsewhere": False}
        if after is not None:
            height, record_id = after
            wanted |= {"height": {"$lte": height}, "$or": [{"height": {"$lt": height}}, {"_id": {"$gt": record_id}}]}
        found = await self._many("missing", wanted, sort=_NEWEST_FIRST, limit=limit)
        return rows(documents.missing_row, found)

    async def absent(self, after: bytes, limit: int) -> list[RecordFacts]:
        found = await self._many("missing", {"_id": {"$gt": after}}, sort=_BY_KEY, limit=limit)
        return rows(documents.missing_row, found)

    async def count_missing(self) -> int:
        return await self._count("missing", {"elsewhere": False})

    async def missing_clips(self, record_ids: Sequence[bytes]) -> dict[bytes, RecordFacts]:
        found = await self._many("missing", {"_id": {"$in": list(record_ids)}}) if record_ids else []
        return {facts.record_id: facts for facts in rows(documents.missing_row, found)}

    async def missing_of_owner(self, owner: bytes) -> list[RecordFacts]:
        return rows(documents.missing_row, await self._many("missing", {"owner": owner}))

    async def grant(self, access_id: bytes) -> Grant | None:
        found = rows(documents.grant_row, await self._one("grants", access_id))
        return found[0] if found else None

    async def grants_of_owners(self, owners: Sequence[bytes]) -> list[Grant]:
        where = {"owner": {"$in": list(owners)}}
        found = await self._many("grants", where, sort=_rising("owner", "_id")) if owners else []
        return rows(documents.grant_row, found)

    async def all_grants(self) -> AsyncIterator[Grant]:
        last = b""
        while found := await self._many("grants", {"_id": {"$gt": last}}, limit=_PAGE_DOCUMENTS_COUNT):
            for grant in rows(documents.grant_row, found):
                yield grant
            last = found[-1]["_id"]

    async def visit_restrictions(self, owners: Sequence[bytes] | None = None) -> dict[bytes, VisitRestrictions]:
        found = await (self._many("restrictions", {}) if owners is None else self._with_keys("restrictions", owners))
        return {row.owner: row for row in rows(documents.restrictions_row, found)}

    async def add_outbox(self, row: OutboxRow) -> None:
        await self.apply(BlockEffects(outbox=(row,)))

    async def mark_outbox_ready(self, key: tuple[str, bytes, int]) -> None:
        changes = {"$set": {"status": "ready", "plan": b""}}
        await self._bulk("outbox", [UpdateOne({"_id": documents.outbox_id(key)}, changes)])

    async def remove_outbox(self, key: tuple[str, bytes, int]) -> None:
        await self.apply(BlockEffects(settled=(key,)))

    async def outbox(self, status: OutboxStatus, contract: str, limit: int) -> list[OutboxRow]:
        found = await self._many("outbox", {"status": status, "contract": contract}, sort=_BY_CONTRACT, limit=limit)
        return rows(documents.outbox_row, found)

    async def outbox_of(self, kind: str, subject: bytes) -> list[OutboxRow]:
        order = _rising("kind", "subject", "part")
        return rows(documents.outbox_row, await self._many("outbox", {"kind": kind, "subject": subject}, sort=order))

    async def all_clips(self) -> AsyncIterator[ClipRow]:
        last = b""
        while found := await self._many("clips", {"_id": {"$gt": last}}, limit=_PAGE_DOCUMENTS_COUNT):
            for clip in rows(documents.clip_row, [document for document in found if document["status"] != STAGING]):
                yield clip
            last = found[-1]["_id"]

    async def slots_in_use(self) -> AsyncIterator[int]:
        for name, order in (("frames", _BY_PLACE), ("parts", BY_SLOT)):
            async for slot in self._walk(name, order, "slot"):
                yield slot

    async def records_with_frames(self) -> AsyncIterator[bytes]:
        last = b""
        while found := await self._many(
            "frames", {"record_id": {"$gt": last}}, sort=_BY_PLACE, limit=_PAGE_DOCUMENTS_COUNT, fields=("record_id",)
        ):
            for record_id in dict.fromkeys(rows(lambda document: bytes(document["record_id"]), found)):
                yield record_id
            last = found[-1]["record_id"]

    async def counts(self) -> StoreCounts:
        """See `CustodyStore.counts`; half-written clips count as staged."""
        return StoreCounts(
            staged=await self._count("clips", {"status": {"$in": STATUSES["staged"]}}),
            confirmed=await self._count("clips", {"status": "confirmed"}),
            erased=await self._count("clips", {"status": "erased"}),
            frames=await self._count("frames", {}),
            missing=await self.count_missing(),
            outbox_ready=await self._count("outbox", {"status": "ready"}),
            outbox_erasing=await self._count("outbox", {"status": "erasing"}),
            size_bytes=await self._size_bytes(),
            shares=await self._count("shares", {}),
            parts=await self._count("parts", {}),
            elsewhere=await self._count("missing", {"elsewhere": True}),
        )

    async def _size_bytes(self) -> int | None:
        """Return the size of data and indexes; None without permission."""
        if self._database is None:
            raise BlockRobotError("STORE_UNAVAILABLE", "The store is not open.")
        try:
            with _answering():
                statistics = await self._database.command("dbStats")
        except BlockRobotError as error:
            if isinstance(error.__cause__, OperationFailure):
                return None
            raise
        return (
            int(statistics["storageSize"] + statistics["indexSize"])
            if {"storageSize", "indexSize"} <= set(statistics)
            else None
        )

    async def _count(self, name: str, where: Document) -> int:
        with _answering():
            return await self._collection(name).count_documents(where)

    async def clear(self) -> None:
        """Delete every row: of a copy that is given up, or begun again."""
        for name in sorted({*_INDEXES, "backgrounds", "checkpoint"}):
            await self._delete(name, {})

    async def leftovers(self) -> Leftovers:
        return Leftovers(None, None)

"""Shares in the MongoDB custody store: idempotent majority writes, keys of grant and record."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pymongo import ASCENDING, DeleteOne, ReplaceOne, UpdateOne

from node.custody.stores.mongo_documents import Document, rows
from node.custody.stores.share_store import PartField, PartPlace, PartRow, ShareRow

Order = Sequence[tuple[str, int]]

_BY_KEY: Order = (("_id", ASCENDING),)
_BY_END: Order = (("until_ms", ASCENDING), ("_id", ASCENDING))
_BY_EXPIRY: Order = (("expires_at_ms", ASCENDING),)
_BY_VALID_UNTIL: Order = (("status", ASCENDING), ("valid_until_ms", ASCENDING))
BY_SLOT: Order = (("slot", ASCENDING),)


def _by(field: str) -> Order:
    return ((field, ASCENDING), ("_id", ASCENDING))


SHARES_INDEXES: Mapping[str, Sequence[Order]] = {
    "shares": (_BY_END, _by("owner")),
    "parts": (
        _by("grant_id"),
        _by("record_id"),
        _by("owner"),
        _BY_VALID_UNTIL,
        BY_SLOT,
    ),
}
_PLACE_FIELDS = ("grant_id", "record_id", "owner", "status", "height", "slot")
_PAGE_DOCUMENTS_COUNT = 500


def _share(found: Document) -> ShareRow:
    return ShareRow(found["_id"], found["owner"], tuple(found["records"]), found["until_ms"], found["height"])


def _place(found: Document) -> PartPlace:
    return PartPlace(**{field: found[field] for field in _PLACE_FIELDS})


def _part(found: Document) -> PartRow:
    return PartRow(**{name: value for name, value in found.items() if name != "_id"})


class MongoShares:
    """See `ShareStore`; part of `MongoStore`."""

    if TYPE_CHECKING:  # the store's own

        async def _bulk(self, name: str, operations: Sequence[Any]) -> None: ...

        async def _many(
            self,
            name: str,
            where: Document,
            *,
            sort: Order = _BY_KEY,
            limit: int = 0,
            fields: Sequence[str] | None = None,
        ) -> list[Document]: ...

    async def put_share(self, share: ShareRow) -> None:
        document = {"owner": share.owner, "records": list(share.records), "until_ms": share.until_ms}
        await self._bulk(
            "shares", [ReplaceOne({"_id": share.grant_id}, document | {"height": share.height}, upsert=True)]
        )

    async def share(self, grant_id: bytes) -> ShareRow | None:
        found = rows(_share, await self._many("shares", {"_id": grant_id}))
        return found[0] if found else None

    async def shares_over(self, at_ms: int, limit: int) -> list[bytes]:
        where = {"until_ms": {"$lt": at_ms + 1}}
        found = await self._many("shares", where, sort=_BY_END, limit=limit, fields=("_id", "until_ms"))
        return [document["_id"] for document in found]

    async def shares_of(self, owner: bytes) -> list[ShareRow]:
        return rows(_share, await self._many("shares", {"owner": owner}, sort=_by("owner")))

    async def missing_over(self, at_ms: int) -> list[bytes]:
        over = {"expires_at_ms": {"$lt": at_ms + 1}}
        found = await self._many("missing", over, fields=("_id", "expires_at_ms"), sort=_BY_EXPIRY)
        found.sort(key=lambda document: (document["expires_at_ms"], document["_id"]))
        return [document["_id"] for document in found]

    async def forget_share(self, grant_id: bytes) -> None:
        await self._bulk("shares", [DeleteOne({"_id": grant_id})])

    async def all_shares(self) -> AsyncIterator[ShareRow]:
        last = b""
        while found := await self._many("shares", {"_id": {"$gt": last}}, limit=_PAGE_DOCUMENTS_COUNT):
            for share in rows(_share, found):
                yield share
            last = found[-1]["_id"]

    async def put_part(self, row: PartRow) -> None:
        document = {
            "grant_id": row.grant_id,
            "record_id": row.record_id,
            "owner": row.owner,
            "valid_until_ms": row.valid_until_ms,
            "status": row.status,
            "height": row.height,
            "slot": row.slot,
            "wrapped": row.wrapped,
        }
        await self._bulk("parts", [ReplaceOne({"_id": row.grant_id + row.record_id}, document, upsert=True)])

    async def part(self, grant_id: bytes, record_id: bytes) -> PartRow | None:
        found = rows(_part, await self._many("parts", {"_id": grant_id + record_id}))
        return found[0] if found else None

    async def parts_of(self, field: PartField, keys: Sequence[bytes]) -> list[PartPlace]:
        where: Document = {field: {"$in": list(keys)}}
        found = rows(
            _place, await self._many("parts", where, sort=((field, ASCENDING),), fields=_PLACE_FIELDS) if keys else []
        )
        return sorted(found, key=lambda place: (place.grant_id, place.record_id))

    async def lapsed_parts(self, at_ms: int, limit: int) -> list[PartPlace]:
        where = {"status": "staged", "valid_until_ms": {"$lt": at_ms + 1}}
        found = await self._many("parts", where, sort=_BY_VALID_UNTIL, limit=limit, fields=_PLACE_FIELDS)
        return rows(_place, found)

    async def confirm_parts(self, grant_id: bytes, record_ids: Sequence[bytes], height: int) -> None:
        changes = {"$set": {"status": "confirmed", "height": height}}
        await self._bulk("parts", [UpdateOne({"_id": grant_id + record_id}, changes) for record_id in record_ids])

    async def erase_parts(self, slots: Sequence[int]) -> None:
        await self._bulk("parts", [DeleteOne({"slot": slot}) for slot in slots])

    async def all_parts(self) -> AsyncIterator[PartPlace]:
        last, fields = b"", ("_id", *_PLACE_FIELDS)
        while found := await self._many("parts", {"_id": {"$gt": last}}, limit=_PAGE_DOCUMENTS_COUNT, fields=fields):
            for place in rows(_place, found):
                yield place
            last = found[-1]["_id"]

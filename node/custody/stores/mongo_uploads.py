"""Empty frames and the upload account in a MongoDB database."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pymongo import ReplaceOne, UpdateOne

from consensus.primitives.encoding import u64
from node.custody.stores.mongo_documents import STATUSES, rows
from node.custody.uploads.upload_usage import USAGE_KEPT_DAYS, DayUse, Use

Document = dict[str, Any]

BY_ROBOT = (("status", 1), ("robot", 1), ("size_bytes", 1))


class MongoUploads:
    """See `CustodyStore`; part of `MongoStore`."""

    if TYPE_CHECKING:  # the store's own

        async def _bulk(self, name: str, operations: Sequence[Any]) -> None: ...

        async def _delete(self, name: str, where: Document) -> None: ...

        async def _one(self, name: str, key: Any) -> list[Document]: ...

        async def _summed(self, name: str, where: Document, groups: Document) -> list[Document]: ...

        async def _many(
            self, name: str, where: Document, *, sort: Any = ..., limit: int = 0, fields: Sequence[str] | None = None
        ) -> list[Document]: ...

    async def use_by_robot(self, status: str) -> dict[bytes, Use]:
        sums = {"count": {"$sum": 1}, "size_bytes": {"$sum": "$size_bytes"}}
        where = {"status": {"$in": STATUSES[status]}}
        found = await self._summed("clips", where, {"_id": "$robot", **sums})
        return {bytes(row["_id"] or b""): Use(int(row["count"]), int(row["size_bytes"])) for row in found}

    async def add_use(self, use: DayUse) -> None:
        row = {"day": use.day, "robot": use.robot}
        change = {"$set": row, "$inc": {"size_bytes": use.size_bytes}}
        await self._bulk("day_uses", [UpdateOne({"_id": u64(use.day) + use.robot}, change, upsert=True)])
        await self._delete("day_uses", {"day": {"$lt": use.day - USAGE_KEPT_DAYS}})

    async def day_uses(self) -> list[DayUse]:
        found = await self._many("day_uses", {})
        return [DayUse(int(row["day"]), bytes(row["robot"]), int(row["size_bytes"])) for row in found]

    async def put_background(self, digest: bytes, content: bytes) -> None:
        await self._bulk("backgrounds", [ReplaceOne({"_id": digest}, {"content": content}, upsert=True)])

    async def background(self, digest: bytes) -> bytes | None:
        found = rows(lambda document: bytes(document["content"]), await self._one("backgrounds", digest))
        return found[0] if found else None

    async def background_digests(self) -> list[bytes]:
        return [bytes(found["_id"]) for found in await self._many("backgrounds", {}, fields=("_id",))]

    async def delete_backgrounds(self, digests: Sequence[bytes]) -> None:
        await self._delete("backgrounds", {"_id": {"$in": list(digests)}})

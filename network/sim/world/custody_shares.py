"""Shares in the simulator's custody store."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from node.custody.stores.custody_store import RecordFacts
from node.custody.stores.share_store import PartField, PartPlace, PartRow, ShareRow


def _place(row: PartRow) -> PartPlace:
    return PartPlace(row.grant_id, row.record_id, row.owner, row.status, row.height, row.slot)


class MemoryShares:
    """In-memory `ShareStore`, part of `MemoryCustodyStore`."""

    def __init__(self) -> None:
        self._shares: dict[bytes, ShareRow] = {}
        self._parts: dict[tuple[bytes, bytes], PartRow] = {}

    if TYPE_CHECKING:  # the store's own
        _missing: dict[bytes, RecordFacts]

        def _require_open(self) -> None: ...

        async def _begin_writing(self) -> None: ...

    async def put_share(self, share: ShareRow) -> None:
        await self._begin_writing()
        self._shares[share.grant_id] = share

    async def share(self, grant_id: bytes) -> ShareRow | None:
        self._require_open()
        return self._shares.get(grant_id)

    async def shares_over(self, at_ms: int, limit: int) -> list[bytes]:
        self._require_open()
        due = [share for share in self._shares.values() if share.until_ms <= at_ms]
        return [share.grant_id for share in sorted(due, key=lambda share: (share.until_ms, share.grant_id))][:limit]

    async def shares_of(self, owner: bytes) -> list[ShareRow]:
        self._require_open()
        return [share for _, share in sorted(self._shares.items()) if share.owner == owner]

    async def missing_over(self, at_ms: int) -> list[bytes]:
        self._require_open()
        over = [facts for facts in self._missing.values() if facts.expires_at_ms <= at_ms]
        return [facts.record_id for facts in sorted(over, key=lambda facts: (facts.expires_at_ms, facts.record_id))]

    async def forget_share(self, grant_id: bytes) -> None:
        await self._begin_writing()
        self._shares.pop(grant_id, None)

    async def all_shares(self) -> AsyncIterator[ShareRow]:
        self._require_open()
        for _, share in sorted(self._shares.items()):
            yield share

    async def put_part(self, row: PartRow) -> None:
        await self._begin_writing()
        self._parts[row.grant_id, row.record_id] = row

    async def part(self, grant_id: bytes, record_id: bytes) -> PartRow | None:
        self._require_open()
        return self._parts.get((grant_id, record_id))

    async def parts_of(self, field: PartField, keys: Sequence[bytes]) -> list[PartPlace]:
        self._require_open()
        return [_place(row) for _, row in sorted(self._parts.items()) if getattr(row, field) in keys]

    async def lapsed_parts(self, at_ms: int, limit: int) -> list[PartPlace]:
        self._require_open()
        due = [row for row in self._parts.values() if row.status == "staged" and row.valid_until_ms <= at_ms]
        return [_place(row) for row in sorted(due, key=lambda row: row.valid_until_ms)][:limit]

    async def confirm_parts(self, grant_id: bytes, record_ids: Sequence[bytes], height: int) -> None:
        await self._begin_writing()
        for record_id in record_ids:
            row = self._parts.get((grant_id, record_id))
            if row is not None:
                self._parts[grant_id, record_id] = replace(row, status="confirmed", height=height)

    async def erase_parts(self, slots: Sequence[int]) -> None:
        await self._begin_writing()
        for key in [key for key, row in self._parts.items() if row.slot in slots]:
            del self._parts[key]

    async def all_parts(self) -> AsyncIterator[PartPlace]:
        self._require_open()
        for _, row in sorted(self._parts.items()):
            yield _place(row)

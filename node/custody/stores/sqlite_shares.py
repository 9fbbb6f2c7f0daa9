"""Shares in the embedded custody store."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from typing import TYPE_CHECKING, Any

from node.custody.stores.share_store import PartField, PartPlace, PartRow, ShareRow

SHARES_SCHEMA = """
CREATE TABLE shares (grant_id BLOB PRIMARY KEY, owner BLOB NOT NULL, records BLOB NOT NULL,
    until_ms INTEGER NOT NULL, height INTEGER NOT NULL) WITHOUT ROWID;
CREATE INDEX shares_by_end ON shares (until_ms, grant_id);
CREATE TABLE parts (grant_id BLOB NOT NULL, record_id BLOB NOT NULL, owner BLOB NOT NULL,
    valid_until_ms INTEGER NOT NULL, status TEXT NOT NULL, height INTEGER NOT NULL, slot INTEGER NOT NULL,
    wrapped BLOB NOT NULL, PRIMARY KEY (grant_id, record_id)) WITHOUT ROWID;
CREATE INDEX parts_by_record ON parts (record_id);
CREATE INDEX parts_by_owner ON parts (owner);
CREATE INDEX parts_by_valid_until ON parts (status, valid_until_ms);
CREATE INDEX parts_by_slot ON parts (slot);
CREATE INDEX shares_by_owner ON shares (owner, grant_id);
"""
"""The tables of shares."""

_RECORD_ID_BYTES = 16
_PAGE_ROWS_COUNT = 500
_PLACE = "grant_id, record_id, owner, status, height, slot"
_SHARE = "grant_id, owner, records, until_ms, height"
_PART = "grant_id, record_id, owner, valid_until_ms, status, height, slot, wrapped"
_OF_FIELD: dict[PartField, str] = {
    field: f"SELECT {_PLACE} FROM parts WHERE {field} = ? ORDER BY grant_id, record_id"  # noqa: S608
    for field in ("grant_id", "record_id", "owner")
}


def _share(row: Sequence[Any]) -> ShareRow:
    records = tuple(row[2][at : at + _RECORD_ID_BYTES] for at in range(0, len(row[2]), _RECORD_ID_BYTES))
    return ShareRow(row[0], row[1], records, row[3], row[4])


class SqliteShares:
    """See `ShareStore`; part of `SqliteStore`."""

    if TYPE_CHECKING:  # the store's own

        async def _read(self, query: str, *arguments: Any) -> list[tuple[Any, ...]]: ...

        async def _write_one(self, query: str, *rows: Sequence[Any]) -> None: ...

    async def put_share(self, share: ShareRow) -> None:
        row = (share.grant_id, share.owner, b"".join(share.records), share.until_ms, share.height)
        await self._write_one("INSERT OR REPLACE INTO shares VALUES (?, ?, ?, ?, ?)", row)

    async def share(self, grant_id: bytes) -> ShareRow | None:
        rows = await self._read(f"SELECT {_SHARE} FROM shares WHERE grant_id = ?", grant_id)  # noqa: S608
        return _share(rows[0]) if rows else None

    async def shares_over(self, at_ms: int, limit: int) -> list[bytes]:
        query = "SELECT grant_id FROM shares WHERE until_ms <= ? ORDER BY until_ms, grant_id LIMIT ?"
        return [row[0] for row in await self._read(query, at_ms, limit)]

    async def shares_of(self, owner: bytes) -> list[ShareRow]:
        query = f"SELECT {_SHARE} FROM shares WHERE owner = ? ORDER BY grant_id"  # noqa: S608
        return [_share(row) for row in await self._read(query, owner)]

    async def missing_over(self, at_ms: int) -> list[bytes]:
        query = "SELECT record_id FROM missing WHERE expires_at_ms <= ? ORDER BY expires_at_ms, record_id"
        return [row[0] for row in await self._read(query, at_ms)]

    async def forget_share(self, grant_id: bytes) -> None:
        await self._write_one("DELETE FROM shares WHERE grant_id = ?", (grant_id,))

    async def all_shares(self) -> AsyncIterator[ShareRow]:
        query = f"SELECT {_SHARE} FROM shares WHERE grant_id > ? ORDER BY grant_id LIMIT ?"  # noqa: S608
        last = b""
        while rows := await self._read(query, last, _PAGE_ROWS_COUNT):
            for row in rows:
                yield _share(row)
            last = rows[-1][0]

    async def put_part(self, row: PartRow) -> None:
        values = (row.grant_id, row.record_id, row.owner, row.valid_until_ms, row.status, row.height, row.slot)
        await self._write_one("INSERT OR REPLACE INTO parts VALUES (?, ?, ?, ?, ?, ?, ?, ?)", (*values, row.wrapped))

    async def part(self, grant_id: bytes, record_id: bytes) -> PartRow | None:
        query = f"SELECT {_PART} FROM parts WHERE grant_id = ? AND record_id = ?"  # noqa: S608
        rows = await self._read(query, grant_id, record_id)
        return PartRow(*rows[0]) if rows else None

    async def parts_of(self, field: PartField, keys: Sequence[bytes]) -> list[PartPlace]:
        found = [PartPlace(*row) for key in sorted(set(keys)) for row in await self._read(_OF_FIELD[field], key)]
        return sorted(found, key=lambda place: (place.grant_id, place.record_id))

    async def lapsed_parts(self, at_ms: int, limit: int) -> list[PartPlace]:
        due = "status = 'staged' AND valid_until_ms <= ? ORDER BY valid_until_ms LIMIT ?"
        return [PartPlace(*row) for row in await self._read(f"SELECT {_PLACE} FROM parts WHERE {due}", at_ms, limit)]  # noqa: S608

    async def confirm_parts(self, grant_id: bytes, record_ids: Sequence[bytes], height: int) -> None:
        query = "UPDATE parts SET status = 'confirmed', height = ? WHERE grant_id = ? AND record_id = ?"
        await self._write_one(query, *((height, grant_id, record_id) for record_id in record_ids))

    async def erase_parts(self, slots: Sequence[int]) -> None:
        await self._write_one("DELETE FROM parts WHERE slot = ?", *((slot,) for slot in slots))

    async def all_parts(self) -> AsyncIterator[PartPlace]:
        after = "(grant_id, record_id) > (?, ?) ORDER BY grant_id, record_id LIMIT ?"
        query, last = f"SELECT {_PLACE} FROM parts WHERE {after}", (b"", b"")  # noqa: S608
        while rows := await self._read(query, *last, _PAGE_ROWS_COUNT):
            for row in rows:
                yield PartPlace(*row)
            last = (rows[-1][0], rows[-1][1])

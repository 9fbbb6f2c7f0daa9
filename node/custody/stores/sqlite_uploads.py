"""The upload account in the embedded custody store."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from node.custody.uploads.upload_usage import USAGE_KEPT_DAYS, DayUse, Use

UPLOADS_SCHEMA = """
CREATE INDEX clips_by_robot ON clips (status, robot, size_bytes);
CREATE TABLE day_uses (day INTEGER NOT NULL, robot BLOB NOT NULL, size_bytes INTEGER NOT NULL,
    PRIMARY KEY (day, robot)) WITHOUT ROWID;
"""


class SqliteUploads:
    """See `UploadAccount`; part of `SqliteStore`."""

    if TYPE_CHECKING:  # the store's own

        async def _read(self, query: str, *arguments: Any) -> list[tuple[Any, ...]]: ...

        async def _write(self, work: Callable[[sqlite3.Connection], None]) -> None: ...

    async def use_by_robot(self, status: str) -> dict[bytes, Use]:
        query = "SELECT robot, count(*), sum(size_bytes) FROM clips WHERE status = ? GROUP BY robot"
        return {robot: Use(count, size_bytes) for robot, count, size_bytes in await self._read(query, status)}

    async def add_use(self, use: DayUse) -> None:
        def write(database: sqlite3.Connection) -> None:
            database.execute(
                "INSERT INTO day_uses VALUES (?, ?, ?) "
                "ON CONFLICT DO UPDATE SET size_bytes = size_bytes + excluded.size_bytes",
                (use.day, use.robot, use.size_bytes),
            )
            database.execute("DELETE FROM day_uses WHERE day < ?", (use.day - USAGE_KEPT_DAYS,))

        await self._write(write)

    async def day_uses(self) -> list[DayUse]:
        return [
            DayUse(*row) for row in await self._read("SELECT day, robot, size_bytes FROM day_uses ORDER BY day, robot")
        ]

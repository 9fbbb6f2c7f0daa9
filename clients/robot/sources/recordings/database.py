"""Opens a recording's untrusted SQLite database.

Only plain recorder tables are allowed: no views, triggers, generated columns or virtual tables. Work, memory and rows
are bounded by file size.
"""

from __future__ import annotations

import re
import stat
from pathlib import Path
from typing import Any

import apsw
from rosbags.rosbag2 import storage_sqlite3

STEPS_LEAST_COUNT = 1_000_000
STEPS_PER_BYTE = 8
"""Steps of SQLite's machine that a connection may take. A row takes some 40 to be counted and read, and 20 bytes."""
READ_LEAST_BYTES = 64 * 1024
READ_PER_BYTE = 3
"""How often a connection may give out the bytes of the file; each table is read once."""
ROW_BYTES = 16
"""What a row counts in addition to its texts and data; a message takes 20 bytes of a file at least."""
VALUE_MAX_BYTES = 256 * 1024 * 1024
HEAP_MAX_BYTES = 512 * 1024 * 1024
"""All that SQLite may take in this process, sorting included: no file for temporary data is made."""

_STEPS_BETWEEN = 10_000
_TABLES = frozenset({"schema", "metadata", "topics", "messages", "message_definitions"})
_STATISTICS = frozenset({"sqlite_sequence", "sqlite_stat1", "sqlite_stat4"})
_TABLE = re.compile(r'CREATE TABLE\s+["`]?(\w+)["`]?\s*\([\w\s,"`]*\)\s*;?\s*', re.ASCII)
_INDEX = re.compile(
    r'CREATE (?:UNIQUE )?INDEX\s+["`]?\w+["`]?\s+ON\s+["`]?(\w+)["`]?\s*\([\w\s,"`]*\)\s*;?\s*', re.ASCII
)


class ForeignDatabaseError(apsw.Error):
    """The database has a foreign schema, or exceeds its size's limits."""


def open_database(path: Path, *, cut_off: bool = False) -> apsw.Connection:
    """Open a checked database read-only, `cut_off`: truncated allowed. Raises `apsw.Error`, `OSError`, ValueError."""
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise ForeignDatabaseError("It is no regular file.")
    apsw.hard_heap_limit(HEAP_MAX_BYTES)
    # the path is escaped, so that no name in a bag's folder leads to another file
    base = apsw.Connection(
        f"{path.resolve().as_uri()}?immutable=1", flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    )
    try:
        _bound(base, found.st_size)
        if cut_off:
            base.execute("PRAGMA writable_schema=ON")  # otherwise a short file is refused as a whole
        _require_plain(base)
    except BaseException:
        base.close()
        raise
    return base


def _bound(base: apsw.Connection, size: int) -> None:
    base.limit(apsw.SQLITE_LIMIT_LENGTH, min(max(size, READ_LEAST_BYTES), VALUE_MAX_BYTES))
    base.limit(apsw.SQLITE_LIMIT_ATTACHED, 0)
    base.limit(apsw.SQLITE_LIMIT_WORKER_THREADS, 0)
    steps_left = STEPS_LEAST_COUNT + STEPS_PER_BYTE * size
    bytes_left = READ_LEAST_BYTES + READ_PER_BYTE * size

    def has_used_up() -> bool:
        nonlocal steps_left
        steps_left -= _STEPS_BETWEEN
        return steps_left < 0

    def count_bytes(_cursor: apsw.Cursor, row: tuple[Any, ...]) -> tuple[Any, ...]:
        nonlocal bytes_left
        bytes_left -= ROW_BYTES + sum(len(value) for value in row if isinstance(value, str | bytes))
        if bytes_left < 0:
            raise ForeignDatabaseError("Its rows hold more than the file.")
        return row

    base.set_progress_handler(has_used_up, _STEPS_BETWEEN)
    base.row_trace = count_bytes
    base.execute("PRAGMA trusted_schema=OFF")
    base.execute("PRAGMA temp_store=MEMORY")
    base.execute("PRAGMA mmap_size=0")


def _require_plain(base: apsw.Connection) -> None:
    """Raise `ForeignDatabaseError` for other than expected plain tables and indexes."""
    names = []
    for kind, name, sql in base.execute("SELECT type, name, sql FROM sqlite_master"):
        if kind == "table" and name in _STATISTICS:
            continue
        if kind == "index" and sql is None:
            continue  # SQLite makes it for a column that is unique
        shape = {"table": _TABLE, "index": _INDEX}.get(kind) if isinstance(kind, str) else None
        found = shape.fullmatch(sql) if shape and isinstance(sql, str) else None
        if found is None or found[1] not in _TABLES or (kind == "table" and found[1] != name):
            raise ForeignDatabaseError("It holds more than the tables of a recording.")
        if kind == "table":
            names.append(found[1])
    for name in names:
        for *_, default, _key, hidden in base.execute(f"PRAGMA table_xinfo({name})"):
            if hidden or default is not None:
                raise ForeignDatabaseError(f"A column of its table {name} computes what it holds.")


class _BoundedApsw:
    Error = apsw.Error
    SQLITE_OPEN_READONLY = apsw.SQLITE_OPEN_READONLY
    SQLITE_OPEN_URI = apsw.SQLITE_OPEN_URI

    @staticmethod
    def Connection(uri: str, flags: int, vfs: None) -> apsw.Connection:  # noqa: ARG004, N802 - the library's names
        """Open the library's file; refuses files needing a full sort."""
        base = open_database(Path(uri.removeprefix("file:").removesuffix("?immutable=1")))
        indexed = "SELECT 1 FROM pragma_index_list('messages') AS l, pragma_index_info(l.name) AS i WHERE i.seqno = 0"
        if base.execute(f"{indexed} AND i.name = 'timestamp'").fetchone() is None:
            base.close()
            raise ForeignDatabaseError("Its messages have no index by time.")
        return base


def bound_databases() -> None:
    """Install this module in the library."""
    storage_sqlite3.apsw = _BoundedApsw  # type: ignore[assignment, attr-defined]

"""Sweeping an SQLite database: cut the log, and overwrite what no row holds. Must never skip a page that was written.

Only pages that were written since the last sweep can hold anything new, and the write-ahead log lists all of them, as
long as nothing but a sweep copies it into the database. So the store turns automatic checkpoints off, and a sweep costs
what was written. A stamp of the database file (inode, size, times) tells whether another program, a restored backup or
a power cut changed it in between: then every page is walked, as `PageFile.clean` does it. The log is cut last, so that
after a crash it still names the pages.
"""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

from consensus.errors import BlockRobotError
from node.custody.stores.sqlite_log import read_written_pages
from node.custody.stores.sqlite_pages import PageFile

LOG_MAX_BYTES = 16 * 1024 * 1024
"""From this size of the log on a commit is followed by a sweep."""

_READ_BY_ANOTHER = "Another program reads the database, so its log cannot be cut."


def find_roots(database: sqlite3.Connection) -> list[int]:
    """Return the first pages of all tables and indexes."""
    return [row[0] for row in database.execute("SELECT rootpage FROM sqlite_master WHERE rootpage > 0")]


class Sweeper:
    """Sweeps one database file, whose descriptor the store keeps open. All calls from the store's one thread."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._descriptor = descriptor
        self._log, self._note = (path.with_name(f"{path.name}-{what}") for what in ("wal", "swept"))
        self._version = -1
        try:
            self._stamp = self._note.read_text()
        except (OSError, UnicodeDecodeError):
            self._stamp = ""

    @property
    def log_bytes(self) -> int:
        """The size of the write-ahead log."""
        try:
            return self._log.stat().st_size
        except FileNotFoundError:
            return 0

    @property
    def is_known_clean(self) -> bool:
        """Tell whether the file is as the last sweep left it, so that only the log's pages need to be looked at."""
        return self._stamp == self._read_stamp()

    def distrust(self) -> None:
        """Let the next sweep walk every page."""
        self._stamp = ""

    def begin(self, database: sqlite3.Connection) -> None:
        """Take up a connection that was just opened."""
        database.execute("PRAGMA wal_autocheckpoint = 0").fetchall()
        self._version = _read_version(database)

    def sweep(self, database: sqlite3.Connection) -> int:
        """Cut the log to nothing and return how many bytes had to be overwritten. Raises STORE_UNAVAILABLE.

        After any, the connection has copies of what was overwritten: it has to be closed and opened again.
        """
        is_known = self.is_known_clean
        _checkpoint(database, "FULL")
        database.execute("BEGIN IMMEDIATE")
        try:
            version = _read_version(database)
            pages, roots = PageFile(self._descriptor), find_roots(database)
            if is_known and version == self._version and pages.is_told_by_kind:
                cleaned = pages.clean_written(read_written_pages(self._log))
            else:
                cleaned = pages.clean(roots)
            os.fsync(self._descriptor)  # its times too, or after a power cut the file looks as before
            self._stamp = self._read_stamp()
        finally:
            database.execute("ROLLBACK")
        _checkpoint(database, "TRUNCATE")
        self._version = _read_version(database)
        if self._version != version or not self.is_known_clean:
            self.distrust()
        self._note.write_text(self._stamp)
        return cleaned

    def count_dirty(self, database: sqlite3.Connection) -> int:
        """Walk every page and return how many bytes that no row holds are not zero."""
        return PageFile(self._descriptor).count_dirty(find_roots(database))

    def _read_stamp(self) -> str:
        found = os.fstat(self._descriptor)
        return f"{found.st_ino} {found.st_size} {found.st_mtime_ns} {found.st_ctime_ns}"


def _checkpoint(database: sqlite3.Connection, mode: str) -> None:
    is_busy, in_log, copied = database.execute(f"PRAGMA wal_checkpoint({mode})").fetchone()
    if is_busy or in_log != copied:
        raise BlockRobotError("STORE_UNAVAILABLE", _READ_BY_ANOTHER)


def _read_version(database: sqlite3.Connection) -> int:
    """Return the number that changes whenever another connection commits."""
    version: int = database.execute("PRAGMA data_version").fetchone()[0]
    return version

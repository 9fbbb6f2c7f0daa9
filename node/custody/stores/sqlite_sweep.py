"""Sweeps an SQLite database: truncates its log and overwrites unused bytes.

Without automatic checkpoints the log lists all pages written since; it is truncated last. If the file's stamp changed
otherwise, all pages are cleaned.
"""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

import structlog

from consensus.errors import BlockRobotError
from node.custody.stores.sqlite_pages import PageFile

log = structlog.get_logger(__name__)

# https://www.sqlite.org/fileformat2.html#the_write_ahead_log
_LOG_HEADER_BYTES, _FRAME_HEADER_BYTES = 32, 24
_PAGE_SIZE, _SALTS = slice(8, 12), slice(16, 24)
_FRAME_PAGE, _FRAME_SALTS = slice(0, 4), slice(8, 16)


def read_written_pages(path: Path) -> frozenset[int]:
    """Those of rolled-back transactions included; empty without log."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return frozenset()
    try:
        header = os.pread(descriptor, _LOG_HEADER_BYTES, 0)
        written: set[int] = set()
        if len(header) < _LOG_HEADER_BYTES:
            return frozenset()
        step, salts = _FRAME_HEADER_BYTES + int.from_bytes(header[_PAGE_SIZE], "big"), header[_SALTS]
        at = _LOG_HEADER_BYTES
        while (frame := os.pread(descriptor, _FRAME_HEADER_BYTES, at))[_FRAME_SALTS] == salts:
            written.add(int.from_bytes(frame[_FRAME_PAGE], "big"))
            at += step
        return frozenset(written)
    finally:
        os.close(descriptor)


LOG_MAX_BYTES = 16 * 1024 * 1024
"""From this size of the log on a commit is followed by a sweep."""

_READ_BY_ANOTHER = "Another program reads the database, so its log cannot be cut."


def find_roots(database: sqlite3.Connection) -> list[int]:
    return [row[0] for row in database.execute("SELECT rootpage FROM sqlite_master WHERE rootpage > 0")]


class Sweeper:
    """Sweeps one database file; all calls from the store's one thread."""

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
        try:
            return self._log.stat().st_size
        except FileNotFoundError:
            return 0

    @property
    def is_known_clean(self) -> bool:
        return self._stamp == self._read_stamp()

    def distrust(self) -> None:
        self._stamp = ""

    def begin(self, database: sqlite3.Connection) -> None:
        database.execute("PRAGMA wal_autocheckpoint = 0").fetchall()
        self._version = _read_version(database)

    def sweep(self, database: sqlite3.Connection) -> int:
        """Truncate the log; return bytes overwritten (if any, reopen the connection). Raises STORE_UNAVAILABLE."""
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
        try:
            self._note.write_text(self._stamp)
        except OSError as error:  # the next start walks every page then; what was cleaned must be told all the same
            log.warning("custody_sweep_not_noted", error=str(error))
        return cleaned

    def count_dirty(self, database: sqlite3.Connection) -> int:
        return PageFile(self._descriptor).count_dirty(find_roots(database))

    def _read_stamp(self) -> str:
        found = os.fstat(self._descriptor)
        return f"{found.st_ino} {found.st_size} {found.st_mtime_ns} {found.st_ctime_ns}"


def _checkpoint(database: sqlite3.Connection, mode: str) -> None:
    is_busy, in_log, copied = database.execute(f"PRAGMA wal_checkpoint({mode})").fetchone()
    if is_busy or in_log != copied:
        raise BlockRobotError("STORE_UNAVAILABLE", _READ_BY_ANOTHER)


def _read_version(database: sqlite3.Connection) -> int:
    version: int = database.execute("PRAGMA data_version").fetchone()[0]
    return version

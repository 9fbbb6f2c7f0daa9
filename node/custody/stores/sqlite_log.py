"""Reads which pages an SQLite write-ahead log holds since its last truncation.

Format: https://www.sqlite.org/fileformat2.html#the_write_ahead_log
"""

from __future__ import annotations

import os
from pathlib import Path

_LOG_HEADER_BYTES, _FRAME_HEADER_BYTES = 32, 24
_PAGE_SIZE, _SALTS = slice(8, 12), slice(16, 24)
_FRAME_PAGE, _FRAME_SALTS = slice(0, 4), slice(8, 16)


def read_written_pages(path: Path) -> frozenset[int]:
    """Return page numbers in a log, rolled-back transactions included; empty without log."""
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

"""Looks at the free pages of an SQLite file, byte by byte. Must never write, nor be used while somebody writes the file."""

from __future__ import annotations

import struct
from pathlib import Path

_HEADER_BYTES = 100
_TRUNK = struct.Struct(">II")


def count_dirty_free_bytes(path: Path) -> int:
    """Return how many bytes of a database's free pages are not zero: with `secure_delete`, none.

    A trunk page of the free list holds the numbers of others; only what lies behind them counts. Format:
    https://www.sqlite.org/fileformat2.html#the_freelist
    """
    with path.open("rb") as file:
        header = file.read(_HEADER_BYTES)
        if len(header) < _HEADER_BYTES:
            return 0
        page_bytes = int.from_bytes(header[16:18], "big")
        page_bytes = 65_536 if page_bytes == 1 else page_bytes
        trunk, count = int.from_bytes(header[32:36], "big"), int.from_bytes(header[36:40], "big")
        dirty, seen = 0, 0

        def page(number: int) -> bytes:
            file.seek((number - 1) * page_bytes)
            return file.read(page_bytes)

        while trunk and seen <= count:
            content = page(trunk)
            following, leaves = _TRUNK.unpack_from(content)
            used = _TRUNK.size + 4 * leaves
            dirty += _count_set(content[used:])
            numbers = struct.unpack_from(f">{leaves}I", content, _TRUNK.size)
            dirty += sum(_count_set(page(number)) for number in numbers)
            seen += 1 + leaves
            trunk = following
    return dirty


def _count_set(content: bytes) -> int:
    return len(content) - content.count(0)

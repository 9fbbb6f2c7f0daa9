"""The bytes of an SQLite file that no row holds: on free pages, and in the gaps of tables' pages. Must never touch a row.

`secure_delete` overwrites what is deleted, but not the copies that stay in a page's gap when rows move to another page.
Whoever calls holds the database's write lock, with nothing in its write-ahead log, and keeps the descriptor open for as
long as the database: closing one would give up the locks of the whole process. Format:
https://www.sqlite.org/fileformat2.html
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from itertools import chain

_HEADER_BYTES = 100
_TRUNK = struct.Struct(">II")
_INTERIOR, _LEAVES = (2, 5), (10, 13)


class PageFile:
    """The pages of one database file, by a descriptor of its own."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        header = os.pread(descriptor, _HEADER_BYTES, 0)
        self._is_empty = len(header) < _HEADER_BYTES
        if self._is_empty:
            return
        size = int.from_bytes(header[16:18], "big")
        self._page_bytes = 65_536 if size == 1 else size
        self._usable_bytes = self._page_bytes - header[20]
        self._first_trunk, self._free_count = struct.unpack_from(">II", header, 32)

    def _page(self, number: int) -> bytes:
        return os.pread(self._descriptor, self._page_bytes, (number - 1) * self._page_bytes)

    def count_dirty(self, roots: Sequence[int]) -> int:
        """Return how many bytes that no row holds are not zero. `roots` are the first pages of all tables."""
        if self._is_empty:
            return 0
        gaps = chain(self._gaps(roots), self._trunk_tails())
        return sum(_count_set(content[start:end]) for _, content, start, end in gaps) + self._count_dirty_free()

    def clean(self, roots: Sequence[int]) -> int:
        """Overwrite every gap that is not zero, force it to the medium, and return how many bytes that were."""
        cleaned = 0
        if self._is_empty:
            return cleaned
        for number, content, start, end in chain(self._gaps(roots), self._trunk_tails()):
            dirty = _count_set(content[start:end])
            if dirty:
                os.pwrite(self._descriptor, bytes(end - start), (number - 1) * self._page_bytes + start)
                cleaned += dirty
        if cleaned:
            os.fsync(self._descriptor)
        return cleaned

    def _gaps(self, roots: Sequence[int]) -> Iterator[tuple[int, bytes, int, int]]:
        """Yield (page number, page, start, end) of every stretch within the pages of tables that no row uses."""
        waiting = [1, *roots]
        seen: set[int] = set()
        while waiting:
            number = waiting.pop()
            if number in seen:
                continue
            seen.add(number)
            content = self._page(number)
            at = _HEADER_BYTES if number == 1 else 0
            kind = content[at] if len(content) == self._page_bytes else 0
            if kind not in (*_INTERIOR, *_LEAVES):
                continue
            freeblock, cells, start = struct.unpack_from(">HHH", content, at + 1)
            pointers = at + (12 if kind in _INTERIOR else 8)
            if kind in _INTERIOR:
                places = struct.unpack_from(f">{cells}H", content, pointers)
                waiting += [int.from_bytes(content[place : place + 4], "big") for place in places]
                waiting.append(int.from_bytes(content[at + 8 : at + 12], "big"))
            yield number, content, pointers + 2 * cells, min(start or 65_536, self._usable_bytes)
            while freeblock:
                following, size = struct.unpack_from(">HH", content, freeblock)
                yield number, content, freeblock + 4, freeblock + size
                freeblock = following if following > freeblock else 0

    def _trunks(self) -> Iterator[tuple[int, bytes, int]]:
        """Yield (page number, page, how many numbers) of the pages that list the free ones."""
        seen, trunk = 0, self._first_trunk
        while trunk and seen <= self._free_count:
            content = self._page(trunk)
            following, leaves = _TRUNK.unpack_from(content)
            yield trunk, content, leaves
            seen += 1 + leaves
            trunk = following

    def _trunk_tails(self) -> Iterator[tuple[int, bytes, int, int]]:
        """Yield, as `_gaps`, what lies behind the numbers that count: those of pages that were taken stay there."""
        for number, content, leaves in self._trunks():
            yield number, content, _TRUNK.size + 4 * leaves, len(content)

    def _count_dirty_free(self) -> int:
        """Count on the free pages that are listed."""
        dirty = 0
        for _, content, leaves in self._trunks():
            numbers = struct.unpack_from(f">{leaves}I", content, _TRUNK.size)
            dirty += sum(_count_set(self._page(number)) for number in numbers)
        return dirty


def _count_set(content: bytes) -> int:
    return len(content) - content.count(0)

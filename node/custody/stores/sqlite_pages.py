"""Cleans bytes of an SQLite file that no row holds.

The caller holds the write lock with an empty log and keeps the descriptor open: closing drops the process's locks.
https://www.sqlite.org/fileformat2.html
"""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain

_HEADER_BYTES = 100
_TRUNK = struct.Struct(">II")
_INTERIOR, _LEAVES = (2, 5), (10, 13)
_TOLD_BY_KIND_PAGES_COUNT = 2 << 24
"""In a smaller file a page that holds no rows begins with a page number whose first byte is 0 or 1, and no kind."""


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
        """Return the number of nonzero unused bytes; `roots` are all tables' first pages."""
        if self._is_empty:
            return 0
        return sum(_count_set(content[start:end]) for _, content, start, end in self._unused(roots))

    def clean(self, roots: Sequence[int]) -> int:
        """Zero and sync unused nonzero bytes; return their number."""
        return 0 if self._is_empty else self._overwrite(self._unused(roots))

    @property
    def is_told_by_kind(self) -> bool:
        """Return whether a page's first byte reliably identifies table pages."""
        return self._is_empty or os.fstat(self._descriptor).st_size < _TOLD_BY_KIND_PAGES_COUNT * self._page_bytes

    def clean_written(self, written: Collection[int]) -> int:
        """Zero the gaps of these pages; only while `is_told_by_kind`."""
        if self._is_empty:
            return 0
        gaps = (gap for number in sorted(written) for gap in self._gaps_in(number, self._page(number)))
        return self._overwrite(chain(gaps, self._trunk_tails(written)))

    def _overwrite(self, gaps: Iterable[tuple[int, bytes, int, int]]) -> int:
        cleaned = 0
        for number, content, start, end in gaps:
            dirty = _count_set(content[start:end])
            if dirty:
                os.pwrite(self._descriptor, bytes(end - start), (number - 1) * self._page_bytes + start)
                cleaned += dirty
        if cleaned:
            os.fsync(self._descriptor)
        return cleaned

    def _gaps(self, roots: Sequence[int]) -> Iterator[tuple[int, bytes, int, int]]:
        waiting = [1, *roots]
        seen = bytearray(os.fstat(self._descriptor).st_size // (8 * self._page_bytes) + 1)  # a bit for each page
        while waiting:
            place, bit = divmod(number := waiting.pop(), 8)
            if place >= len(seen) or seen[place] & 1 << bit:
                continue
            seen[place] |= 1 << bit
            content = self._page(number)
            waiting += self._children(number, content)
            yield from self._gaps_in(number, content)

    def _kind(self, number: int, content: bytes) -> tuple[int, int]:
        at = _HEADER_BYTES if number == 1 else 0
        kind = content[at] if len(content) == self._page_bytes else 0
        return at, kind if kind in (*_INTERIOR, *_LEAVES) else 0

    def _children(self, number: int, content: bytes) -> list[int]:
        at, kind = self._kind(number, content)
        if kind not in _INTERIOR:
            return []
        places = struct.unpack_from(f">{int.from_bytes(content[at + 3 : at + 5], 'big')}H", content, at + 12)
        last = int.from_bytes(content[at + 8 : at + 12], "big")
        return [*(int.from_bytes(content[place : place + 4], "big") for place in places), last]

    def _gaps_in(self, number: int, content: bytes) -> Iterator[tuple[int, bytes, int, int]]:
        at, kind = self._kind(number, content)
        if not kind:
            return
        freeblock, cells, start = struct.unpack_from(">HHH", content, at + 1)
        pointers = at + (12 if kind in _INTERIOR else 8)
        yield number, content, pointers + 2 * cells, min(start or 65_536, self._usable_bytes)
        while freeblock:
            following, size = struct.unpack_from(">HH", content, freeblock)
            yield number, content, freeblock + 4, freeblock + size
            freeblock = following if following > freeblock else 0

    def _trunks(self, written: Collection[int] | None = None) -> Iterator[tuple[int, bytes, int]]:
        seen, trunk = 0, self._first_trunk
        while trunk and seen <= self._free_count and (written is None or trunk in written):
            content = self._page(trunk)
            following, leaves = _TRUNK.unpack_from(content)
            yield trunk, content, leaves
            seen += 1 + leaves
            trunk = following

    def _trunk_tails(self, written: Collection[int] | None = None) -> Iterator[tuple[int, bytes, int, int]]:
        for number, content, leaves in self._trunks(written):
            yield number, content, _TRUNK.size + 4 * leaves, len(content)

    def _free_pages(self) -> Iterator[tuple[int, bytes, int, int]]:
        for _, content, leaves in self._trunks():
            for number in struct.unpack_from(f">{leaves}I", content, _TRUNK.size):
                yield number, self._page(number), 0, self._page_bytes

    def _unused(self, roots: Sequence[int]) -> Iterator[tuple[int, bytes, int, int]]:
        return chain(self._gaps(roots), self._trunk_tails(), self._free_pages())


def _count_set(content: bytes) -> int:
    return len(content) - content.count(0)

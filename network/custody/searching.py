"""Finds many short byte strings in large files at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

CHUNK_BYTES = 8 * 1024 * 1024
PREFIX_BYTES = 12
_PAIRS_COUNT = 1 << 16


class Search:
    """A set of byte strings of at least 12 bytes, searched together."""

    def __init__(self, needles: Iterable[bytes]) -> None:
        """Raises ValueError for a needle that is too short."""
        self._by_prefix: dict[bytes, list[bytes]] = {}
        for needle in set(needles):
            if len(needle) < PREFIX_BYTES:
                raise ValueError("a needle has at least twelve bytes")
            self._by_prefix.setdefault(needle[:PREFIX_BYTES], []).append(needle)
        self._overlap = max((len(each) for group in self._by_prefix.values() for each in group), default=1) - 1
        self._pairs = [np.zeros(_PAIRS_COUNT, dtype=bool) for _ in range(PREFIX_BYTES // 2)]
        for prefix in self._by_prefix:
            for place, table in enumerate(self._pairs):
                table[int.from_bytes(prefix[2 * place : 2 * place + 2], "big")] = True

    def in_file(self, path: Path) -> Counter[bytes]:
        """A vanished file holds none. Raises OSError."""
        found: Counter[bytes] = Counter()
        try:
            file = path.open("rb")
        except FileNotFoundError:
            return found
        with file:
            carried = b""
            while piece := file.read(CHUNK_BYTES):
                chunk = carried + piece
                self._count(chunk, len(carried), found)
                carried = chunk[len(chunk) - self._overlap :] if self._overlap else b""
        return found

    def in_bytes(self, content: bytes) -> Counter[bytes]:
        found: Counter[bytes] = Counter()
        self._count(content, 0, found)
        return found

    def _count(self, chunk: bytes, seen_bytes: int, found: Counter[bytes]) -> None:
        if len(chunk) < PREFIX_BYTES or not self._by_prefix:
            return
        content = np.frombuffer(chunk, dtype=np.uint8)
        pairs = (content[:-1].astype(np.uint16) << 8) | content[1:]
        starts = np.flatnonzero(self._pairs[0][pairs[: len(chunk) - PREFIX_BYTES + 1]])
        for place, table in enumerate(self._pairs[1:], start=1):
            starts = starts[table[pairs[starts + 2 * place]]]
        for start in starts.tolist():
            for needle in self._by_prefix.get(chunk[start : start + PREFIX_BYTES], ()):
                if start + len(needle) > seen_bytes and chunk[start : start + len(needle)] == needle:
                    found[needle] += 1


def spread(content: bytes, count: int) -> list[bytes]:
    """Up to `count` distinctive pieces, in order."""
    last = len(content) - PREFIX_BYTES
    if last < 0:
        return []
    places = sorted({last * number // max(1, count - 1) for number in range(count)})
    return [piece for place in places if _tells(piece := content[place : place + PREFIX_BYTES])]


def _tells(piece: Sequence[int]) -> bool:
    """Unlikely by chance: padding is full of equal bytes."""
    return len(set(piece)) > PREFIX_BYTES // 2

"""Cache of scanned state keys, by fully known ranges.

Without it scans would revisit deleted keys of unfinalized blocks, at a cost that differs between nodes.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from itertools import islice

BEYOND_ALL_KEYS = b"\xff" * 256
"""Greater than any flat key: those begin with a contract's name."""

ReadKeys = Callable[[bytes, bytes], Iterator[bytes]]


def prefix_end(prefix: bytes) -> bytes:
    """Return the first key after all that begin with `prefix`."""
    whole = prefix.rstrip(b"\xff")
    return whole[:-1] + bytes([whole[-1] + 1]) if whole else BEYOND_ALL_KEYS


def keys_between(keys: list[bytes], start: bytes, end: bytes) -> range:
    first = bisect_left(keys, start)
    return range(first, bisect_left(keys, end, first))


class KeyCache:
    """Known keys; `read(start, end)` yields keys of unknown ranges in order."""

    __slots__ = ("_ends", "_keys", "_read", "_starts")

    def __init__(self, read: ReadKeys) -> None:
        self._read = read
        self._keys: list[bytes] = []
        # The ranges that are known, in order, apart from each other: from a start up to the end at the same place.
        self._starts: list[bytes] = []
        self._ends: list[bytes] = []

    def first(self, start: bytes, end: bytes, count: int) -> list[bytes]:
        found: list[bytes] = []
        place = start
        while place < end and len(found) < count:
            wanted = count - len(found)
            number = bisect_right(self._starts, place) - 1
            if number >= 0 and place < self._ends[number]:
                known_end = min(end, self._ends[number])
                there = keys_between(self._keys, place, known_end)
                found += self._keys[there.start : min(there.stop, there.start + wanted)]
                place = known_end
                continue
            stop = min(end, self._starts[number + 1]) if number + 1 < len(self._starts) else end
            new = list(islice(self._read(place, stop), wanted))
            read_end = new[-1] + b"\x00" if len(new) == wanted else stop
            at = bisect_left(self._keys, place)
            self._keys[at:at] = new
            self._know(place, read_end)
            found += new
            place = read_end
        return found

    def remove(self, key: bytes) -> None:
        at = bisect_left(self._keys, key)
        if at < len(self._keys) and self._keys[at] == key:
            del self._keys[at]

    def _know(self, start: bytes, end: bytes) -> None:
        number = bisect_left(self._starts, start)
        last = number
        if number and self._ends[number - 1] == start:
            number -= 1
            start = self._starts[number]
        if last < len(self._starts) and self._starts[last] == end:
            end = self._ends[last]
            last += 1
        self._starts[number:last] = [start]
        self._ends[number:last] = [end]

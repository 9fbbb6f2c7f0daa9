"""One call's writes over the block's over the parent state; failed ones are dropped."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable, Iterator
from heapq import merge
from itertools import islice
from typing import cast

from contracts.state.key_cache import KeyCache, keys_between, prefix_end
from contracts.state.view import StateReader


class CallHost:
    """The machine's host for a block's consecutive calls."""

    __slots__ = ("_block", "_block_keys", "_call", "_call_keys", "_parent", "_unwritten")

    def __init__(self, parent: StateReader) -> None:
        self._parent = parent
        self._block: dict[bytes, bytes | None] = {}
        self._call: dict[bytes, bytes | None] = {}
        # Once somebody scans, in order: the keys that the block has put and not deleted, those that the call has put or
        # deleted, and those of the parent that the block has not written.
        self._block_keys: list[bytes] | None = None
        self._call_keys: list[bytes] | None = None
        self._unwritten = KeyCache(self._read_unwritten)

    @property
    def writes(self) -> dict[bytes, bytes | None]:
        """Return successful calls' writes by flat key; None means deleted."""
        return self._block

    def has_written(self, key: bytes) -> bool:
        return key in self._call

    def get_before(self, key: bytes) -> bytes | None:
        return self._parent.get(key)

    def begin(self) -> None:
        self._call = {}
        self._call_keys = None

    def keep(self) -> None:
        if self._block_keys is not None:
            for key, value in self._call.items():
                self._note_kept(self._block_keys, key, is_there=value is not None)
        self._block.update(self._call)
        self.begin()

    def _note_kept(self, block_keys: list[bytes], key: bytes, *, is_there: bool) -> None:
        if key not in self._block:
            self._unwritten.remove(key)
        was_there = self._block.get(key) is not None
        if is_there and not was_there:
            insort(block_keys, key)
        elif was_there and not is_there:
            del block_keys[bisect_left(block_keys, key)]

    def get(self, key: bytes) -> bytes | None:
        if key in self._call:
            return self._call[key]
        if key in self._block:
            return self._block[key]
        return self._parent.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        if self._call_keys is not None and key not in self._call:
            insort(self._call_keys, key)
        self._call[key] = value

    def delete(self, key: bytes) -> None:
        if self._call_keys is not None and key not in self._call:
            insort(self._call_keys, key)
        self._call[key] = None

    def emit(self, name: str, data: bytes) -> None:
        """Events come with the call's outcome, which alone decides whether they count."""

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        if self._block_keys is None:
            self._block_keys = sorted(key for key, value in self._block.items() if value is not None)
        if self._call_keys is None:
            self._call_keys = sorted(self._call)
        end = prefix_end(prefix)
        touched = keys_between(self._call_keys, prefix, end)
        of_block = keys_between(self._block_keys, prefix, end)
        keys: Iterable[bytes] = self._unwritten.first(prefix, end, limit + len(touched))
        if of_block:
            keys = merge(keys, _at(self._block_keys, of_block))
        if touched:
            of_call = (key for key in _at(self._call_keys, touched) if self._call[key] is not None)
            keys = merge((key for key in keys if key not in self._call), of_call)
        return [(key, cast(bytes, self.get(key))) for key in islice(keys, limit)]

    def _read_unwritten(self, start: bytes, end: bytes) -> Iterator[bytes]:
        return (key for key, _ in self._parent.scan_range(start, end) if key not in self._block)


def _at(keys: list[bytes], places: range) -> Iterator[bytes]:
    return islice(keys, places.start, places.stop)

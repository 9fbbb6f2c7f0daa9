"""What one call reads and writes: its own writes over the block's over the parent state. Must never write through.

A failed call's writes are dropped; those of one that succeeded join the block's. Nothing reaches the parent.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterator
from heapq import merge
from itertools import islice

from contracts.state.view import StateReader


class CallHost:
    """The machine's host for the calls of one block, one after another."""

    __slots__ = ("_block", "_block_keys", "_call", "_call_keys", "_parent")

    def __init__(self, parent: StateReader) -> None:
        self._parent = parent
        self._block: dict[bytes, bytes | None] = {}
        self._call: dict[bytes, bytes | None] = {}
        # The keys of both in order, once somebody scans.
        self._block_keys: list[bytes] | None = None
        self._call_keys: list[bytes] | None = None

    @property
    def writes(self) -> dict[bytes, bytes | None]:
        """What the calls that succeeded wrote: flat key -> encoded value, None where they deleted."""
        return self._block

    def begin(self) -> None:
        """Start a call, forgetting whatever one before left undecided."""
        self._call = {}
        self._call_keys = None

    def keep(self) -> None:
        """Take the call's writes over into the block."""
        if self._block_keys is not None:
            for key in self._call:
                if key not in self._block:
                    insort(self._block_keys, key)
        self._block.update(self._call)
        self.begin()

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        if key in self._call:
            return self._call[key]
        if key in self._block:
            return self._block[key]
        return self._parent.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        """Store an encoded value."""
        if self._call_keys is not None and key not in self._call:
            insort(self._call_keys, key)
        self._call[key] = value

    def delete(self, key: bytes) -> None:
        """Remove a key."""
        if self._call_keys is not None and key not in self._call:
            insort(self._call_keys, key)
        self._call[key] = None

    def emit(self, name: str, data: bytes) -> None:
        """Do nothing: events come with the call's outcome, which alone decides whether they count."""

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        """Return at most `limit` pairs under the prefix, in key order, as the call sees them."""
        if not self._call and not self._block:
            return list(self._parent.scan(prefix, limit))
        own, own_count = self._own(prefix)
        if not own_count:
            return list(self._parent.scan(prefix, limit))
        below = ((key, value) for key, value in self._parent.scan(prefix, limit + own_count) if not self._writes(key))
        return list(islice(merge(below, own), limit))

    def _writes(self, key: bytes) -> bool:
        return key in self._call or key in self._block

    def _own(self, prefix: bytes) -> tuple[Iterator[tuple[bytes, bytes]], int]:
        """Return what was written under a prefix and not deleted, in order, and how many keys were touched there."""
        if self._block_keys is None:
            self._block_keys = sorted(self._block)
        if self._call_keys is None:
            self._call_keys = sorted(self._call)
        call, block = _under(self._call_keys, prefix), _under(self._block_keys, prefix)
        of_call = ((key, self._call[key]) for key in islice(self._call_keys, call.start, call.stop))
        of_block = (
            (key, self._block[key])
            for key in islice(self._block_keys, block.start, block.stop)
            if key not in self._call
        )
        pairs = ((key, value) for key, value in merge(of_call, of_block) if value is not None)
        return pairs, len(call) + len(block)


def _under(keys: list[bytes], prefix: bytes) -> range:
    """Return the places of the keys that begin with `prefix` in a list of keys in order."""
    first = bisect_left(keys, prefix)
    beyond = prefix.rstrip(b"\xff")
    if not beyond:
        return range(first, len(keys))
    return range(first, bisect_left(keys, beyond[:-1] + bytes([beyond[-1] + 1]), first))

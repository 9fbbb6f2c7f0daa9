"""What one call reads and writes: its own writes over the block's over the parent state. Must never write through.

A failed call's writes are dropped; those of one that succeeded join the block's. Nothing reaches the parent.
"""

from __future__ import annotations

from collections.abc import Iterator

from contracts.state.view import StateReader


class CallHost:
    """The machine's host for the calls of one block, one after another."""

    __slots__ = ("_block", "_call", "_parent")

    def __init__(self, parent: StateReader) -> None:
        self._parent = parent
        self._block: dict[bytes, bytes | None] = {}
        self._call: dict[bytes, bytes | None] = {}

    @property
    def writes(self) -> dict[bytes, bytes | None]:
        """What the calls that succeeded wrote: flat key -> encoded value, None where they deleted."""
        return self._block

    def begin(self) -> None:
        """Start a call, forgetting whatever one before left undecided."""
        self._call = {}

    def keep(self) -> None:
        """Take the call's writes over into the block."""
        self._block.update(self._call)
        self._call = {}

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        if key in self._call:
            return self._call[key]
        if key in self._block:
            return self._block[key]
        return self._parent.get(key)

    def put(self, key: bytes, value: bytes) -> None:
        """Store an encoded value."""
        self._call[key] = value

    def delete(self, key: bytes) -> None:
        """Remove a key."""
        self._call[key] = None

    def emit(self, name: str, data: bytes) -> None:
        """Do nothing: events come with the call's outcome, which alone decides whether they count."""

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        """Return at most `limit` pairs under the prefix, in key order, as the call sees them."""
        own = {key: value for key, value in self._block.items() if key.startswith(prefix)}
        own.update((key, value) for key, value in self._call.items() if key.startswith(prefix))
        if not own:
            return list(self._parent.scan(prefix, limit))
        found = {key: value for key, value in self._below(prefix, limit + len(own)) if key not in own}
        found.update((key, value) for key, value in own.items() if value is not None)
        return sorted(found.items())[:limit]

    def _below(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return self._parent.scan(prefix, limit)

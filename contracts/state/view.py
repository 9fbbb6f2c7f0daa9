"""How state is read: Protocols, overlays of unfinalized blocks, a state in memory.

An `Overlay` holds what one block wrote, on top of its parent's view; overlays chain down to the finalized state. When
a block is finalized its children are rebased onto the store, which then says the same as the overlay did.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Protocol

from consensus.primitives.trie import EMPTY_ROOT, Proof
from contracts.state.key_cache import keys_between, prefix_end
from contracts.state.trie import PageReader, TrieUpdate, apply_batch, prove


class StateReader(Protocol):
    """The flat table of one version of the state."""

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs of flat key and encoded value under the prefix, in key order."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield the pairs of flat key and encoded value from `start` up to but without `end`, in key order.

        Reads nothing beyond the pair that is asked for next.
        """
        ...


class StateView(StateReader, PageReader, Protocol):
    """One version of the state, with its trie: what a block is executed on."""

    @property
    def state_root(self) -> bytes:
        """The 32-byte root of this version."""
        ...


class Overlay:
    """The state after an unfinalized block: its writes over its parent's view. The mappings must not change any more."""

    __slots__ = ("_page_writes", "_parent", "_sorted_keys", "_state_root", "_writes")

    def __init__(
        self,
        parent: StateView,
        writes: Mapping[bytes, bytes | None],
        page_writes: Mapping[bytes, bytes | None],
        state_root: bytes,
    ) -> None:
        self._parent = parent
        self._writes = writes
        self._page_writes = page_writes
        self._state_root = state_root
        self._sorted_keys: list[bytes] | None = None

    @classmethod
    def apply(cls, parent: StateView, writes: Mapping[bytes, bytes | None]) -> Overlay:
        """Return the overlay of these writes on the parent, with its trie pages and root computed."""
        update = apply_batch(parent, parent.state_root, writes)
        return cls(parent, writes, update.pages, update.root)

    @property
    def writes(self) -> Mapping[bytes, bytes | None]:
        """What the block wrote: flat key -> encoded value, or None where it deleted."""
        return self._writes

    @property
    def page_writes(self) -> Mapping[bytes, bytes | None]:
        """The trie pages that the block changed, by nibble path."""
        return self._page_writes

    @property
    def state_root(self) -> bytes:
        """The 32-byte root after this block."""
        return self._state_root

    def rebase(self, parent: StateView) -> None:
        """Stand on another view that says the same as the old parent (the store, once the parent is finalized).

        Raises ValueError if the new parent has another root.
        """
        if parent.state_root != self._parent.state_root:
            raise ValueError("an overlay can be rebased only onto a view of its parent's state")
        self._parent = parent

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        if key in self._writes:
            return self._writes[key]
        return self._parent.get(key)

    def page(self, path: bytes) -> bytes | None:
        """Return the trie page under a nibble path, or None."""
        if path in self._page_writes:
            return self._page_writes[path]
        return self._parent.page(path)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs under the prefix, in key order: the block's writes merged into the parent's."""
        return islice(self.scan_range(prefix, prefix_end(prefix)), limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield the pairs from `start` up to but without `end`, in key order."""
        return ((key, value) for key, value in self._walk(start, end) if value is not None)

    def _walk(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes | None]]:
        """Yield every key that this block or one before it wrote, or that stands below (None: it is deleted), in order.

        What is deleted is told too, so that no overlay passes deleted keys beyond the one that is asked for next.
        """
        if self._sorted_keys is None:
            self._sorted_keys = sorted(self._writes)
        parent, writes = self._parent, self._writes
        own = keys_between(self._sorted_keys, start, end)
        mine = islice(self._sorted_keys, own.start, own.stop)
        head = next(mine, None)
        below: Iterator[tuple[bytes, bytes | None]]
        below = parent._walk(start, end) if isinstance(parent, Overlay) else parent.scan_range(start, end)
        for key, value in below:
            while head is not None and head < key:
                yield head, writes[head]
                head = next(mine, None)
            if head == key:
                yield key, writes[key]
                head = next(mine, None)
            else:
                yield key, value
        while head is not None:
            yield head, writes[head]
            head = next(mine, None)

    def prove(self, key: bytes) -> Proof:
        """Return the proof of a flat key's presence or absence under `state_root`."""
        return prove(self, self._state_root, key)


class MemoryState:
    """A whole state in two dicts: for tests, the author's kit and the building of genesis."""

    def __init__(self) -> None:
        self._values: dict[bytes, bytes] = {}
        self._pages: dict[bytes, bytes] = {}
        self._state_root = EMPTY_ROOT
        self._sorted_keys: list[bytes] | None = []

    @property
    def state_root(self) -> bytes:
        """The 32-byte root of the present content."""
        return self._state_root

    @property
    def pages(self) -> Mapping[bytes, bytes]:
        """All trie pages by nibble path."""
        return self._pages

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        return self._values.get(key)

    def page(self, path: bytes) -> bytes | None:
        """Return the trie page under a nibble path, or None."""
        return self._pages.get(path)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs under the prefix, in key order."""
        return islice(self.scan_range(prefix, prefix_end(prefix)), limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield the pairs from `start` up to but without `end`, in key order."""
        if self._sorted_keys is None:
            self._sorted_keys = sorted(self._values)
        there = keys_between(self._sorted_keys, start, end)
        for key in islice(self._sorted_keys, there.start, there.stop):
            yield key, self._values[key]

    def apply(self, writes: Mapping[bytes, bytes | None]) -> TrieUpdate:
        """Apply writes to the content and the trie; return what changed in the trie."""
        update = apply_batch(self, self._state_root, writes)
        self.absorb(writes, update.pages, update.root)
        return update

    def absorb(
        self, writes: Mapping[bytes, bytes | None], page_writes: Mapping[bytes, bytes | None], state_root: bytes
    ) -> None:
        """Take over the writes and pages of a block that was executed elsewhere, as finalizing it does."""
        _absorb(self._values, writes)
        _absorb(self._pages, page_writes)
        self._state_root = state_root
        self._sorted_keys = None

    def prove(self, key: bytes) -> Proof:
        """Return the proof of a flat key's presence or absence under `state_root`."""
        return prove(self, self._state_root, key)

    def copy(self) -> MemoryState:
        """Return an independent state with the same content."""
        other = MemoryState()
        other._values, other._pages = self._values.copy(), self._pages.copy()
        other._state_root, other._sorted_keys = self._state_root, self._sorted_keys
        return other


def _absorb(table: dict[bytes, bytes], writes: Mapping[bytes, bytes | None]) -> None:
    for key, value in writes.items():
        if value is None:
            table.pop(key, None)
        else:
            table[key] = value

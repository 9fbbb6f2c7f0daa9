"""Reading state: Protocols, overlays of unfinalized blocks, state in memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Protocol

from consensus.primitives.trie import EMPTY_ROOT, Proof
from contracts.state.key_cache import keys_between, prefix_end
from contracts.state.trie import PageReader, TrieUpdate, apply_batch, prove


class StateReader(Protocol):
    """The flat table of one state version."""

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Up to `limit` (flat key, encoded value) pairs, in key order."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield pairs in [start, end) in key order, lazily, one at a time."""
        ...


class StateView(StateReader, PageReader, Protocol):
    """One state version with its trie, on which blocks execute."""

    @property
    def state_root(self) -> bytes: ...


class Overlay:
    """A block's writes over its parent's view; its mappings are frozen."""

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
        update = apply_batch(parent, parent.state_root, writes)
        return cls(parent, writes, update.pages, update.root)

    @property
    def writes(self) -> Mapping[bytes, bytes | None]:
        """Encoded values by flat key, None for deletion."""
        return self._writes

    @property
    def page_writes(self) -> Mapping[bytes, bytes | None]:
        return self._page_writes

    @property
    def state_root(self) -> bytes:
        return self._state_root

    def rebase(self, parent: StateView) -> None:
        """Switch to an equal parent view. Raises ValueError if its root differs."""
        if parent.state_root != self._parent.state_root:
            raise ValueError("an overlay can be rebased only onto a view of its parent's state")
        self._parent = parent

    def get(self, key: bytes) -> bytes | None:
        if key in self._writes:
            return self._writes[key]
        return self._parent.get(key)

    def page(self, path: bytes) -> bytes | None:
        if path in self._page_writes:
            return self._page_writes[path]
        return self._parent.page(path)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return islice(self.scan_range(prefix, prefix_end(prefix)), limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        return ((key, value) for key, value in self._walk(start, end) if value is not None)

    def _walk(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes | None]]:
        """Deleted keys are included (None): no overlay reads past the next requested key."""
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
        return prove(self, self._state_root, key)


class MemoryState:
    """A whole state in memory, for tests, author's kit and genesis."""

    def __init__(self) -> None:
        self._values: dict[bytes, bytes] = {}
        self._pages: dict[bytes, bytes] = {}
        self._state_root = EMPTY_ROOT
        self._sorted_keys: list[bytes] | None = []

    @property
    def state_root(self) -> bytes:
        return self._state_root

    @property
    def pages(self) -> Mapping[bytes, bytes]:
        return self._pages

    def get(self, key: bytes) -> bytes | None:
        return self._values.get(key)

    def page(self, path: bytes) -> bytes | None:
        return self._pages.get(path)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return islice(self.scan_range(prefix, prefix_end(prefix)), limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        if self._sorted_keys is None:
            self._sorted_keys = sorted(self._values)
        there = keys_between(self._sorted_keys, start, end)
        for key in islice(self._sorted_keys, there.start, there.stop):
            yield key, self._values[key]

    def apply(self, writes: Mapping[bytes, bytes | None]) -> TrieUpdate:
        update = apply_batch(self, self._state_root, writes)
        self.absorb(writes, update.pages, update.root)
        return update

    def absorb(
        self, writes: Mapping[bytes, bytes | None], page_writes: Mapping[bytes, bytes | None], state_root: bytes
    ) -> None:
        _absorb(self._values, writes)
        _absorb(self._pages, page_writes)
        self._state_root = state_root
        self._sorted_keys = None

    def prove(self, key: bytes) -> Proof:
        return prove(self, self._state_root, key)

    def copy(self) -> MemoryState:
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

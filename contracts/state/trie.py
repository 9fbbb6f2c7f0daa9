"""Writer of the state trie: one batch per block, and proofs.

Pages are keyed by nibble path (lower-case ASCII hex; the root's is empty), so finalizing overwrites in place.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256
from consensus.primitives.trie import (
    EMPTY_PAGE,
    EMPTY_ROOT,
    LEAF_SIZE_BYTES,
    PAGE_HEADER_BYTES,
    Proof,
    hash_page,
    hash_value,
    nibble_at,
    read_slot,
)

_HEX_DIGITS = tuple(b"%x" % nibble for nibble in range(16))
_NO_PAGE = PAGE_HEADER_BYTES
_ONE_LEAF = PAGE_HEADER_BYTES + LEAF_SIZE_BYTES

_Item = tuple[bytes, bytes | None]
"""A path (32 bytes) and the hash of its new value, or None to delete it."""


class PageReader(Protocol):
    """The pages of one trie version."""

    def page(self, path: bytes) -> bytes | None:
        """Return the page at a nibble path (ASCII hex), or None."""
        ...


@dataclass(frozen=True, slots=True)
class TrieUpdate:
    """A batch's result: new root, and pages to write by nibble path (None deletes)."""

    root: bytes
    pages: dict[bytes, bytes | None]


class EmptyPages:
    """The pages of a trie without keys."""

    def page(self, path: bytes) -> bytes | None:  # noqa: ARG002
        return None


_OWN_PAGES_MAX_COUNT = 8192
_own_pages: dict[bytes, bytes] = {}
"""Hash -> page, of pages that were made and hashed in this process. The very same object needs no second hashing."""


def _hash_own_page(page: bytes) -> bytes:
    digest = hash_page(page)
    if len(_own_pages) >= _OWN_PAGES_MAX_COUNT:
        _own_pages.clear()
    _own_pages[digest] = page
    return digest


def _load_page(pages: PageReader, path: bytes, expected: bytes) -> bytes:
    page = pages.page(path)
    if page is None or (_own_pages.get(expected) is not page and hash_page(page) != expected):
        what = "is missing" if page is None else "is not the one that is referred to"
        raise BlockRobotError("STORAGE_DAMAGED", f"The state's page at path '{path.decode()}' {what}.")
    return page


class _Batch:
    """One batch in progress."""

    def __init__(self, pages: PageReader) -> None:
        self._pages = pages
        self.written: dict[bytes, bytes | None] = {}

    def update(self, path: bytes, depth: int, slot: bytes | None, items: list[_Item]) -> bytes | None:
        if slot is None or len(slot) == LEAF_SIZE_BYTES:
            live = [item for item in items if item[1] is not None]
            if slot is not None and all(item[0] != slot[:HASH_SIZE_BYTES] for item in items):
                live.append((slot[:HASH_SIZE_BYTES], slot[HASH_SIZE_BYTES:]))
                live.sort()
            if not live:
                return None
            if len(live) == 1 and depth:
                return live[0][0] + (live[0][1] or b"")
            return self._patch(path, depth, EMPTY_PAGE, live, None)
        return self._patch(path, depth, _load_page(self._pages, path, slot), items, slot)

    def _patch(self, path: bytes, depth: int, page: bytes, items: list[_Item], before: bytes | None) -> bytes | None:
        leaves, branches = page[0] << 8 | page[1], page[2] << 8 | page[3]
        body = page[PAGE_HEADER_BYTES:]
        odd, index = depth & 1, depth >> 1
        position, count = 0, len(items)
        while position < count:
            byte = items[position][0][index]
            nibble = byte & 0x0F if odd else byte >> 4
            end = position + 1
            while end < count:
                byte = items[end][0][index]
                if (byte & 0x0F if odd else byte >> 4) != nibble:
                    break
                end += 1
            bit = 1 << nibble
            start = HASH_SIZE_BYTES * (2 * (leaves & bit - 1).bit_count() + (branches & bit - 1).bit_count())
            stop = start + (LEAF_SIZE_BYTES if leaves & bit else HASH_SIZE_BYTES if branches & bit else 0)
            old = body[start:stop] or None
            group = items[position:end]
            if old is None and end == position + 1:
                value = group[0][1]
                new = None if value is None else group[0][0] + value
            else:
                new = self.update(path + _HEX_DIGITS[nibble], depth + 1, old, group)
            position = end
            if new == old:
                continue
            body = body[:start] + (new or b"") + body[stop:]
            leaves &= ~bit
            branches &= ~bit
            if new is not None:
                if len(new) == LEAF_SIZE_BYTES:
                    leaves |= bit
                else:
                    branches |= bit
        return self._close(path, page, (leaves << 16 | branches).to_bytes(4, "big") + body, before)

    def _close(self, path: bytes, old: bytes, page: bytes, before: bytes | None) -> bytes | None:
        if before is not None and page == old:
            return before
        size = len(page)
        if size == _NO_PAGE or (size == _ONE_LEAF and path and (page[0] or page[1])):
            if before is not None:
                self.written[path] = None
            return None if size == _NO_PAGE else page[PAGE_HEADER_BYTES:]
        self.written[path] = page
        return _hash_own_page(page)


def apply_batch(pages: PageReader, root: bytes, writes: Mapping[bytes, bytes | None]) -> TrieUpdate:
    """Apply writes (flat key -> value, None deletes) to the trie with this root.

    Writes without effect give an empty result. Raises STORAGE_DAMAGED if a page is missing or does not match its
    parent.
    """
    items: list[_Item] = [(sha256(key), None if value is None else hash_value(value)) for key, value in writes.items()]
    if not items:
        return TrieUpdate(root, {})
    items.sort()
    batch = _Batch(pages)
    slot = batch.update(b"", 0, None if root == EMPTY_ROOT else root, items)
    return TrieUpdate(EMPTY_ROOT if slot is None else slot, batch.written)


def prove(pages: PageReader, root: bytes, key: bytes) -> Proof:
    """Raises STORAGE_DAMAGED."""
    if root == EMPTY_ROOT:
        return Proof((EMPTY_PAGE,))
    digest = sha256(key)
    path = digest.hex().encode()
    found: list[bytes] = []
    slot: bytes | None = root
    while slot is not None and len(slot) == HASH_SIZE_BYTES:
        depth = len(found)
        page = _load_page(pages, path[:depth], slot)
        found.append(page)
        slot = read_slot(page, nibble_at(digest, depth))
    return Proof(tuple(found))


def compute_root(content: Iterable[tuple[bytes, bytes]]) -> bytes:
    return apply_batch(EmptyPages(), EMPTY_ROOT, dict(content)).root

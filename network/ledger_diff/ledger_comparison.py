"""Compares two nodes' ledgers: first differing block, then differing state keys.

Headers, bodies and receipts, tries, then flat tables row by row, which finds values that the trie contradicts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol

from consensus.chain.block import Block, Header
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256
from consensus.primitives.trie import (
    EMPTY_ROOT,
    LEAF_SIZE_BYTES,
    hash_page,
    hash_value,
    is_page,
    read_slot,
    verify_proof,
)
from contracts.state.trie import prove
from contracts.state.view import StateView
from node.snapshot.making import STATE_ROWS_MAX_COUNT, read_header_bytes
from node.storage.ledger_store import LedgerSnapshot

KEYS_LISTED_MAX_COUNT = 1_000

DifferenceKind = Literal["none", "header", "body", "receipts", "state"]


@dataclass(frozen=True, slots=True)
class KeyDifference:
    """A flat key and both values (None: absent).

    `agrees`: whether each value is proved by the header's state root.
    """

    key: bytes
    values: tuple[bytes | None, bytes | None]
    agrees: tuple[bool, bool] = (False, False)


@dataclass(slots=True)
class Comparison:
    """A comparison's result; `height` of the first differing block or compared state."""

    kind: DifferenceKind
    height: int
    headers: tuple[bytes | None, bytes | None] = (None, None)
    keys: list[KeyDifference] = field(default_factory=list)
    is_cut: bool = False
    damaged_pages: list[str] = field(default_factory=list)
    headers_from: int = 0
    bodies_from: int = 0

    @property
    def is_same(self) -> bool:
        return self.kind == "none"


class Pages(Protocol):
    """One version of a trie."""

    def page(self, path: bytes) -> bytes | None:
        """None if there is none."""
        ...


def newest_height(ledger: LedgerSnapshot) -> int:
    """Raises STORAGE_DAMAGED if there is no block."""
    if ledger.position is None:
        raise BlockRobotError("STORAGE_DAMAGED", "The ledger holds no block.")
    return ledger.position.height


# Blocks


def lowest_common_header(first: LedgerSnapshot, second: LedgerSnapshot, top: int) -> int:
    """Return the lowest height from which both have all headers to `top` (bisection)."""
    low, high = 0, top
    while low < high:
        middle = (low + high) // 2
        if read_header_bytes(first, middle) is None or read_header_bytes(second, middle) is None:
            low = middle + 1
        else:
            high = middle
    return low


def first_other_header(first: LedgerSnapshot, second: LedgerSnapshot, low: int, top: int) -> int | None:
    """Return the lowest height in `low` to `top` with different headers, or None."""
    if read_header_bytes(first, top) == read_header_bytes(second, top):
        return None
    high = top
    while low < high:
        middle = (low + high) // 2
        if read_header_bytes(first, middle) == read_header_bytes(second, middle):
            low = middle + 1
        else:
            high = middle
    return high


def compare_blocks(first: LedgerSnapshot, second: LedgerSnapshot) -> Comparison:
    top = min(newest_height(first), newest_height(second))
    low = lowest_common_header(first, second, top)
    bodies_from = max(first.earliest_height, second.earliest_height)
    other = first_other_header(first, second, low, top)
    if other is not None:
        headers = read_header_bytes(first, other), read_header_bytes(second, other)
        return Comparison("header", other, headers, headers_from=low, bodies_from=bodies_from)
    for height in range(bodies_from, top + 1):
        kind: DifferenceKind | None = None
        if first.block(height) != second.block(height):
            kind = "body"
        elif first.receipts(height) != second.receipts(height):
            kind = "receipts"
        if kind is not None:
            headers = read_header_bytes(first, height), read_header_bytes(second, height)
            return Comparison(kind, height, headers, headers_from=low, bodies_from=bodies_from)
    return Comparison("none", top, headers_from=low, bodies_from=bodies_from)


# State

_Slot = bytes | None
_Leaf = tuple[bytes, bytes | None, bytes | None]


class _Walk:
    """Descends two tries where they differ."""

    def __init__(self, first: Pages, second: Pages) -> None:
        self._sides = (first, second)
        self.damaged: list[str] = []

    def leaves(self, path: bytes, slots: tuple[_Slot, _Slot]) -> Iterator[_Leaf]:
        if slots[0] == slots[1]:
            return
        branches = [slot is not None and len(slot) == HASH_SIZE_BYTES for slot in slots]
        if not any(branches):
            yield from _different(dict(_leaf(slots[0])), dict(_leaf(slots[1])))
        elif all(branches):
            pages = [self.load(side, path, slot or b"") for side, slot in enumerate(slots)]
            for nibble in range(16):
                below = (_slot_of(pages[0], nibble), _slot_of(pages[1], nibble))
                yield from self.leaves(path + b"%x" % nibble, below)
        else:
            content = [dict(self._all(side, path, slot)) for side, slot in enumerate(slots)]
            yield from _different(content[0], content[1])

    def _all(self, side: int, path: bytes, slot: _Slot) -> Iterator[tuple[bytes, bytes]]:
        if slot is None or len(slot) == LEAF_SIZE_BYTES:
            yield from _leaf(slot)
            return
        page = self.load(side, path, slot)
        for nibble in range(16):
            yield from self._all(side, path + b"%x" % nibble, _slot_of(page, nibble))

    def load(self, side: int, path: bytes, expected: bytes) -> bytes | None:
        page = self._sides[side].page(path)
        if page is None or not is_page(page) or hash_page(page) != expected:
            self.damaged.append(f"{'AB'[side]}:{path.decode() or 'root'}")
        return page if page is not None and is_page(page) else None


def damaged_pages(view: StateView, side: int) -> Iterator[str]:
    walk = _Walk(view, view)
    waiting: list[tuple[bytes, bytes]] = [] if view.state_root == EMPTY_ROOT else [(b"", view.state_root)]
    while waiting:
        path, expected = waiting.pop()
        page = walk.load(side, path, expected)
        slots = [(path + b"%x" % nibble, _slot_of(page, nibble)) for nibble in range(16)]
        waiting += [(place, slot) for place, slot in slots if slot is not None and len(slot) == HASH_SIZE_BYTES]
    yield from walk.damaged


def _slot_of(page: bytes | None, nibble: int) -> _Slot:
    return None if page is None else read_slot(page, nibble)


def _leaf(slot: _Slot) -> Iterator[tuple[bytes, bytes]]:
    if slot is not None:
        yield slot[:HASH_SIZE_BYTES], slot[HASH_SIZE_BYTES:]


def _different(first: dict[bytes, bytes], second: dict[bytes, bytes]) -> Iterator[_Leaf]:
    for path in sorted(first.keys() | second.keys()):
        if first.get(path) != second.get(path):
            yield path, first.get(path), second.get(path)


def _root_slot(root: bytes) -> _Slot:
    return None if root == EMPTY_ROOT else root


def differing_paths(first: StateView, second: StateView, damaged: list[str]) -> Iterator[bytes]:
    """As SHA-256 of keys; note damaged pages."""
    walk = _Walk(first, second)
    for path, _, _ in walk.leaves(b"", (_root_slot(first.state_root), _root_slot(second.state_root))):
        yield path
    damaged += [place for place in walk.damaged if place not in damaged]


def differing_rows(first: StateView, second: StateView) -> Iterator[tuple[bytes, bytes | None, bytes | None]]:
    """As (flat key, both values), in key order."""
    sides = [iter(view.scan(b"", STATE_ROWS_MAX_COUNT)) for view in (first, second)]
    heads = [next(side, None) for side in sides]
    while heads[0] is not None or heads[1] is not None:
        key = min(row[0] for row in heads if row is not None)
        values = [row[1] if row is not None and row[0] == key else None for row in heads]
        if values[0] != values[1]:
            yield key, values[0], values[1]
        heads = [
            next(side, None) if row is not None and row[0] == key else row
            for side, row in zip(sides, heads, strict=True)
        ]


def _agrees(view: StateView, root: bytes, key: bytes, value: bytes | None) -> bool:
    try:
        verify_proof(root, key, value, prove(view, root, key))
    except BlockRobotError:
        return False
    return True


def compare_states(first: StateView, second: StateView, header: Header, *, full: bool = False) -> Comparison:
    """Compare two states after `header`: tries, then flat tables. `full` reads all pages."""
    found = Comparison("none", header.height)
    if full:
        found.damaged_pages += [*damaged_pages(first, 0), *damaged_pages(second, 1)]
    wanted = set()
    for path in differing_paths(first, second, found.damaged_pages):
        wanted.add(path)
        if len(wanted) >= KEYS_LISTED_MAX_COUNT:
            found.is_cut = True
            break
    rows: dict[bytes, tuple[bytes | None, bytes | None]] = {}
    for key, one, other in differing_rows(first, second):
        if len(rows) >= KEYS_LISTED_MAX_COUNT:
            found.is_cut = True
            break
        rows[key] = (one, other)
    if wanted - {sha256(key) for key in rows}:
        rows |= {key: (value, value) for key, value in _rows_at(first, wanted) if key not in rows}
    for key, (one, other) in sorted(rows.items()):
        proven = next((view for view in (first, second) if _proves(view, header.state_root, key)), None)
        agrees = (False, False)
        if proven is not None:
            agrees = (
                _agrees(proven, header.state_root, key, one) and _trie_value(first, key) == _hash_of(one),
                _agrees(proven, header.state_root, key, other) and _trie_value(second, key) == _hash_of(other),
            )
        found.keys.append(KeyDifference(key, (one, other), agrees))
    if found.keys or found.damaged_pages or found.is_cut:
        found.kind = "state"
    return found


def _rows_at(view: StateView, paths: set[bytes]) -> Iterator[tuple[bytes, bytes]]:
    for key, value in view.scan(b"", STATE_ROWS_MAX_COUNT):
        if sha256(key) in paths:
            yield key, value


def _hash_of(value: bytes | None) -> bytes | None:
    return None if value is None else hash_value(value)


def _proves(view: StateView, root: bytes, key: bytes) -> bool:
    try:
        prove(view, root, key)
    except BlockRobotError:
        return False
    return True


def _trie_value(view: StateView, key: bytes) -> bytes | None:
    path = sha256(key)
    slot = _root_slot(view.state_root)
    digits = path.hex().encode()
    for depth in range(len(digits)):
        if slot is None or len(slot) == LEAF_SIZE_BYTES:
            break
        page = view.page(digits[:depth])
        if page is None or not is_page(page):
            return None
        slot = read_slot(page, int(digits[depth : depth + 1], 16))
    return slot[HASH_SIZE_BYTES:] if slot is not None and slot[:HASH_SIZE_BYTES] == path else None


def read_block(ledgers: tuple[LedgerSnapshot, ...], height: int) -> Block | None:
    for ledger in ledgers:
        data = ledger.block(height)
        if data is not None:
            return decode(data, Block)
    return None

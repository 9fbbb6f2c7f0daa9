"""Verifying state proofs from pages built by hand: the verifier must not need the writer to be right."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from consensus.primitives.trie import (
    EMPTY_PAGE,
    EMPTY_ROOT,
    Proof,
    hash_page,
    hash_value,
    is_page,
    nibble_at,
    read_slot,
    verify_proof,
)


def page_of(*slots: tuple[int, bytes]) -> bytes:
    """Build a page from (nibble, leaf or hash), as the format says and not as the writer does it."""
    leaves = sum(1 << nibble for nibble, slot in slots if len(slot) == 64)
    branches = sum(1 << nibble for nibble, slot in slots if len(slot) == 32)
    body = b"".join(slot for _, slot in sorted(slots))
    return leaves.to_bytes(2, "big") + branches.to_bytes(2, "big") + body


def leaf_of(key: bytes, value: bytes) -> bytes:
    return sha256(key) + hash_value(value)


def keys_below(*nibbles: int, count: int) -> list[bytes]:
    """Return keys whose paths start with these nibbles."""
    found = []
    number = 0
    while len(found) < count:
        key = b"key-%d" % number
        if all(nibble_at(sha256(key), depth) == nibble for depth, nibble in enumerate(nibbles)):
            found.append(key)
        number += 1
    return found


def split(*nibbles: int) -> tuple[bytes, bytes]:
    """Return two keys that share exactly these leading nibbles."""
    candidates = keys_below(*nibbles, count=40)
    first = candidates[0]
    depth = len(nibbles)
    second = next(key for key in candidates if nibble_at(sha256(key), depth) != nibble_at(sha256(first), depth))
    return first, second


def refused(root: bytes, key: bytes, value: bytes | None, proof: Proof) -> bool:
    with pytest.raises(BlockRobotError) as caught:
        verify_proof(root, key, value, proof)
    return caught.value.code == "PROOF_INVALID"


@pytest.fixture
def two_levels():
    """A root page with one page below it that holds two keys, and a third key inline in the root."""
    first, second = split(3)
    third = keys_below(9, count=1)[0]
    below = page_of(
        (nibble_at(sha256(first), 1), leaf_of(first, b"one")), (nibble_at(sha256(second), 1), leaf_of(second, b"two"))
    )
    top = page_of((3, hash_page(below)), (9, leaf_of(third, b"three")))
    return hash_page(top), top, below, first, second, third


def test_nothing_is_in_the_empty_state():
    verify_proof(EMPTY_ROOT, b"any", None, Proof((EMPTY_PAGE,)))
    assert refused(EMPTY_ROOT, b"any", b"value", Proof((EMPTY_PAGE,)))


def test_the_rules_of_hashing_do_not_drift():
    root = hash_page(page_of((nibble_at(sha256(b"records\x00a"), 0), leaf_of(b"records\x00a", b"\x01"))))
    assert EMPTY_ROOT.hex() == "4b3dcdfa1c1573a1d68368d65c875084b28009ca232c84296178d030c15f6ae1"
    assert root.hex() == "d12c15c3050202d469aa5780c2d5454caa5104adb81261f96093fecc75288a2c"


def test_present_keys_are_shown_present_on_each_level(two_levels):
    root, top, below, first, second, third = two_levels
    verify_proof(root, first, b"one", Proof((top, below)))
    verify_proof(root, second, b"two", Proof((top, below)))
    verify_proof(root, third, b"three", Proof((top,)))


def test_present_keys_are_shown_present_with_their_value_and_cannot_be_denied(two_levels):
    root, top, below, first, _, third = two_levels
    assert refused(root, first, b"two", Proof((top, below)))
    assert refused(root, first, b"", Proof((top, below)))
    assert refused(root, third, b"one", Proof((top,)))
    assert refused(root, first, None, Proof((top, below)))
    assert refused(root, first, None, Proof((top,)))
    assert refused(root, third, None, Proof((top,)))


def test_absence_is_shown_by_an_empty_slot_and_by_a_stranger_in_the_slot(two_levels):
    root, top, _, _, _, third = two_levels
    verify_proof(root, keys_below(5, count=1)[0], None, Proof((top,)))
    stranger = next(key for key in keys_below(9, count=2) if key != third)
    verify_proof(root, stranger, None, Proof((top,)))
    assert refused(root, stranger, b"three", Proof((top,)))


def test_a_proof_has_exactly_the_pages_that_decide(two_levels):
    root, top, below, first, _, third = two_levels
    assert refused(root, first, b"one", Proof(()))
    assert refused(root, first, b"one", Proof((top,)))
    assert refused(root, first, b"one", Proof((below,)))
    assert refused(root, first, b"one", Proof((top, below, below)))
    assert refused(root, third, b"three", Proof((top, below)))
    assert refused(root, first, b"one", Proof((top, below) * 33))


def test_every_flipped_bit_of_a_page_is_noticed(two_levels):
    root, top, below, first, _, _ = two_levels
    for number, page in enumerate((top, below)):
        for position in range(len(page)):
            changed = bytearray(page)
            changed[position] ^= 0x10
            pages = [top, below]
            pages[number] = bytes(changed)
            assert refused(root, first, b"one", Proof(tuple(pages)))


def test_bytes_that_are_no_page_are_refused_even_if_they_hash_to_the_root():
    leaf = leaf_of(b"a", b"b")
    both = bytes.fromhex("00010001") + leaf + bytes(32)
    for page in (b"", b"\x00" * 3, bytes.fromhex("00010000"), bytes.fromhex("00000000") + leaf, both):
        assert not is_page(page)
        assert refused(hash_page(page), b"a", None, Proof((page,)))


def test_slots_are_found_between_leaves_and_branches():
    leaf, branch = b"\x01" * 64, b"\x02" * 32
    page = page_of((0, branch), (4, leaf), (5, branch), (15, leaf))
    assert is_page(page)
    assert [read_slot(page, nibble) for nibble in (0, 4, 5, 15)] == [branch, leaf, branch, leaf]
    assert [read_slot(page, nibble) for nibble in (1, 3, 6, 14)] == [None] * 4


def test_a_proof_travels_in_its_canonical_form(two_levels):
    _, top, below, *_ = two_levels
    proof = Proof((top, below))
    assert decode(encode(proof), Proof) == proof

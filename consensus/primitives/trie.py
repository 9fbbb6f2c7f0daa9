"""The state trie for verifiers: radix 16 over SHA-256(flat key); pages as in docs/reference/formats.md."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256, tagged_hasher

PAGE_TAG = "blockrobot/trie-page"
VALUE_TAG = "blockrobot/trie-value"
PATH_NIBBLES_COUNT = 2 * HASH_SIZE_BYTES
LEAF_SIZE_BYTES = 2 * HASH_SIZE_BYTES
PAGE_HEADER_BYTES = 4
EMPTY_PAGE = bytes(PAGE_HEADER_BYTES)


class Proof(Wire, frozen=True):
    """Pages from the root to the deciding slot."""

    pages: tuple[bytes, ...]


hash_page = tagged_hasher(PAGE_TAG)
"""The 32-byte hash by which the page above (or a header) refers to a page."""

hash_value = tagged_hasher(VALUE_TAG)
"""The 32-byte hash that stands for a value in a leaf."""

EMPTY_ROOT = hash_page(EMPTY_PAGE)
"""The root of a state without keys."""


def read_slot(page: bytes, nibble: int) -> bytes | None:
    """Return None, branch hash (32 bytes) or inline leaf (64); untrusted pages need `is_page` first."""
    leaves = page[0] << 8 | page[1]
    branches = page[2] << 8 | page[3]
    bit = 1 << nibble
    if not (leaves | branches) & bit:
        return None
    below = bit - 1
    start = PAGE_HEADER_BYTES + HASH_SIZE_BYTES * (2 * (leaves & below).bit_count() + (branches & below).bit_count())
    return page[start : start + (LEAF_SIZE_BYTES if leaves & bit else HASH_SIZE_BYTES)]


def is_page(page: bytes) -> bool:
    if len(page) < PAGE_HEADER_BYTES:
        return False
    leaves = page[0] << 8 | page[1]
    branches = page[2] << 8 | page[3]
    size = PAGE_HEADER_BYTES + LEAF_SIZE_BYTES * leaves.bit_count() + HASH_SIZE_BYTES * branches.bit_count()
    return not leaves & branches and len(page) == size


def nibble_at(path: bytes, depth: int) -> int:
    byte = path[depth >> 1]
    return byte & 0x0F if depth & 1 else byte >> 4


def _find_leaf(root: bytes, path: bytes, proof: Proof) -> bytes | None:
    expected = root
    last = len(proof.pages) - 1
    if not 0 <= last < PATH_NIBBLES_COUNT:
        raise BlockRobotError("PROOF_INVALID", "A state proof has no pages or too many.")
    for depth, page in enumerate(proof.pages):
        if not is_page(page) or hash_page(page) != expected:
            raise BlockRobotError("PROOF_INVALID", f"Page {depth} of a state proof does not hash to what refers to it.")
        slot = read_slot(page, nibble_at(path, depth))
        if slot is None or len(slot) == LEAF_SIZE_BYTES:
            if depth != last:
                raise BlockRobotError("PROOF_INVALID", "A state proof goes on below the slot that decides.")
            return slot
        expected = slot
    raise BlockRobotError("PROOF_INVALID", "A state proof ends above the slot that decides.")


def verify_proof(root: bytes, key: bytes, value: bytes | None, proof: Proof) -> None:
    """Check that a key holds `value` (None: is absent) under `root`. Raises PROOF_INVALID."""
    path = sha256(key)
    leaf = _find_leaf(root, path, proof)
    if value is None:
        if leaf is not None and leaf[:HASH_SIZE_BYTES] == path:
            raise BlockRobotError("PROOF_INVALID", "The state holds a key that is claimed to be absent.")
    elif leaf != path + hash_value(value):
        raise BlockRobotError("PROOF_INVALID", "The state does not hold the claimed value under this key.")

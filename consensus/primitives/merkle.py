"""Merkle trees over 32-byte leaves; roots are unique."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u32
from consensus.primitives.hashing import HASH_SIZE_BYTES, tagged_hash, tagged_hasher

_LEAF = "blockrobot/merkle-leaf"
_NODE = "blockrobot/merkle-node"
_ROOT = "blockrobot/merkle-root"
_hash_leaf = tagged_hasher(_LEAF)
_hash_node = tagged_hasher(_NODE)
_EMPTY = b"\x00" * HASH_SIZE_BYTES


def _level_above(level: Sequence[bytes]) -> list[bytes]:
    above = [_hash_node(level[i] + level[i + 1]) for i in range(0, len(level) - 1, 2)]
    if len(level) % 2:
        above.append(level[-1])
    return above


def _leaf_level(leaves: Sequence[bytes]) -> list[bytes]:
    for leaf in leaves:
        if len(leaf) != HASH_SIZE_BYTES:
            raise BlockRobotError("VALUE_INVALID", f"A Merkle leaf has {len(leaf)} bytes instead of 32.")
    return [_hash_leaf(leaf) for leaf in leaves]


def merkle_root(leaves: Sequence[bytes]) -> bytes:
    """Return the 32-byte root; the empty list has its own. Raises VALUE_INVALID."""
    level = _leaf_level(leaves)
    while len(level) > 1:
        level = _level_above(level)
    return tagged_hash(_ROOT, u32(len(leaves)), level[0] if level else _EMPTY)


def merkle_proof(leaves: Sequence[bytes], index: int) -> list[bytes]:
    """Return the siblings from leaf to root, lowest first. Raises VALUE_INVALID."""
    if not 0 <= index < len(leaves):
        raise BlockRobotError("VALUE_INVALID", f"There is no leaf {index} in a list of {len(leaves)}.")
    level = _leaf_level(leaves)
    proof: list[bytes] = []
    while len(level) > 1:
        sibling = index ^ 1
        if sibling < len(level):
            proof.append(level[sibling])
        level = _level_above(level)
        index //= 2
    return proof


def verify_merkle_proof(root: bytes, leaf: bytes, index: int, count: int, proof: Sequence[bytes]) -> bool:
    if not 0 <= index < count < 1 << 32 or len(leaf) != HASH_SIZE_BYTES:
        return False
    node, width, used = tagged_hash(_LEAF, leaf), count, 0
    while width > 1:
        if index ^ 1 < width:
            if used == len(proof) or len(proof[used]) != HASH_SIZE_BYTES:
                return False
            pair = (proof[used], node) if index % 2 else (node, proof[used])
            node, used = tagged_hash(_NODE, *pair), used + 1
        index, width = index // 2, (width + 1) // 2
    return used == len(proof) and tagged_hash(_ROOT, u32(count), node) == root

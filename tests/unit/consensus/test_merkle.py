"""Merkle trees: known shapes, and the classic confusions that they exclude."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.merkle import merkle_proof, merkle_root, verify_merkle_proof

A, B, C = (sha256(text) for text in (b"a", b"b", b"c"))


def leaf(value: bytes) -> bytes:
    return tagged_hash("blockrobot/merkle-leaf", value)


def node(left: bytes, right: bytes) -> bytes:
    return tagged_hash("blockrobot/merkle-node", left + right)


def root(count: int, top: bytes) -> bytes:
    return tagged_hash("blockrobot/merkle-root", count.to_bytes(4, "big") + top)


def test_the_shapes_of_small_trees() -> None:
    assert merkle_root([]) == root(0, bytes(32))
    assert merkle_root([A]) == root(1, leaf(A))
    assert merkle_root([A, B]) == root(2, node(leaf(A), leaf(B)))
    assert merkle_root([A, B, C]) == root(3, node(node(leaf(A), leaf(B)), leaf(C)))


def test_neither_a_doubled_leaf_nor_an_inner_node_passes_for_a_leaf() -> None:
    """In the tree of Bitcoin a list and the list with its last leaf doubled have one root (CVE-2012-2459)."""
    assert merkle_root([A, B, C]) != merkle_root([A, B, C, C])
    inner = node(leaf(A), leaf(B))
    assert merkle_root([inner, C]) != merkle_root([A, B, C])
    assert not verify_merkle_proof(merkle_root([A, B, C]), inner, 0, 3, [leaf(C)])


@pytest.mark.parametrize("size", [0, 31, 33])
def test_a_leaf_has_32_bytes(size: int) -> None:
    with pytest.raises(BlockRobotError, match=r"^VALUE_INVALID:"):
        merkle_root([bytes(size)])
    assert not verify_merkle_proof(merkle_root([A]), bytes(size), 0, 1, [])


@pytest.mark.parametrize("index", [-1, 3])
def test_there_is_no_proof_for_a_place_outside_the_list(index: int) -> None:
    with pytest.raises(BlockRobotError, match=r"^VALUE_INVALID:"):
        merkle_proof([A, B, C], index)
    assert not verify_merkle_proof(merkle_root([A, B, C]), A, index, 3, [])


@pytest.mark.parametrize("index", [-1, 1, 2])
def test_the_only_leaf_stands_at_no_other_place(index: int) -> None:
    """There is no sibling on its way that could tell."""
    assert verify_merkle_proof(merkle_root([A]), A, 0, 1, [])
    assert not verify_merkle_proof(merkle_root([A]), A, index, 1, [])


def test_a_proof_with_a_sibling_too_many_or_too_few_is_refused() -> None:
    proof, top = merkle_proof([A, B, C], 0), merkle_root([A, B, C])
    assert verify_merkle_proof(top, A, 0, 3, proof)
    assert not verify_merkle_proof(top, A, 0, 3, proof[:-1])
    assert not verify_merkle_proof(top, A, 0, 3, [*proof, B])
    assert not verify_merkle_proof(top, A, 0, 3, [proof[0], b""])
    assert not verify_merkle_proof(top, A, 0, 4, proof)

"""Merkle trees over any list: every leaf is proved in its place, and nothing else is."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from consensus.primitives.merkle import merkle_proof, merkle_root, verify_merkle_proof

LEAVES = st.lists(st.binary(min_size=32, max_size=32), min_size=1, max_size=70, unique=True)


@given(LEAVES, st.data())
def test_every_leaf_is_proved_in_its_place_alone(leaves: list[bytes], data: st.DataObject) -> None:
    root = merkle_root(leaves)
    index = data.draw(st.integers(0, len(leaves) - 1))
    place = data.draw(st.integers(0, len(leaves)))
    proof = merkle_proof(leaves, index)
    assert verify_merkle_proof(root, leaves[index], index, len(leaves), proof)
    assert verify_merkle_proof(root, leaves[index], place, len(leaves), proof) == (place == index)
    other = data.draw(st.binary(min_size=32, max_size=32))
    assert verify_merkle_proof(root, other, index, len(leaves), proof) == (other == leaves[index])


@given(LEAVES, LEAVES)
def test_two_lists_share_no_root(one: list[bytes], two: list[bytes]) -> None:
    assert (merkle_root(one) == merkle_root(two)) == (one == two)


@given(LEAVES, st.data())
def test_a_count_that_is_not_the_lists_proves_nothing(leaves: list[bytes], data: st.DataObject) -> None:
    index = data.draw(st.integers(0, len(leaves) - 1))
    count = data.draw(st.integers(index + 1, 200).filter(lambda number: number != len(leaves)))
    assert not verify_merkle_proof(merkle_root(leaves), leaves[index], index, count, merkle_proof(leaves, index))

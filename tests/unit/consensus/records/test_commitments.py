"""Commitments and ciphertext leaves: each part counts, and a destroyed key leaves a leaf that says nothing."""

from __future__ import annotations

import hashlib
import hmac

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.merkle import merkle_proof, merkle_root, verify_merkle_proof
from consensus.records.commitments import (
    ciphertext_leaf,
    ciphertext_leaves,
    ciphertext_root,
    commitment_leaf,
    commitment_root,
    derive_salt,
    frame_commitment,
)

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))


def test_salt_and_leaf_are_computed_as_published() -> None:
    extracted = hmac.new(bytes(32), KEY, hashlib.sha256).digest()
    assert derive_salt(KEY) == hmac.new(extracted, b"blockrobot/salt\x01", hashlib.sha256).digest()
    salt, digest = derive_salt(KEY), sha256(b"picture")
    expected = tagged_hash("blockrobot/commitment-leaf", b"\x00" + salt + b"\x00\x00\x00\x07" + digest)
    assert commitment_leaf(salt, 7, digest) == frame_commitment(KEY, 7, b"picture") == expected


def test_every_part_of_a_frame_and_of_its_stored_bytes_is_committed_to() -> None:
    leaves = {
        frame_commitment(KEY, 0, b"picture"),
        frame_commitment(OTHER_KEY, 0, b"picture"),
        frame_commitment(KEY, 1, b"picture"),
        frame_commitment(KEY, 0, b"pictures"),
    }
    assert len(leaves) == 4
    one, two = sha256(b"1"), sha256(b"2")
    leaves = {ciphertext_leaf(0, one, two), ciphertext_leaf(1, one, two), ciphertext_leaf(0, two, one)}
    assert len(leaves) == 3
    assert ciphertext_leaves([b"1"], [b"2"]) == [ciphertext_leaf(0, one, two)]


def test_a_clip_with_a_sealed_key_too_few_has_no_leaves() -> None:
    with pytest.raises(BlockRobotError, match=r"^UPLOAD_INVALID:"):
        ciphertext_leaves([b"1", b"2"], [b"1"])


def test_both_roots_are_merkle_roots_that_prove_single_frames() -> None:
    leaves = [frame_commitment(KEY, index, b"picture") for index in range(5)]
    assert commitment_root(leaves) == ciphertext_root(leaves) == merkle_root(leaves)
    assert verify_merkle_proof(commitment_root(leaves), leaves[3], 3, 5, merkle_proof(leaves, 3))

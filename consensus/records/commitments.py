"""The two commitments of a record: to what its frames show and to the bytes that custodians keep.

A commitment leaf hides its frame behind a salt that derives from the frame's data key: whoever destroys the key
destroys the salt, and the leaf that remains says nothing any more. A ciphertext leaf needs no key, so a custodian
can check what it was given.
"""

from __future__ import annotations

from collections.abc import Sequence

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u32
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256, tagged_hash
from consensus.primitives.merkle import merkle_root

_COMMITMENT_LEAF = "blockrobot/commitment-leaf"
_CIPHERTEXT_LEAF = "blockrobot/ciphertext-leaf"
_SALT_INFO = b"blockrobot/salt"


def derive_salt(data_key: bytes) -> bytes:
    """Return the 32-byte salt of a frame from its 32-byte data key (HKDF-SHA256)."""
    return HKDF(algorithm=hashes.SHA256(), length=HASH_SIZE_BYTES, salt=None, info=_SALT_INFO).derive(data_key)


def commitment_leaf(salt: bytes, index: int, plaintext_hash: bytes) -> bytes:
    """Return the leaf for frame `index` from its salt and the SHA-256 of its unpadded plaintext."""
    return tagged_hash(_COMMITMENT_LEAF, b"\x00", salt, u32(index), plaintext_hash)


def frame_commitment(data_key: bytes, index: int, plaintext: bytes) -> bytes:
    """Return the commitment leaf of a plaintext under its data key."""
    return commitment_leaf(derive_salt(data_key), index, sha256(plaintext))


def ciphertext_leaf(index: int, ciphertext_hash: bytes, sealed_key_hash: bytes) -> bytes:
    """Return the leaf for the stored bytes of frame `index` from their two SHA-256 hashes."""
    return tagged_hash(_CIPHERTEXT_LEAF, u32(index), ciphertext_hash, sealed_key_hash)


def ciphertext_leaves(ciphertexts: Sequence[bytes], sealed_keys: Sequence[bytes]) -> list[bytes]:
    """Return the ciphertext leaves of a whole clip. Raises UPLOAD_INVALID if the lists differ in length."""
    if len(ciphertexts) != len(sealed_keys):
        raise BlockRobotError(
            "UPLOAD_INVALID", f"There are {len(ciphertexts)} ciphertexts but {len(sealed_keys)} sealed keys."
        )
    pairs = zip(ciphertexts, sealed_keys, strict=True)
    return [ciphertext_leaf(index, sha256(text), sha256(key)) for index, (text, key) in enumerate(pairs)]


def commitment_root(leaves: Sequence[bytes]) -> bytes:
    """Return the root that a record holds for its commitment leaves."""
    return merkle_root(leaves)


def ciphertext_root(leaves: Sequence[bytes]) -> bytes:
    """Return the root that a record holds for its ciphertext leaves."""
    return merkle_root(leaves)

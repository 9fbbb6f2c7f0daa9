"""A record's commitments to frame contents and stored bytes; salts derive from data keys, so destroying a key blinds
its leaf.
"""

from __future__ import annotations

from collections.abc import Sequence

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u32
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256, tagged_hash
from consensus.primitives.merkle import merkle_root
from consensus.records.envelopes import RECORD_ID_BYTES

_COMMITMENT_LEAF = "blockrobot/commitment-leaf"
_CIPHERTEXT_LEAF = "blockrobot/ciphertext-leaf"
_RECORD_ID = "blockrobot/record-id"
_SALT_INFO = b"blockrobot/salt"


def derive_salt(data_key: bytes) -> bytes:
    """Return the 32-byte salt of a 32-byte data key (HKDF-SHA256)."""
    return HKDF(algorithm=hashes.SHA256(), length=HASH_SIZE_BYTES, salt=None, info=_SALT_INFO).derive(data_key)


def commitment_leaf(salt: bytes, index: int, plaintext_hash: bytes) -> bytes:
    return tagged_hash(_COMMITMENT_LEAF, b"\x00", salt, u32(index), plaintext_hash)


def frame_commitment(data_key: bytes, index: int, plaintext: bytes) -> bytes:
    return commitment_leaf(derive_salt(data_key), index, sha256(plaintext))


def ciphertext_leaf(index: int, ciphertext_hash: bytes, sealed_key_hash: bytes) -> bytes:
    return tagged_hash(_CIPHERTEXT_LEAF, u32(index), ciphertext_hash, sealed_key_hash)


def ciphertext_leaves(ciphertexts: Sequence[bytes], sealed_keys: Sequence[bytes]) -> list[bytes]:
    """Raises UPLOAD_INVALID for unequal lengths."""
    if len(ciphertexts) != len(sealed_keys):
        raise BlockRobotError(
            "UPLOAD_INVALID", f"There are {len(ciphertexts)} ciphertexts but {len(sealed_keys)} sealed keys."
        )
    pairs = zip(ciphertexts, sealed_keys, strict=True)
    return [ciphertext_leaf(index, sha256(text), sha256(key)) for index, (text, key) in enumerate(pairs)]


def commitment_root(leaves: Sequence[bytes]) -> bytes:
    return merkle_root(leaves)


def ciphertext_root(leaves: Sequence[bytes]) -> bytes:
    return merkle_root(leaves)


def derive_record_id(owner: bytes, root: bytes) -> bytes:
    """Return the 16-byte id of the record with this owner key (33 bytes) and commitment root (32).

    The contract `records` and custodians take no other id, so nobody can take the id of another robot's record.
    """
    return tagged_hash(_RECORD_ID, owner, root)[:RECORD_ID_BYTES]

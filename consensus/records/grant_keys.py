"""The grant salt, known to owner and grantee, opening the grantee's hash to custodians."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import HASH_SIZE_BYTES, tagged_hash
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES, PrivateKey

_SALT_TAG = "blockrobot/grant-salt"


def derive_grant_salt(private: PrivateKey, public: bytes, *, chain_id: bytes, owner: bytes) -> bytes:
    """Return the 32-byte salt of a grant of visit `owner`.

    From ephemeral secret and public view key, or private view key and on-chain ephemeral. Raises KEY_INVALID,
    VALUE_INVALID.
    """
    if len(chain_id) != HASH_SIZE_BYTES or len(owner) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A chain id has 32 bytes and an owner key 33.")
    return tagged_hash(_SALT_TAG, chain_id, owner, private.shared_point(public))

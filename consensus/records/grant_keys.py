"""The salt of a grant, which its owner and its grantee both derive, and nobody else.

With it the grantee shows custodians that she is the one whose handle the grant holds a hash of (`sharing`).
"""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import HASH_SIZE_BYTES, tagged_hash
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES, PrivateKey

_SALT_TAG = "blockrobot/grant-salt"


def derive_grant_salt(private: PrivateKey, public: bytes, *, chain_id: bytes, owner: bytes) -> bytes:
    """Return the 32-byte salt of a grant of the visit `owner`.

    The owner derives it from the ephemeral secret and the grantee's public view key, the grantee from her private view
    key and the ephemeral that stands on the chain. Raises KEY_INVALID for what is no point, VALUE_INVALID for wrong sizes.
    """
    if len(chain_id) != HASH_SIZE_BYTES or len(owner) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A chain id has 32 bytes and an owner key 33.")
    return tagged_hash(_SALT_TAG, chain_id, owner, private.shared_point(public))

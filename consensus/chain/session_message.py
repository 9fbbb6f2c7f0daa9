"""Session signatures over chain, node, single-use challenge and client key, preventing relay."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES, PrivateKey, recover

SESSION_TAG = "blockrobot/session"
CHALLENGE_SIZE_BYTES = 32


def session_parts(chain_id: bytes, node_name: str, challenge: bytes, public_key: bytes) -> tuple[bytes, ...]:
    """Return the parts under SESSION_TAG: chain id, node name, challenge, public key.

    All but the name have fixed size (unambiguous). Raises VALUE_INVALID.
    """
    if len(chain_id) != 32 or len(challenge) != CHALLENGE_SIZE_BYTES or len(public_key) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A part of the session's signed bytes has a wrong size.")
    return (chain_id, node_name.encode(), challenge, public_key)


def sign_session(key: PrivateKey, chain_id: bytes, node_name: str, challenge: bytes) -> bytes:
    """Return the 65-byte answer to a node's challenge. Raises VALUE_INVALID."""
    return key.sign(SESSION_TAG, *session_parts(chain_id, node_name, challenge, key.public_key))


def verify_session(public_key: bytes, signature: bytes, chain_id: bytes, node_name: str, challenge: bytes) -> None:
    """Check a challenge answer. Raises SIGNATURE_INVALID, SIGNATURE_HIGH_S or VALUE_INVALID."""
    if recover(SESSION_TAG, signature, *session_parts(chain_id, node_name, challenge, public_key)) != public_key:
        raise BlockRobotError("SIGNATURE_INVALID", "The challenge was not signed by the stated key for this network.")

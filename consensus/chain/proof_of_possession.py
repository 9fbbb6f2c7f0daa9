"""Proofs that a producer holds its key, for the genesis file. Must never be taken as given: each node checks all of them.

Without them an organisation could enter a key that nobody holds, or another's, and so take a vote from the schedule.
"""

from __future__ import annotations

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey, verify

POSSESSION_TAG = "blockrobot/producer-possession"


def prove_possession(key: PrivateKey, node: str) -> bytes:
    """Return the 64-byte proof that the producer of the node of this name holds its key."""
    return key.sign_compact(POSSESSION_TAG, node.encode())


def require_possession(genesis: Genesis) -> None:
    """Check the proof of every producer of a genesis file. Raises GENESIS_INVALID, naming the node."""
    for node in genesis.nodes:
        key, proof = node.producer_key, node.producer_possession
        if key and not verify(key, POSSESSION_TAG, proof, node.name.encode()):
            raise BlockRobotError("GENESIS_INVALID", f"The node {node.name!r} does not prove that it holds its key.")

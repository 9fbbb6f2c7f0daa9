"""Proofs of producers' key possession in the genesis file; every node checks all."""

from __future__ import annotations

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey, verify

POSSESSION_TAG = "blockrobot/producer-possession"


def prove_possession(key: PrivateKey, node: str) -> bytes:
    return key.sign_compact(POSSESSION_TAG, node.encode())


def require_possession(genesis: Genesis) -> None:
    """Check all producers' proofs. Raises GENESIS_INVALID, naming the node."""
    for node in genesis.nodes:
        key, proof = node.producer_key, node.producer_possession
        if key and not verify(key, POSSESSION_TAG, proof, node.name.encode()):
            raise BlockRobotError("GENESIS_INVALID", f"The node {node.name!r} does not prove that it holds its key.")

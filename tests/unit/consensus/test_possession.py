"""A producer enters a schedule only with a key that somebody holds and has proved for this very node."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.genesis import Genesis, prove_possession, require_possession
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from tests.unit.consensus.test_genesis import GENESIS, KEYS


def with_proofs(*proofs: bytes) -> Genesis:
    nodes = [
        msgspec.structs.replace(node, producer_possession=proof)
        for node, proof in zip(GENESIS.nodes, proofs, strict=True)
    ]
    return msgspec.structs.replace(GENESIS, nodes=tuple(nodes))


def test_producers_that_prove_their_keys_are_taken_and_others_need_no_proof() -> None:
    require_possession(with_proofs(prove_possession(KEYS[0], "a"), b"", prove_possession(KEYS[2], "c")))


@pytest.mark.parametrize(
    "proof",
    [
        b"",
        bytes(64),
        b"\xff" * 64,
        prove_possession(PrivateKey(bytes([77] * 32)), "c"),
        prove_possession(KEYS[2], "a"),
        prove_possession(KEYS[2], "c")[:-1],
    ],
    ids=["none", "zeros", "no-signature", "another-key", "another-node", "cut-short"],
)
def test_a_key_that_is_not_proved_is_refused_and_its_node_named(proof: bytes) -> None:
    with pytest.raises(BlockRobotError, match=r"GENESIS_INVALID.*'c'"):
        require_possession(with_proofs(prove_possession(KEYS[0], "a"), b"", proof))

"""What opens a session at one node opens it nowhere else."""

from __future__ import annotations

import pytest

from consensus.chain.session_message import session_parts, sign_session, verify_session
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey

KEY = PrivateKey(sha256(b"a member"))
OTHER = PrivateKey(sha256(b"another"))
CHAIN, CHALLENGE = sha256(b"chain"), sha256(b"challenge")


def test_the_answer_to_a_challenge_is_accepted() -> None:
    verify_session(KEY.public_key, sign_session(KEY, CHAIN, "n0", CHALLENGE), CHAIN, "n0", CHALLENGE)


@pytest.mark.parametrize(
    ("key", "chain", "name", "challenge"),
    [
        (OTHER.public_key, CHAIN, "n0", CHALLENGE),
        (KEY.public_key, CHALLENGE, "n0", CHALLENGE),
        (KEY.public_key, CHAIN, "n1", CHALLENGE),
        (KEY.public_key, CHAIN, "n0", CHAIN),
    ],
)
def test_an_answer_for_another_key_chain_node_or_challenge_is_refused(
    key: bytes, chain: bytes, name: str, challenge: bytes
) -> None:
    signature = sign_session(KEY, CHAIN, "n0", CHALLENGE)
    with pytest.raises(BlockRobotError, match="SIGNATURE_INVALID"):
        verify_session(key, signature, chain, name, challenge)


@pytest.mark.parametrize(
    ("chain", "challenge", "key"),
    [(b"", CHALLENGE, KEY.public_key), (CHAIN, CHALLENGE + b"x", KEY.public_key), (CHAIN, CHALLENGE, b"")],
)
def test_a_part_of_a_wrong_size_is_refused(chain: bytes, challenge: bytes, key: bytes) -> None:
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        session_parts(chain, "n0", challenge, key)

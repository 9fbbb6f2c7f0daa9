"""secp256k1 as the chain speaks it: signatures, keys and refusals that no other library may change.

`secp256k1.json` was written with coincurve 20.0.0 (another binding of libsecp256k1). In `signatures` each stands for key
`secret 0`, tag `t` and message `m`; of `points`, those of 65 bytes were taken then and are refused now.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec, utils
from cryptography.hazmat.primitives.hashes import SHA256
from hypothesis import given
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import GROUP_ORDER, PrivateKey, is_public_key, point_add, recover, verify

VECTORS: dict[str, list[dict[str, Any]]] = json.loads(
    Path(__file__).with_name("secp256k1.json").read_text(encoding="utf-8")
)
SIGNER = PrivateKey(sha256(b"secret 0").digest())
TWO = PrivateKey((2).to_bytes(32, "big"))


def outcome(call: Any, *arguments: Any) -> Any:
    """Return what the vectors write down: hex, a truth value, or the code of the refusal."""
    try:
        result = call(*arguments)
    except BlockRobotError as error:
        return error.code
    return result.hex() if isinstance(result, bytes) else result


@pytest.mark.parametrize("vector", VECTORS["signed"], ids=lambda vector: vector["secret"][:8])
def test_a_key_signs_and_meets_others_as_ever(vector: dict[str, str]) -> None:
    key = PrivateKey(bytes.fromhex(vector["secret"]))
    message, other = bytes.fromhex(vector["message"]), bytes.fromhex(vector["other"])
    assert key.public_key.hex() == vector["public_key"]
    assert key.sign(vector["tag"], message).hex() == vector["signature"]
    assert recover(vector["tag"], bytes.fromhex(vector["signature"]), message) == key.public_key
    assert outcome(key.shared_point, other) == vector["shared"]
    assert outcome(point_add, key.public_key, other) == vector["sum"]


def test_odd_signatures_are_read_and_refused_as_ever() -> None:
    for vector in VECTORS["signatures"]:
        signature = bytes.fromhex(vector["signature"])
        assert outcome(recover, "t", signature, b"m") == vector["recover"], vector
        assert outcome(verify, SIGNER.public_key, "t", signature[:64], b"m") == vector["verify"], vector


def test_odd_points_are_read_and_refused_as_ever() -> None:
    signature = SIGNER.sign_compact("t", b"m")
    for vector in VECTORS["points"]:
        point = bytes.fromhex(vector["point"])
        assert is_public_key(point) == vector["is_key"], vector
        assert outcome(point_add, point, point) == vector["doubled"], vector
        assert outcome(TWO.shared_point, point) == vector["by_two"], vector
        assert outcome(verify, point, "t", signature, b"m") == vector["verify"], vector


@given(secret=st.integers(1, GROUP_ORDER - 1), message=st.binary(max_size=64), flipped=st.integers(0, 511))
def test_openssl_agrees_with_every_verdict(secret: int, message: bytes, flipped: int) -> None:
    key = PrivateKey(secret.to_bytes(32, "big"))
    honest = key.sign_compact("t", message)
    forged = (int.from_bytes(honest, "big") ^ 1 << flipped).to_bytes(64, "big")
    public = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256K1(), key.public_key)
    for signature in (honest, forged):
        r, s = int.from_bytes(signature[:32], "big"), int.from_bytes(signature[32:], "big")
        try:
            public.verify(
                utils.encode_dss_signature(r, s), tagged_hash("t", message), ec.ECDSA(utils.Prehashed(SHA256()))
            )
            good = s <= GROUP_ORDER // 2
        except InvalidSignature:
            good = False
        assert verify(key.public_key, "t", signature, message) == good == (signature == honest)


@given(
    data=st.binary(max_size=70) | st.binary(min_size=33, max_size=33) | st.binary(min_size=64, max_size=65),
    point=st.binary(max_size=66) | st.binary(min_size=33, max_size=33),
)
def test_bytes_of_any_kind_are_answered_or_refused(data: bytes, point: bytes) -> None:
    assert outcome(verify, point, "t", data, b"m") in (True, False)
    assert is_public_key(point) in (True, False)
    for result in (
        outcome(recover, "t", data, b"m"),
        outcome(point_add, point, data),
        outcome(TWO.shared_point, point),
    ):
        assert result in {"KEY_INVALID", "SIGNATURE_INVALID", "SIGNATURE_HIGH_S"} or is_public_key(
            bytes.fromhex(result)
        )


def test_threads_share_the_library() -> None:
    def round_trip(number: int) -> bool:
        message = number.to_bytes(4, "big")
        signature = SIGNER.sign("t", message)
        return recover("t", signature, message) == SIGNER.public_key and verify(
            SIGNER.public_key, "t", signature[:64], message
        )

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(round_trip, range(2_000)))

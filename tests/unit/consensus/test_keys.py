"""Keys and signatures: one key, one tag, one message, one signature."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import (
    GROUP_ORDER,
    PrivateKey,
    is_public_key,
    point_add,
    point_of,
    recover,
    scalar_add,
    scalar_from_hash,
    verify,
)

KEY = PrivateKey(sha256(b"a key"))
OTHER = PrivateKey(sha256(b"another key"))
TAG = "blockrobot/test"


def refused(code, call, *arguments):
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        call(*arguments)


def high_s(signature):
    """Return the other valid form of a signature: s replaced by n - s."""
    s = GROUP_ORDER - int.from_bytes(signature[32:64], "big")
    tail = bytes([signature[64] ^ 1]) if len(signature) == 65 else b""
    return signature[:32] + s.to_bytes(32, "big") + tail


def test_a_recoverable_signature_names_its_signer_for_its_message_and_tag_alone():
    assert recover(TAG, KEY.sign(TAG, b"message"), b"message") == KEY.public_key
    signature = KEY.sign(TAG, b"message")
    assert recover(TAG, signature, b"other") != KEY.public_key
    assert recover("blockrobot/other", signature, b"message") != KEY.public_key
    assert KEY.sign(TAG, b"message") == KEY.sign(TAG, b"message")
    assert KEY.sign(TAG, b"message") != OTHER.sign(TAG, b"message")


def test_a_compact_signature_verifies_for_its_key_tag_and_message_only():
    signature = KEY.sign_compact(TAG, b"mes", b"sage")
    assert verify(KEY.public_key, TAG, signature, b"mes", b"sage")
    assert verify(KEY.public_key, TAG, signature, b"message")
    assert not verify(OTHER.public_key, TAG, signature, b"message")
    assert not verify(KEY.public_key, "blockrobot/other", signature, b"message")
    assert not verify(KEY.public_key, TAG, signature, b"massage")


def test_the_high_form_of_a_signature_is_refused():
    refused("SIGNATURE_HIGH_S", recover, TAG, high_s(KEY.sign(TAG, b"m")), b"m")
    assert not verify(KEY.public_key, TAG, high_s(KEY.sign_compact(TAG, b"m")), b"m")


@pytest.mark.parametrize(
    "signature",
    [b"", bytes(64), bytes(65), b"\xff" * 32 + bytes(32) + b"\x00", KEY.sign(TAG, b"m")[:64] + b"\x04", bytes(66)],
    ids=lambda signature: signature.hex()[:16] or "empty",
)
def test_bytes_that_are_no_recoverable_signature_are_refused(signature):
    refused("SIGNATURE_INVALID", recover, TAG, signature, b"m")


@pytest.mark.parametrize("size", [0, 63, 64, 65])
def test_bytes_that_are_no_compact_signature_do_not_verify(size):
    assert not verify(KEY.public_key, TAG, bytes(size), b"m")


def test_a_key_that_is_no_point_or_a_signature_of_large_r_verifies_nothing():
    assert not verify(KEY.public_key, TAG, b"\xff" * 32 + b"\x01" * 32, b"m")
    assert not verify(bytes(33), TAG, KEY.sign_compact(TAG, b"m"), b"m")
    assert not verify(b"short", TAG, KEY.sign_compact(TAG, b"m"), b"m")


@pytest.mark.parametrize("secret", [b"", bytes(32), b"\xff" * 32, GROUP_ORDER.to_bytes(32, "big"), bytes(33)])
def test_a_secret_outside_the_group_is_refused(secret):
    refused("KEY_INVALID", PrivateKey, secret)


def test_a_key_never_shows_its_secret():
    assert KEY.secret.hex() not in repr(KEY)
    assert KEY.public_key.hex() in repr(KEY)


def test_public_keys_are_told_from_other_bytes():
    assert is_public_key(KEY.public_key)
    assert not is_public_key(bytes(33))
    assert not is_public_key(KEY.public_key + b"\x00")
    assert not is_public_key(b"\x04" + KEY.public_key[1:])


def test_points_add_and_multiply_as_their_scalars_do():
    total = scalar_add(KEY.secret, OTHER.secret)
    assert point_add(KEY.public_key, OTHER.public_key) == point_of(total)
    assert PrivateKey(scalar_from_hash((2).to_bytes(32, "big"))).shared_point(KEY.public_key) == point_add(
        KEY.public_key, KEY.public_key
    )
    assert KEY.shared_point(OTHER.public_key) == OTHER.shared_point(KEY.public_key)


def test_a_sum_or_point_that_is_none_is_refused():
    negative = (GROUP_ORDER - int.from_bytes(KEY.secret, "big")).to_bytes(32, "big")
    refused("KEY_INVALID", scalar_add, KEY.secret, negative)
    refused("KEY_INVALID", point_add, KEY.public_key, point_of(negative))
    refused("KEY_INVALID", point_add, bytes(33), KEY.public_key)
    refused("KEY_INVALID", KEY.shared_point, bytes(33))


def test_a_hash_becomes_a_scalar_of_the_group():
    assert scalar_from_hash(bytes(32)) == (1).to_bytes(32, "big")
    assert scalar_from_hash(GROUP_ORDER.to_bytes(32, "big")) == (1).to_bytes(32, "big")
    assert 0 < int.from_bytes(scalar_from_hash(b"\xff" * 32), "big") < GROUP_ORDER

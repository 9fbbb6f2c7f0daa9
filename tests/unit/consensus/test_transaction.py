"""Transactions: who signed what for which chain, and what never gets past decoding."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.transaction import TransactionWire, compute_txid, decode_transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_SIZE_MAX_BYTES
from consensus.primitives.encoding import decode, encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey

KEY = PrivateKey(sha256(b"a member"))
THIEF = PrivateKey(sha256(b"a thief"))
CHAIN_ID = sha256(b"a chain")


def signed(key=KEY, **changes):
    fields = {
        "chain_id": CHAIN_ID,
        "contract": "access",
        "entry": "request",
        "arguments": [[b"\x01" * 16], "treatment"],
        "valid_until_ms": 1_800_000_000_000,
        "salt": b"saltsalt",
    }
    return sign_transaction(key, **(fields | changes))


def wire_of(transaction, **changes):
    """Return the wire with a changed body, under the old signature."""
    body = encode(msgspec.structs.replace(transaction.body, **changes))
    return encode(TransactionWire(body=body, signature=transaction.signature))


def refused(code, wire):
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        decode_transaction(wire).verify_sender()


def test_a_transaction_comes_back_from_the_wire_which_keeps_its_body_as_one_byte_string():
    transaction = signed()
    again = decode_transaction(transaction.wire)
    assert again == transaction
    assert again.arguments() == [[b"\x01" * 16], "treatment"]
    again.verify_sender()
    assert decode(transaction.wire, TransactionWire).body == transaction.body_bytes


def test_the_sender_is_the_key_that_signed_whatever_is_sent_with_it():
    assert signed().body.sender == KEY.public_key
    # The sender stands in the signed body: a thief's signature over it recovers the thief.
    transaction = signed()
    signature = THIEF.sign("blockrobot/sign-tx", transaction.body_bytes)
    refused("SIGNATURE_INVALID", encode(TransactionWire(body=transaction.body_bytes, signature=signature)))
    transaction = signed()
    short = TransactionWire(body=transaction.body_bytes, signature=transaction.signature[:64])
    refused("ENCODING_INVALID", encode(short))


@pytest.mark.parametrize(
    "changes",
    [
        {"chain_id": sha256(b"another chain")},
        {"sender": THIEF.public_key},
        {"contract": "erasure"},
        {"entry": "grant"},
        {"args": encode_value([])},
        {"valid_until_ms": 1_800_000_000_001},
        {"salt": b"tlastlas"},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_a_changed_field_breaks_the_signature(changes):
    refused("SIGNATURE_INVALID", wire_of(signed(), **changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"version": 2},
        {"chain_id": b"short"},
        {"sender": KEY.public_key[1:]},
        {"contract": ""},
        {"contract": "c" * 33},
        {"entry": ""},
        {"entry": "e" * 33},
        {"salt": b"seven77"},
        {"valid_until_ms": -1},
        {"valid_until_ms": 1 << 53},
        {"args": b"\xc1"},
        {"args": encode_value({"not": "a list"})},
    ],
    ids=str,
)
def test_a_field_of_the_wrong_form_is_refused_before_the_signature_is_looked_at(changes):
    with pytest.raises(BlockRobotError, match=r"^ENCODING_INVALID:"):
        decode_transaction(wire_of(signed(), **changes))


def test_arguments_in_a_second_form_are_refused():
    with pytest.raises(BlockRobotError, match=r"^ENCODING_NOT_CANONICAL:"):
        decode_transaction(wire_of(signed(), args=b"\x91\xcc\x01"))


def test_the_id_follows_from_the_body_alone_and_so_from_its_salt():
    transaction = signed()
    assert transaction.txid == compute_txid(transaction.body_bytes)
    again = TransactionWire(body=transaction.body_bytes, signature=bytes(65))
    assert decode_transaction(encode(again)).txid == transaction.txid
    assert signed().txid != signed(salt=b"othersal").txid
    assert signed() == signed()


def test_a_transaction_of_just_the_largest_size_passes_and_one_more_byte_does_not():
    empty = len(signed(arguments=[b"x" * 10_000]).wire) - 10_000
    full = signed(arguments=[b"x" * (TRANSACTION_SIZE_MAX_BYTES - empty)])
    assert len(full.wire) == TRANSACTION_SIZE_MAX_BYTES
    assert decode_transaction(full.wire).txid == full.txid
    over = signed(arguments=[b"x" * (TRANSACTION_SIZE_MAX_BYTES - empty + 1)])
    refused("TRANSACTION_TOO_LARGE", over.wire)


@pytest.mark.parametrize("wire", [b"", b"\x92", b"\x90", encode_value("text"), b"\x92\xc4\x00\xc4\x00"], ids=repr)
def test_bytes_that_are_no_transaction_are_refused(wire):
    refused("ENCODING_INVALID", wire)

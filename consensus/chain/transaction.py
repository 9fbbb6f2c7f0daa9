"""Transactions: signed calls bound to chain and expiry; the sender is the recovered key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from consensus.errors import BlockRobotError
from consensus.limits import CONTRACT_NAME_MAX_CHARS, TRANSACTION_SIZE_MAX_BYTES
from consensus.primitives.encoding import EXACT_INTEGER_END, Wire, decode, decode_value, encode, encode_value
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES, PrivateKey, recover

TRANSACTION_VERSION = 1
SALT_SIZE_BYTES = 8
_ID_TAG = "blockrobot/tx"
_SIGN_TAG = "blockrobot/sign-tx"


class TransactionBody(Wire, frozen=True):
    """The signed body; `args` is an encoded positional list, `salt` distinguishes equal calls."""

    version: int
    chain_id: bytes
    sender: bytes
    contract: str
    entry: str
    args: bytes
    valid_until_ms: int
    salt: bytes


class TransactionWire(Wire, frozen=True):
    """The signed body and its 65-byte recoverable signature."""

    body: bytes
    signature: bytes


@dataclass(frozen=True, slots=True)
class Transaction:
    """A decoded transaction with its original bytes; `verify_sender` checks the signature."""

    wire: bytes
    body: TransactionBody
    signature: bytes
    txid: bytes
    body_bytes: bytes

    def arguments(self) -> list[Any]:
        """Raises ENCODING_*."""
        arguments = decode_value(self.body.args)
        if not isinstance(arguments, list):
            raise BlockRobotError("ENCODING_INVALID", "The arguments are not a list.")
        return arguments

    def verify_sender(self) -> None:
        """Check recovered key against sender. Raises SIGNATURE_INVALID or SIGNATURE_HIGH_S."""
        if recover(_SIGN_TAG, self.signature, self.body_bytes) != self.body.sender:
            raise BlockRobotError("SIGNATURE_INVALID", "The transaction was not signed by its stated sender.")


def compute_txid(body_bytes: bytes) -> bytes:
    """Return the 32-byte txid; it hashes the body, so re-signing keeps it."""
    return tagged_hash(_ID_TAG, body_bytes)


def sign_transaction(
    key: PrivateKey,
    *,
    chain_id: bytes,
    contract: str,
    entry: str,
    arguments: list[Any],
    valid_until_ms: int,
    salt: bytes,
) -> Transaction:
    """Build and sign a transaction; `salt` is 8 fresh random bytes."""
    body = TransactionBody(
        version=TRANSACTION_VERSION,
        chain_id=chain_id,
        sender=key.public_key,
        contract=contract,
        entry=entry,
        args=encode_value(arguments),
        valid_until_ms=valid_until_ms,
        salt=salt,
    )
    body_bytes = encode(body)
    signature = key.sign(_SIGN_TAG, body_bytes)
    wire = encode(TransactionWire(body=body_bytes, signature=signature))
    return Transaction(wire=wire, body=body, signature=signature, txid=compute_txid(body_bytes), body_bytes=body_bytes)


def decode_transaction(wire: bytes) -> Transaction:
    """Decode without checking signature or chain. Raises TRANSACTION_TOO_LARGE or ENCODING_*."""
    if len(wire) > TRANSACTION_SIZE_MAX_BYTES:
        raise BlockRobotError(
            "TRANSACTION_TOO_LARGE",
            f"The transaction has {len(wire)} bytes; at most {TRANSACTION_SIZE_MAX_BYTES} are allowed.",
        )
    outer = decode(wire, TransactionWire)
    body = decode(outer.body, TransactionBody)
    if (
        body.version != TRANSACTION_VERSION
        or len(body.chain_id) != 32
        or len(body.sender) != PUBLIC_KEY_SIZE_BYTES
        or len(body.salt) != SALT_SIZE_BYTES
        or len(outer.signature) != 65
        or not 0 < len(body.contract) <= CONTRACT_NAME_MAX_CHARS
        or not 0 < len(body.entry) <= CONTRACT_NAME_MAX_CHARS
        or not 0 <= body.valid_until_ms < EXACT_INTEGER_END
    ):
        raise BlockRobotError("ENCODING_INVALID", "A field of the transaction has a wrong size.")
    transaction = Transaction(
        wire=wire,
        body=body,
        signature=outer.signature,
        txid=compute_txid(outer.body),
        body_bytes=outer.body,
    )
    transaction.arguments()
    return transaction

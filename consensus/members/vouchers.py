"""Enrolment: the registrar's voucher, and the card's one-time key and code.

The card's secret e signs the four keys, so an observer cannot steal the handle.
"""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass, field

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import EXACT_INTEGER_END, u64
from consensus.primitives.hashing import HASH_SIZE_BYTES, tagged_hash
from consensus.primitives.keys import (
    PRIVATE_KEY_SIZE_BYTES,
    PUBLIC_KEY_SIZE_BYTES,
    SIGNATURE_SIZE_BYTES,
    PrivateKey,
    recover,
)

VOUCHER_TAG = "blockrobot/voucher"
CARD_TAG = "blockrobot/card"
ROTATION_TAG = "blockrobot/rotation"
ROLES = ("subject", "staff", "robot", "officer", "auditor")
HANDLE_SIZE_BYTES = 32
CODE_PREFIX = "BR1-"

_CHECKSUM_TAG = "blockrobot/card-code"
_CHECKSUM_BYTES = 4
_GROUP_CHARS = 8
_BODY_BYTES = HANDLE_SIZE_BYTES + PRIVATE_KEY_SIZE_BYTES + 1 + 8 + SIGNATURE_SIZE_BYTES
_CODE_MAX_CHARS = 1024
_MISREAD = str.maketrans({"0": "O", "1": "I", "8": "B"})


@dataclass(frozen=True, slots=True)
class Card:
    """A card code's contents; `repr` hides the one-time secret."""

    handle: bytes
    card_secret: bytes = field(repr=False)
    role: str
    not_after_ms: int
    voucher_signature: bytes

    @property
    def card_public(self) -> bytes:
        return PrivateKey(self.card_secret).public_key


def _require_sizes(*pairs: tuple[bytes, int]) -> None:
    if any(len(data) != size for data, size in pairs):
        raise BlockRobotError("VALUE_INVALID", "A field of an enrolment has a wrong size.")


def voucher_message(chain_id: bytes, handle: bytes, card_public: bytes, role: str, not_after_ms: int) -> bytes:
    """Return the voucher message: chain 32, handle 32, E 33, expiry u64, role. Raises VALUE_INVALID."""
    _require_sizes((chain_id, HASH_SIZE_BYTES), (handle, HANDLE_SIZE_BYTES), (card_public, PUBLIC_KEY_SIZE_BYTES))
    if role not in ROLES or not 0 <= not_after_ms < EXACT_INTEGER_END:
        raise BlockRobotError("VALUE_INVALID", f"A voucher is for one of {', '.join(ROLES)}, with an expiry in ms.")
    return chain_id + handle + card_public + u64(not_after_ms) + role.encode()


def card_message(chain_id: bytes, handle: bytes, member: bytes, spend: bytes, view: bytes, sealing: bytes) -> bytes:
    """Return the card key's message: chain 32, handle 32, M, S, V 33 each, X 32. Raises VALUE_INVALID."""
    _require_sizes((chain_id, HASH_SIZE_BYTES), (handle, HANDLE_SIZE_BYTES), (sealing, 32))
    _require_sizes(*((key, PUBLIC_KEY_SIZE_BYTES) for key in (member, spend, view)))
    return chain_id + handle + member + spend + view + sealing


def rotation_message(
    chain_id: bytes, handle: bytes, member: bytes, new_member: bytes, spend: bytes, view: bytes, sealing: bytes
) -> bytes:
    """Return the rotation message: chain, handle, old M, new M, S, V, X. Raises VALUE_INVALID."""
    _require_sizes((member, PUBLIC_KEY_SIZE_BYTES))
    rest = card_message(chain_id, handle, new_member, spend, view, sealing)
    head = HASH_SIZE_BYTES + HANDLE_SIZE_BYTES
    return rest[:head] + member + rest[head:]


def issue_card(
    registrar: PrivateKey, *, chain_id: bytes, handle: bytes, card_secret: bytes, role: str, not_after_ms: int
) -> Card:
    card_public = PrivateKey(card_secret).public_key
    message = voucher_message(chain_id, handle, card_public, role, not_after_ms)
    return Card(
        handle=handle,
        card_secret=card_secret,
        role=role,
        not_after_ms=not_after_ms,
        voucher_signature=registrar.sign(VOUCHER_TAG, message),
    )


def recover_registrar(card: Card, chain_id: bytes) -> bytes:
    """Return the signing registrar's 33-byte key. Raises VOUCHER_INVALID."""
    message = voucher_message(chain_id, card.handle, card.card_public, card.role, card.not_after_ms)
    try:
        return recover(VOUCHER_TAG, card.voucher_signature, message)
    except BlockRobotError:
        raise BlockRobotError("VOUCHER_INVALID") from None


def sign_card(card: Card, *, chain_id: bytes, member: bytes, spend: bytes, view: bytes, sealing: bytes) -> bytes:
    message = card_message(chain_id, card.handle, member, spend, view, sealing)
    return PrivateKey(card.card_secret).sign(CARD_TAG, message)


def sign_rotation(
    new_key: PrivateKey, *, chain_id: bytes, handle: bytes, member: bytes, spend: bytes, view: bytes, sealing: bytes
) -> bytes:
    message = rotation_message(chain_id, handle, member, new_key.public_key, spend, view, sealing)
    return new_key.sign(ROTATION_TAG, message)


def encode_card_code(card: Card) -> str:
    _require_sizes(
        (card.handle, HANDLE_SIZE_BYTES),
        (card.card_secret, PRIVATE_KEY_SIZE_BYTES),
        (card.voucher_signature, SIGNATURE_SIZE_BYTES),
    )
    role = bytes([ROLES.index(card.role)])
    body = card.handle + card.card_secret + role + u64(card.not_after_ms) + card.voucher_signature
    letters = base64.b32encode(body + tagged_hash(_CHECKSUM_TAG, body)[:_CHECKSUM_BYTES]).decode().rstrip("=")
    groups = [letters[start : start + _GROUP_CHARS] for start in range(0, len(letters), _GROUP_CHARS)]
    return CODE_PREFIX + "-".join(groups)


def decode_card_code(code: str, now_ms: int | None = None) -> Card:
    """Decode a card code, ignoring case, spaces and dashes. Raises VOUCHER_INVALID, or VOUCHER_EXPIRED at `now_ms`."""
    letters = "".join(code.split()).upper()
    if len(letters) > _CODE_MAX_CHARS or not letters.startswith(CODE_PREFIX):
        raise BlockRobotError("VOUCHER_INVALID", f"An enrolment code begins with {CODE_PREFIX}.")
    letters = letters[len(CODE_PREFIX) :].replace("-", "").translate(_MISREAD)
    try:
        data = base64.b32decode(letters + "=" * (-len(letters) % 8))
    except (binascii.Error, ValueError):
        raise BlockRobotError("VOUCHER_INVALID") from None
    body, checksum = data[:-_CHECKSUM_BYTES], data[-_CHECKSUM_BYTES:]
    if len(body) != _BODY_BYTES or tagged_hash(_CHECKSUM_TAG, body)[:_CHECKSUM_BYTES] != checksum:
        raise BlockRobotError("VOUCHER_INVALID")
    role, rest = body[64], body[65:]
    if role >= len(ROLES):
        raise BlockRobotError("VOUCHER_INVALID")
    card = Card(
        handle=body[:32],
        card_secret=body[32:64],
        role=ROLES[role],
        not_after_ms=int.from_bytes(rest[:8], "big"),
        voucher_signature=rest[8:],
    )
    if encode_card_code(card).replace("-", "") != CODE_PREFIX.replace("-", "") + letters:
        raise BlockRobotError("VOUCHER_INVALID")
    if now_ms is not None and now_ms > card.not_after_ms:
        raise BlockRobotError("VOUCHER_EXPIRED")
    return card

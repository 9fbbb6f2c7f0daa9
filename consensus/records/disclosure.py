"""Disclosure of one sealed box (libsodium) by its one-time shared key, which opens no other."""

from __future__ import annotations

import hashlib

from nacl.bindings import crypto_box_beforenm, crypto_box_open_afternm
from nacl.exceptions import CryptoError

from consensus.errors import BlockRobotError
from consensus.limits import SEALED_METADATA_BYTES
from consensus.records.envelopes import SEALED_BOX_OVERHEAD_BYTES, SEALING_KEY_BYTES
from consensus.records.padding import unpad_from

BOX_KEY_BYTES = 32
_NONCE_BYTES = 24


def derive_box_key(sealing_private: bytes, sealed: bytes) -> bytes:
    """Return a sealed box's 32-byte key. Raises ENVELOPE_INVALID."""
    if len(sealing_private) != SEALING_KEY_BYTES or len(sealed) < SEALED_BOX_OVERHEAD_BYTES:
        raise BlockRobotError("ENVELOPE_INVALID")
    try:
        return bytes(crypto_box_beforenm(sealed[:SEALING_KEY_BYTES], sealing_private))
    except CryptoError:
        raise BlockRobotError("ENVELOPE_INVALID") from None


def open_disclosed_metadata(sealing_public: bytes, box_key: bytes, sealed: bytes) -> bytes:
    """Open metadata with its box key and the owner's public sealing key. Raises ENVELOPE_INVALID."""
    sizes = (len(sealing_public), len(box_key), len(sealed))
    if sizes != (SEALING_KEY_BYTES, BOX_KEY_BYTES, SEALED_METADATA_BYTES):
        raise BlockRobotError("ENVELOPE_INVALID", "The box, its key or its owner's key has a wrong size.")
    one_time = sealed[:SEALING_KEY_BYTES]
    nonce = hashlib.blake2b(one_time + sealing_public, digest_size=_NONCE_BYTES).digest()
    try:
        padded: bytes = crypto_box_open_afternm(sealed[SEALING_KEY_BYTES:], nonce, box_key)
    except CryptoError:
        raise BlockRobotError("ENVELOPE_INVALID") from None
    return unpad_from(padded)

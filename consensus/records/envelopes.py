"""Envelopes: frames under data keys sealed to the owner; one sealed box is disclosed by its own key."""

from __future__ import annotations

import hashlib

from nacl.bindings import (
    crypto_aead_xchacha20poly1305_ietf_decrypt,
    crypto_aead_xchacha20poly1305_ietf_encrypt,
    crypto_box_beforenm,
    crypto_box_open_afternm,
)
from nacl.exceptions import CryptoError
from nacl.public import PrivateKey, PublicKey, SealedBox

from consensus.errors import BlockRobotError
from consensus.limits import SEALED_METADATA_BYTES
from consensus.primitives.encoding import u32
from consensus.records.padding import pad, pad_to, unpad, unpad_from

DATA_KEY_BYTES = 32
NONCE_BYTES = 24
TAG_BYTES = 16
SEALING_KEY_BYTES = 32
SEALED_BOX_OVERHEAD_BYTES = 48
SEALED_KEY_BYTES = DATA_KEY_BYTES + SEALED_BOX_OVERHEAD_BYTES
RECORD_ID_BYTES = 16
BOX_KEY_BYTES = 32
_BOX_NONCE_BYTES = 24


def _associated_data(record_id: bytes, index: int) -> bytes:
    if len(record_id) != RECORD_ID_BYTES:
        raise BlockRobotError("VALUE_INVALID", f"A record id has {len(record_id)} bytes instead of 16.")
    return record_id + u32(index)


def seal_bytes(key: bytes, nonce: bytes, record_id: bytes, index: int, plaintext: bytes) -> bytes:
    """Return nonce || XChaCha20-Poly1305(plaintext), bound to record and frame; fresh key 32 bytes, nonce 24."""
    if len(key) != DATA_KEY_BYTES or len(nonce) != NONCE_BYTES:
        raise BlockRobotError("KEY_INVALID", "An envelope takes a key of 32 bytes and a nonce of 24.")
    associated = _associated_data(record_id, index)
    return nonce + crypto_aead_xchacha20poly1305_ietf_encrypt(plaintext, associated, nonce, key)


def open_bytes(key: bytes, record_id: bytes, index: int, sealed: bytes) -> bytes:
    """Open `seal_bytes`. Raises ENVELOPE_INVALID for another key, place or bytes."""
    associated = _associated_data(record_id, index)
    if len(key) != DATA_KEY_BYTES or len(sealed) < NONCE_BYTES + TAG_BYTES:
        raise BlockRobotError("ENVELOPE_INVALID")
    try:
        plaintext: bytes = crypto_aead_xchacha20poly1305_ietf_decrypt(
            sealed[NONCE_BYTES:], associated, sealed[:NONCE_BYTES], key
        )
    except CryptoError:
        raise BlockRobotError("ENVELOPE_INVALID") from None
    return plaintext


def seal_frame(data_key: bytes, nonce: bytes, record_id: bytes, index: int, plaintext: bytes) -> bytes:
    """Pad and seal a frame. Raises UPLOAD_INVALID if too large."""
    return seal_bytes(data_key, nonce, record_id, index, pad(plaintext))


def open_frame(data_key: bytes, record_id: bytes, index: int, ciphertext: bytes) -> bytes:
    """Open a frame. Raises ENVELOPE_INVALID for another key, place or bytes."""
    return unpad(open_bytes(data_key, record_id, index, ciphertext))


def seal_to(sealing_public: bytes, plaintext: bytes) -> bytes:
    """Return a sealed box for an X25519 key, 48 bytes longer. Raises KEY_INVALID, also for low order."""
    if len(sealing_public) != SEALING_KEY_BYTES:
        raise BlockRobotError("KEY_INVALID", "A sealing key has 32 bytes.")
    try:
        sealed: bytes = SealedBox(PublicKey(sealing_public)).encrypt(plaintext)
    except CryptoError:
        raise BlockRobotError("KEY_INVALID", "Nothing can be sealed to this key.") from None
    return sealed


def open_sealed(sealing_private: bytes, sealed: bytes) -> bytes:
    """Open `seal_to`. Raises ENVELOPE_INVALID."""
    if len(sealing_private) != SEALING_KEY_BYTES or len(sealed) < SEALED_BOX_OVERHEAD_BYTES:
        raise BlockRobotError("ENVELOPE_INVALID")
    try:
        plaintext: bytes = SealedBox(PrivateKey(sealing_private)).decrypt(sealed)
    except CryptoError:
        raise BlockRobotError("ENVELOPE_INVALID") from None
    return plaintext


def seal_data_key(sealing_public: bytes, data_key: bytes) -> bytes:
    """Seal a 32-byte data key to its owner, 80 bytes. Raises KEY_INVALID."""
    if len(data_key) != DATA_KEY_BYTES:
        raise BlockRobotError("KEY_INVALID", "A data key has 32 bytes.")
    return seal_to(sealing_public, data_key)


def open_data_key(sealing_private: bytes, sealed_key: bytes) -> bytes:
    """Open `seal_data_key`. Raises ENVELOPE_INVALID."""
    if len(sealed_key) != SEALED_KEY_BYTES:
        raise BlockRobotError("ENVELOPE_INVALID", f"A sealed key has {len(sealed_key)} bytes instead of 80.")
    return open_sealed(sealing_private, sealed_key)


def seal_metadata(sealing_public: bytes, plaintext: bytes) -> bytes:
    """Seal metadata to its owner, always 560 bytes. Raises UPLOAD_INVALID."""
    return seal_to(sealing_public, pad_to(plaintext, SEALED_METADATA_BYTES - SEALED_BOX_OVERHEAD_BYTES))


def open_metadata(sealing_private: bytes, sealed: bytes) -> bytes:
    """Open `seal_metadata`. Raises ENVELOPE_INVALID."""
    if len(sealed) != SEALED_METADATA_BYTES:
        raise BlockRobotError("ENVELOPE_INVALID", f"Sealed metadata has {len(sealed)} bytes instead of 560.")
    return unpad_from(open_sealed(sealing_private, sealed))


def derive_box_key(sealing_private: bytes, sealed: bytes) -> bytes:
    """Return a sealed box's 32-byte key, which opens no other. Raises ENVELOPE_INVALID."""
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
    nonce = hashlib.blake2b(one_time + sealing_public, digest_size=_BOX_NONCE_BYTES).digest()
    try:
        padded: bytes = crypto_box_open_afternm(sealed[SEALING_KEY_BYTES:], nonce, box_key)
    except CryptoError:
        raise BlockRobotError("ENVELOPE_INVALID") from None
    return unpad_from(padded)

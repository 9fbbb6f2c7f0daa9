"""Passphrase encryption: Argon2id (RFC 9106), XChaCha20-Poly1305. A checksum tells damage from a wrong passphrase."""

from __future__ import annotations

import secrets
import unicodedata
from dataclasses import dataclass

import msgspec
from nacl import pwhash
from nacl.bindings import (
    crypto_aead_xchacha20poly1305_ietf_decrypt,
    crypto_aead_xchacha20poly1305_ietf_encrypt,
)
from nacl.exceptions import CryptoError

from consensus.primitives.hashing import tagged_hash

# No file of ours asks for more; a forged file must not make the machine work for hours or run out of memory.
OPERATIONS_MAX_COUNT = 16
MEMORY_MAX_BYTES = pwhash.argon2id.MEMLIMIT_SENSITIVE
_SALT_BYTES = pwhash.argon2id.SALTBYTES
_NONCE_BYTES = 24
_KEY_BYTES = 32


class SealedFileError(ValueError):
    """Invalid sealed file; the argument is `changed`, `no_file`, or `work` (costs)."""


class PassphraseError(ValueError):
    """The passphrase does not open the file."""


@dataclass(frozen=True, slots=True)
class PassphraseCost:
    """Argon2id cost per passphrase guess; stored in the file."""

    operations_count: int = pwhash.argon2id.OPSLIMIT_MODERATE
    memory_bytes: int = pwhash.argon2id.MEMLIMIT_MODERATE


@dataclass(frozen=True, slots=True)
class SealFormat:
    """A sealed file's format: header magic and checksum tag."""

    magic: bytes
    checksum_tag: str


@dataclass(frozen=True, slots=True, repr=False)
class SealingKey:
    """A key derived from a passphrase, and its header."""

    header: bytes
    secret: bytes
    format: SealFormat

    def seal(self, content: bytes) -> bytes:
        """With a fresh nonce."""
        nonce = secrets.token_bytes(_NONCE_BYTES)
        sealed = crypto_aead_xchacha20poly1305_ietf_encrypt(content, self.header, nonce, self.secret)
        checksum = tagged_hash(self.format.checksum_tag, self.header, nonce, sealed)
        return msgspec.msgpack.encode((self.header, nonce, sealed, checksum))

    @property
    def is_cheap(self) -> bool:
        """A guess costs less than today's default."""
        _, cost = _read_header(self.header, self.format)
        least = PassphraseCost()
        return cost.operations_count < least.operations_count or cost.memory_bytes < least.memory_bytes

    def is_from(self, passphrase: str) -> bool:
        """This costs a full derivation."""
        salt, cost = _read_header(self.header, self.format)
        return secrets.compare_digest(_derive(passphrase, salt, cost), self.secret)


def new_sealing_key(passphrase: str, seal_format: SealFormat, cost: PassphraseCost | None = None) -> SealingKey:
    """With a fresh salt."""
    cost = cost or PassphraseCost()
    salt = secrets.token_bytes(_SALT_BYTES)
    header = seal_format.magic + msgspec.msgpack.encode([salt, cost.operations_count, cost.memory_bytes])
    return SealingKey(header, _derive(passphrase, salt, cost), seal_format)


def open_sealed(data: bytes, passphrase: str, seal_format: SealFormat) -> tuple[bytes, SealingKey]:
    """Return the content and the key for resealing. Raises SealedFileError, PassphraseError."""
    try:
        header, nonce, sealed, checksum = msgspec.msgpack.decode(data, type=tuple[bytes, bytes, bytes, bytes])
    except msgspec.MsgspecError:
        raise SealedFileError("no_file") from None
    if tagged_hash(seal_format.checksum_tag, header, nonce, sealed) != checksum:
        raise SealedFileError("changed")
    salt, cost = _read_header(header, seal_format)
    key = _derive(passphrase, salt, cost)
    try:
        content = crypto_aead_xchacha20poly1305_ietf_decrypt(sealed, header, nonce, key)
    except (CryptoError, ValueError, TypeError):
        raise PassphraseError("the passphrase does not open the file") from None
    return content, SealingKey(header, key, seal_format)


def _read_header(header: bytes, seal_format: SealFormat) -> tuple[bytes, PassphraseCost]:
    if not header.startswith(seal_format.magic):
        raise SealedFileError("changed")
    try:
        salt, operations, memory = msgspec.msgpack.decode(header[len(seal_format.magic) :], type=tuple[bytes, int, int])
    except msgspec.MsgspecError:
        raise SealedFileError("no_file") from None
    if (
        len(salt) != _SALT_BYTES
        or not pwhash.argon2id.OPSLIMIT_MIN <= operations <= OPERATIONS_MAX_COUNT
        or not pwhash.argon2id.MEMLIMIT_MIN <= memory <= MEMORY_MAX_BYTES
    ):
        raise SealedFileError("work")
    return salt, PassphraseCost(operations, memory)


def _derive(passphrase: str, salt: bytes, cost: PassphraseCost) -> bytes:
    # Keyboards and systems encode one letter in several ways (NIST SP 800-63B-4, 3.1.1.2).
    normal = unicodedata.normalize("NFC", passphrase).encode()
    return bytes(
        pwhash.argon2id.kdf(_KEY_BYTES, normal, salt, opslimit=cost.operations_count, memlimit=cost.memory_bytes)
    )

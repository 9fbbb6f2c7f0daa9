"""The wallet on disk: one encrypted file, written whole or not at all. Must never write a secret in the clear.

Argon2id turns the passphrase into a key; XChaCha20-Poly1305 seals the content, which is everything: the words, what the
wallet knows of its visits (itself sensitive: it says where somebody was), and the newest verified header.
"""

from __future__ import annotations

import os
import secrets
import tempfile
from dataclasses import dataclass
from pathlib import Path

import msgspec
from nacl import pwhash
from nacl.bindings import (
    crypto_aead_xchacha20poly1305_ietf_decrypt,
    crypto_aead_xchacha20poly1305_ietf_encrypt,
)
from nacl.exceptions import CryptoError

from consensus.errors import BlockRobotError

_MAGIC = b"BRWALLET1"
_SALT_BYTES = pwhash.argon2id.SALTBYTES
_NONCE_BYTES = 24
_KEY_BYTES = 32
WALLET_FILE_MAX_BYTES = 64 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class PassphraseCost:
    """How dear one guess of the passphrase is (Argon2id, RFC 9106). Both values are stored in the file."""

    operations_count: int = pwhash.argon2id.OPSLIMIT_MODERATE
    memory_bytes: int = pwhash.argon2id.MEMLIMIT_MODERATE


class KnownVisit(msgspec.Struct):
    """A visit that the wallet found to be its own: what is needed to derive its owner key again."""

    owner: bytes
    ephemeral: bytes
    robot: bytes
    sequence: int
    bucket_ms: int


class WalletContent(msgspec.Struct):
    """What the file holds, decrypted."""

    words: str
    handle: bytes = b""
    role: str = ""
    visits: list[KnownVisit] = msgspec.field(default_factory=list)
    scanned_count: int = 0
    pinned_header: bytes = b""
    asked_erasures: list[bytes] = msgspec.field(default_factory=list)


def _derive_key(passphrase: str, salt: bytes, cost: PassphraseCost) -> bytes:
    return bytes(
        pwhash.argon2id.kdf(
            _KEY_BYTES, passphrase.encode(), salt, opslimit=cost.operations_count, memlimit=cost.memory_bytes
        )
    )


def _write_whole(path: Path, data: bytes) -> None:
    """Write beside, sync, rename, sync the folder: after a power cut the old file or the new one is there."""
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=".wallet-")
    try:
        os.fchmod(descriptor, 0o600)
        with os.fdopen(descriptor, "wb") as handle:
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


class Keystore:
    """An open wallet file. `save` seals with a fresh nonce under the key that opened it."""

    def __init__(self, path: Path, key: bytes, header: bytes, content: WalletContent) -> None:
        self._path = path
        self._key = key
        self._header = header
        self.content = content

    def __repr__(self) -> str:
        return f"Keystore({self._path})"

    @classmethod
    def create(cls, path: Path, words: str, passphrase: str, cost: PassphraseCost | None = None) -> Keystore:
        """Make a new wallet file, mode 0600. Raises WALLET_EXISTS rather than overwrite one."""
        if path.exists():
            raise BlockRobotError("WALLET_EXISTS", f"There is already a wallet at {path}.")
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        cost = cost or PassphraseCost()
        salt = secrets.token_bytes(_SALT_BYTES)
        header = _MAGIC + msgspec.msgpack.encode([salt, cost.operations_count, cost.memory_bytes])
        store = cls(path, _derive_key(passphrase, salt, cost), header, WalletContent(words=words))
        store.save()
        return store

    @classmethod
    def open(cls, path: Path, passphrase: str) -> Keystore:
        """Open a wallet file. Raises WALLET_NOT_FOUND, WALLET_DAMAGED or WALLET_PASSPHRASE_WRONG."""
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            raise BlockRobotError("WALLET_NOT_FOUND", f"There is no wallet at {path}.") from None
        if len(data) > WALLET_FILE_MAX_BYTES:
            raise BlockRobotError("WALLET_DAMAGED", f"{path} is too large to be a wallet.")
        try:
            header, nonce, sealed = msgspec.msgpack.decode(data, type=tuple[bytes, bytes, bytes])
            if not header.startswith(_MAGIC):
                raise ValueError("not a wallet")
            salt, operations, memory = msgspec.msgpack.decode(header[len(_MAGIC) :], type=tuple[bytes, int, int])
            key = _derive_key(passphrase, salt, PassphraseCost(operations, memory))
        except (msgspec.MsgspecError, ValueError, TypeError):
            raise BlockRobotError("WALLET_DAMAGED", f"{path} is not a wallet file.") from None
        try:
            plain = crypto_aead_xchacha20poly1305_ietf_decrypt(sealed, header, nonce, key)
        except (CryptoError, ValueError, TypeError):
            raise BlockRobotError("WALLET_PASSPHRASE_WRONG") from None
        return cls(path, key, header, msgspec.msgpack.decode(plain, type=WalletContent))

    def save(self) -> None:
        """Seal the content and replace the file in one step."""
        nonce = secrets.token_bytes(_NONCE_BYTES)
        plain = msgspec.msgpack.encode(self.content)
        sealed = crypto_aead_xchacha20poly1305_ietf_encrypt(plain, self._header, nonce, self._key)
        _write_whole(self._path, msgspec.msgpack.encode((self._header, nonce, sealed)))

"""The wallet on disk: one encrypted file, written whole or not at all. Must never write a secret in the clear.

Argon2id turns the passphrase into a key; XChaCha20-Poly1305 seals the content, which is everything: the words, what the
wallet knows of its visits (itself sensitive: it says where somebody was), and the newest verified header. A checksum of
the sealed bytes tells a damaged file from a wrong passphrase.
"""

from __future__ import annotations

import contextlib
import hmac
import logging
import os
import secrets
import tempfile
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from nacl import pwhash
from nacl.bindings import (
    crypto_aead_xchacha20poly1305_ietf_decrypt,
    crypto_aead_xchacha20poly1305_ietf_encrypt,
)
from nacl.exceptions import CryptoError

from clients.wallet.guardians import GuardianSet
from clients.wallet.language import refusal
from clients.wallet.sharing_memory import GivenGrant, ReceivedGrant
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import tagged_hash
from consensus.records.rights import Correction

_log = logging.getLogger(__name__)

_MAGIC = b"BRWALLET1"
_SALT_BYTES = pwhash.argon2id.SALTBYTES
_NONCE_BYTES = 24
_KEY_BYTES = 32
_CHECKSUM_TAG = "blockrobot/wallet-file"
# No wallet of ours asks for more; a forged file must not make the machine work for hours or run out of memory.
OPERATIONS_MAX_COUNT = 16
MEMORY_MAX_BYTES = pwhash.argon2id.MEMLIMIT_SENSITIVE
WALLET_FILE_MAX_BYTES = 64 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class PassphraseCost:
    """How dear one guess of the passphrase is (Argon2id, RFC 9106). Both values are stored in the file."""

    operations_count: int = pwhash.argon2id.OPSLIMIT_MODERATE
    memory_bytes: int = pwhash.argon2id.MEMLIMIT_MODERATE


class KnownVisit(msgspec.Struct):
    """A visit that the wallet found to be its own: what is needed to derive its owner key again.

    `owner` is the visit's first key, its name on the chain; `current`, if it was transferred, the key that decides of it
    now. `ephemeral` and `era` (which words, counted from the wallet's first) belong to the key that decides. `taken`: it
    was transferred to a key that none of the wallet's words lead to. `stuck`: the chain lets nobody transfer it any more.
    """

    owner: bytes
    ephemeral: bytes
    robot: bytes
    sequence: int
    bucket_ms: int
    current: bytes = b""
    era: int = 0
    taken: bool = False
    stuck: bool = False


class WalletContent(msgspec.Struct):
    """What the file holds, decrypted.

    `former` are words that were replaced, oldest first: what was sealed to their keys opens with nothing else.
    `next_words` are to replace the present ones; they are kept here before anything is signed with them. `leaving` are the
    transactions by which she meant to leave; that she `left` is noted once one of them is proven to have succeeded.
    """

    words: str
    handle: bytes = b""
    role: str = ""
    visits: list[KnownVisit] = msgspec.field(default_factory=list)
    scanned_count: int = 0
    pin: bytes = b""
    asked_erasures: list[bytes] = msgspec.field(default_factory=list)
    corrections: list[Correction] = msgspec.field(default_factory=list)
    given_grants: list[GivenGrant] = msgspec.field(default_factory=list)
    received_grants: list[ReceivedGrant] = msgspec.field(default_factory=list)
    scanned_grants_count: int = 0
    receipts: list[bytes] = msgspec.field(default_factory=list)
    receipts_due: list[bytes] = msgspec.field(default_factory=list)
    notice_shown_version: int = 0
    notice_consented_version: int = 0
    former: list[str] = msgspec.field(default_factory=list)
    next_words: str = ""
    next_words_shown: bool = False
    transfers_due: bool = False
    left: bool = False
    leaving: list[bytes] = msgspec.field(default_factory=list)
    guardian_sets: list[GuardianSet] = msgspec.field(default_factory=list)

    def __repr__(self) -> str:
        return f"WalletContent({len(self.visits)} visits)"


def _encode(passphrase: str) -> list[bytes]:
    """Return what a key may come from: the passphrase with its accents in one form, then as typed if that is another.

    Keyboards and systems encode one letter in several ways (NIST SP 800-63B-4, 3.1.1.2). Files that were made before this
    was seen to have their key from the bytes that were typed.
    """
    normal = unicodedata.normalize("NFC", passphrase).encode()
    typed = passphrase.encode()
    return [normal] if typed == normal else [normal, typed]


def _derive_key(encoded: bytes, salt: bytes, cost: PassphraseCost) -> bytes:
    return bytes(
        pwhash.argon2id.kdf(_KEY_BYTES, encoded, salt, opslimit=cost.operations_count, memlimit=cost.memory_bytes)
    )


def _unseal(parts: tuple[bytes, bytes, bytes, PassphraseCost, bytes], passphrase: str) -> tuple[bytes, bytes]:
    """Return the content and the key that opened it. Raises WALLET_PASSPHRASE_WRONG."""
    header, nonce, sealed, cost, salt = parts
    for encoded in _encode(passphrase):
        key = _derive_key(encoded, salt, cost)
        with contextlib.suppress(CryptoError, ValueError, TypeError):
            return crypto_aead_xchacha20poly1305_ietf_decrypt(sealed, header, nonce, key), key
    raise BlockRobotError("WALLET_PASSPHRASE_WRONG")


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


def _read_parts(path: Path, data: bytes) -> tuple[bytes, bytes, bytes, PassphraseCost, bytes]:
    """Return header, nonce, sealed content, cost and salt. Raises WALLET_DAMAGED."""
    try:
        header, nonce, sealed, checksum = msgspec.msgpack.decode(data, type=tuple[bytes, bytes, bytes, bytes])
        if not header.startswith(_MAGIC) or tagged_hash(_CHECKSUM_TAG, header, nonce, sealed) != checksum:
            raise refusal("WALLET_DAMAGED", "wallet_changed", path=str(path))
        salt, operations, memory = msgspec.msgpack.decode(header[len(_MAGIC) :], type=tuple[bytes, int, int])
    except msgspec.MsgspecError:
        raise refusal("WALLET_DAMAGED", "wallet_no_file", path=str(path)) from None
    if (
        len(salt) != _SALT_BYTES
        or not pwhash.argon2id.OPSLIMIT_MIN <= operations <= OPERATIONS_MAX_COUNT
        or not pwhash.argon2id.MEMLIMIT_MIN <= memory <= MEMORY_MAX_BYTES
    ):
        raise refusal("WALLET_DAMAGED", "wallet_work", path=str(path))
    return header, nonce, sealed, PassphraseCost(operations, memory), salt


class Keystore:
    """An open wallet file. `save` seals with a fresh nonce under the key that opened it."""

    def __init__(self, path: Path, key: bytes, header: bytes, content: WalletContent) -> None:
        self._path = path
        self._key = key
        self._header = header
        self._is_read_only = False
        self.content = content

    def __repr__(self) -> str:
        return f"Keystore({self._path})"

    @classmethod
    def create(
        cls, path: Path, words: str, passphrase: str, cost: PassphraseCost | None = None, *, former: Sequence[str] = ()
    ) -> Keystore:
        """Make a new wallet file, mode 0600. `former` are words that were replaced, oldest first.

        Raises WALLET_EXISTS rather than overwrite one.
        """
        if path.exists():
            raise refusal("WALLET_EXISTS", "wallet_exists", path=str(path))
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        cost = cost or PassphraseCost()
        salt = secrets.token_bytes(_SALT_BYTES)
        header = _MAGIC + msgspec.msgpack.encode([salt, cost.operations_count, cost.memory_bytes])
        key = _derive_key(_encode(passphrase)[0], salt, cost)
        store = cls(path, key, header, WalletContent(words=words, former=list(former)))
        store.save()
        return store

    @classmethod
    def open(cls, path: Path, passphrase: str) -> Keystore:
        """Open a wallet file. Raises WALLET_NOT_FOUND, WALLET_DAMAGED or WALLET_PASSPHRASE_WRONG."""
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            raise refusal("WALLET_NOT_FOUND", "wallet_not_found", path=str(path)) from None
        if len(data) > WALLET_FILE_MAX_BYTES:
            raise refusal("WALLET_DAMAGED", "wallet_large", path=str(path))
        parts = _read_parts(path, data)
        plain, key = _unseal(parts, passphrase)
        try:
            content = msgspec.msgpack.decode(plain, type=WalletContent)
        except msgspec.MsgspecError:
            raise refusal("WALLET_DAMAGED", "wallet_version", path=str(path)) from None
        return cls(path, key, parts[0], content)

    def opens_with(self, passphrase: str) -> bool:
        """Tell whether this passphrase opens the file. As dear as opening it."""
        salt, operations, memory = msgspec.msgpack.decode(self._header[len(_MAGIC) :], type=tuple[bytes, int, int])
        cost = PassphraseCost(operations, memory)
        return any(hmac.compare_digest(_derive_key(one, salt, cost), self._key) for one in _encode(passphrase))

    def read_only(self) -> None:
        """Write nothing from now on: another program has the file, and what it notes would be lost."""
        self._is_read_only = True

    def save(self) -> None:
        """Seal the content and replace the file in one step, unless it is only read: then it is logged that it was not."""
        if self._is_read_only:
            _log.info("The wallet is read beside another program: what was to be noted in it is dropped.")
            return
        nonce = secrets.token_bytes(_NONCE_BYTES)
        plain = msgspec.msgpack.encode(self.content)
        sealed = crypto_aead_xchacha20poly1305_ietf_encrypt(plain, self._header, nonce, self._key)
        checksum = tagged_hash(_CHECKSUM_TAG, self._header, nonce, sealed)
        _write_whole(self._path, msgspec.msgpack.encode((self._header, nonce, sealed, checksum)))

"""The robot's small encrypted files, written atomically and bound to their names."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from nacl.bindings import (
    crypto_aead_xchacha20poly1305_ietf_decrypt,
    crypto_aead_xchacha20poly1305_ietf_encrypt,
)
from nacl.exceptions import CryptoError

from consensus.errors import BlockRobotError

TEMPORARY_PREFIX = ".tmp-"
_NONCE_BYTES = 24


def seal_content(name: str, key: bytes, content: bytes) -> bytes:
    nonce = secrets.token_bytes(_NONCE_BYTES)
    return nonce + crypto_aead_xchacha20poly1305_ietf_encrypt(content, name.encode(), nonce, key)


def read_sealed(path: Path, key: bytes) -> bytes:
    """Raises SPOOL_DAMAGED."""
    try:
        data = path.read_bytes()
        return crypto_aead_xchacha20poly1305_ietf_decrypt(
            data[_NONCE_BYTES:], path.name.encode(), data[:_NONCE_BYTES], key
        )
    except OSError as error:
        raise BlockRobotError("SPOOL_DAMAGED", f"The sealed file {path.name} is gone: {error.strerror}.") from None
    except (CryptoError, ValueError, TypeError):
        raise BlockRobotError("SPOOL_DAMAGED", f"The sealed file {path.name} was changed on disk.") from None


def write_durably(path: Path, data: bytes) -> None:
    """Replace atomically, user-only. Raises SPOOL_FULL."""
    temporary = path.with_name(TEMPORARY_PREFIX + path.name)
    try:
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
            os.fchmod(file.fileno(), 0o600)  # a leftover of a crash keeps its old mode
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise BlockRobotError("SPOOL_FULL", f"The sealed file could not be written: {error.strerror}.") from None
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """So that renames and removals survive power loss."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

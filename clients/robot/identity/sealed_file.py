"""The robot's small encrypted files, written atomically and bound to their names."""

from __future__ import annotations

import secrets
from pathlib import Path

from nacl.bindings import (
    crypto_aead_xchacha20poly1305_ietf_decrypt,
    crypto_aead_xchacha20poly1305_ietf_encrypt,
)
from nacl.exceptions import CryptoError

from clients.sdk.new_files import replace_file
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
    try:
        replace_file(path, data, temporary=path.with_name(TEMPORARY_PREFIX + path.name))
    except OSError as error:
        raise BlockRobotError("SPOOL_FULL", f"The sealed file could not be written: {error.strerror}.") from None

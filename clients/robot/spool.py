"""The robot's spool: sealed clips on disk until their records are final. Must never hold a picture or a raw frame.

One file a clip, encrypted under the robot's spool key (the sealed clip alone would still tell when and how much was
recorded), written whole or not at all: temporary file, sync, rename, sync of the folder. A robot that is killed at any
moment finds each clip there once or not at all, and delivers it again; delivery is idempotent.
"""

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
from consensus.primitives.encoding import Wire, decode, encode
from consensus.records.clips import ClipUpload

SPOOL_MAX_BYTES = 1024 * 1024 * 1024
_NONCE_BYTES = 24
_SUFFIX = ".clip"


class SpooledClip(Wire, frozen=True):
    """A sealed clip and what its record will say. The transaction is signed at delivery, since it expires.

    `owner` is the visit's owner key; with `ephemeral`, `view_tag` and `purpose` it can still be announced after a
    restart. `decided_at_ms` is when the clip's last frame was decided.
    """

    upload: ClipUpload
    owner: bytes
    ephemeral: bytes
    view_tag: int
    purpose: str
    visit_bucket_ms: int
    commitment_root: bytes
    ciphertext_root: bytes
    sealed_metadata: bytes
    bucket_ms: int
    expires_at_ms: int
    frame_count: int
    decided_at_ms: int


class Spool:
    """A folder of sealed clips, oldest first."""

    def __init__(self, folder: Path, key: bytes, *, max_bytes: int = SPOOL_MAX_BYTES) -> None:
        self._folder = folder
        self._key = key
        self._max_bytes = max_bytes
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        for leftover in folder.glob(".tmp-*"):
            leftover.unlink()
        waiting = (path for path in folder.glob(f"*{_SUFFIX}") if path.stem.isdecimal())
        self._sizes = {path.name: path.stat().st_size for path in waiting}
        self._next = max((int(name.split(".")[0]) for name in self._sizes), default=0) + 1

    @property
    def size_bytes(self) -> int:
        """The bytes on disk of all waiting clips."""
        return sum(self._sizes.values())

    def names(self) -> list[str]:
        """Return the names of the waiting clips, oldest first."""
        return sorted(self._sizes)

    def put(self, clip: SpooledClip) -> str:
        """Store a clip durably and return its name. Raises SPOOL_FULL; nothing is half-written then."""
        nonce = secrets.token_bytes(_NONCE_BYTES)
        name = f"{self._next:012d}{_SUFFIX}"
        sealed = nonce + crypto_aead_xchacha20poly1305_ietf_encrypt(encode(clip), name.encode(), nonce, self._key)
        if self.size_bytes + len(sealed) > self._max_bytes:
            raise BlockRobotError("SPOOL_FULL", f"The spool holds {self.size_bytes} bytes already.")
        temporary = self._folder / f".tmp-{name}"
        try:
            with temporary.open("wb") as file:
                file.write(sealed)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self._folder / name)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise BlockRobotError("SPOOL_FULL", f"The clip could not be written: {error.strerror}.") from None
        self._sync_folder()
        self._sizes[name] = len(sealed)
        self._next += 1
        return name

    def get(self, name: str) -> SpooledClip:
        """Read a clip. Raises SPOOL_DAMAGED if it was changed or is another's."""
        try:
            data = (self._folder / name).read_bytes()
            plain = crypto_aead_xchacha20poly1305_ietf_decrypt(
                data[_NONCE_BYTES:], name.encode(), data[:_NONCE_BYTES], self._key
            )
            return decode(plain, SpooledClip)
        except OSError as error:
            raise BlockRobotError("SPOOL_DAMAGED", f"The spooled clip {name} is gone: {error.strerror}.") from None
        except (CryptoError, ValueError, TypeError, BlockRobotError):
            raise BlockRobotError("SPOOL_DAMAGED", f"The spooled clip {name} was changed on disk.") from None

    def remove(self, name: str) -> None:
        """Forget a delivered clip."""
        (self._folder / name).unlink(missing_ok=True)
        self._sizes.pop(name, None)

    def _sync_folder(self) -> None:
        descriptor = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

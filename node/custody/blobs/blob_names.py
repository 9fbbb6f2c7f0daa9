"""Names of clips' blobs, which tell the blob store nothing.

A name is the record's id, encrypted and authenticated by a key of this custodian (AES-SIV, RFC 5297), and a generation:
whoever writes the record anew writes another blob. What another key named is not this custodian's.
"""

from __future__ import annotations

import re
import secrets

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESSIV

from consensus.primitives.hashing import sha256

KEY_BYTES = 32
GENERATION_BYTES = 8

_NAME = re.compile(r"([0-9a-f]{2})/([0-9a-f]{2})/([0-9a-f]{60})-([0-9a-f]{16})")


class BlobNames:
    """Raises ValueError for a key that has not 32 bytes."""

    def __init__(self, key: bytes) -> None:
        self._cipher = AESSIV(key)
        self.owner = sha256(b"blockrobot/blob-names" + key)[:16].hex()
        """Tells custodians that use one place apart."""

    def prefix(self, record_id: bytes) -> str:
        """Of every generation of a record's blob."""
        text = self._cipher.encrypt(record_id, None).hex()
        return f"{text[:2]}/{text[2:4]}/{text[4:]}-"

    def name(self, record_id: bytes, generation: bytes) -> str:
        return self.prefix(record_id) + generation.hex()

    def read(self, name: str) -> tuple[bytes, bytes] | None:
        """Return record id and generation; None: not this custodian's."""
        found = _NAME.fullmatch(name)
        if found is None:
            return None
        try:
            record_id = self._cipher.decrypt(bytes.fromhex("".join(found.group(1, 2, 3))), None)
        except InvalidTag:
            return None
        return record_id, bytes.fromhex(found.group(4))


def new_generation() -> bytes:
    return secrets.token_bytes(GENERATION_BYTES)

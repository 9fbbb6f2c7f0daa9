"""Checked signatures, remembered. Must never answer for bytes that it did not check.

The votes of a certificate usually arrived one by one before it, and the certificate comes again in timeouts and
notices: each signature is checked once. The simulator shares one cache between its nodes.
"""

from __future__ import annotations

from typing import Protocol

from consensus.limits import SIGNATURE_CACHE_MAX_COUNT
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import verify


class SignatureCheck(Protocol):
    """Tells whether a 64-byte signature over tagged_hash(tag, *parts) was made by `public_key`: `keys.verify`."""

    def __call__(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
        """Return True for a genuine signature."""
        ...


class SignatureCache:
    """A bounded memory around `keys.verify`; calling it is a `SignatureCheck`. The oldest answers go first."""

    def __init__(self, max_count: int = SIGNATURE_CACHE_MAX_COUNT) -> None:
        self._max_count = max_count
        self._genuine: dict[tuple[bytes, bytes, bytes], None] = {}

    def __call__(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
        """Return True for a genuine signature. Only genuine ones are remembered: forgeries cannot fill the memory."""
        fingerprint = (public_key, signature, tagged_hash(tag, *parts))
        if fingerprint in self._genuine:
            return True
        if not verify(public_key, tag, signature, *parts):
            return False
        while len(self._genuine) >= self._max_count:
            del self._genuine[next(iter(self._genuine))]
        self._genuine[fingerprint] = None
        return True

    def __len__(self) -> int:
        return len(self._genuine)

"""A cache of verified signatures; each is checked once."""

from __future__ import annotations

from typing import Protocol

from consensus.limits import SIGNATURE_CACHE_MAX_COUNT
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import verify


class SignatureCheck(Protocol):
    """Verify a 64-byte signature over tagged_hash(tag, *parts), as `keys.verify`."""

    def __call__(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool: ...


class SignatureCache:
    """A bounded `SignatureCheck` cache around `keys.verify`; oldest entries go first."""

    def __init__(self, max_count: int = SIGNATURE_CACHE_MAX_COUNT) -> None:
        self._max_count = max_count
        self._genuine: dict[tuple[bytes, bytes, bytes], None] = {}

    def __call__(self, public_key: bytes, tag: str, signature: bytes, *parts: bytes) -> bool:
        """Verify; only genuine signatures are cached, so forgeries cannot fill it."""
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

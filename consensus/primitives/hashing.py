"""SHA-256 and tagged hashes (BIP-340 style)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from typing import Any

HASH_SIZE_BYTES = 32


def sha256(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()


@lru_cache(maxsize=256)
def _tag_state(tag: str) -> Any:
    digest = sha256(tag.encode())
    return hashlib.sha256(digest + digest)


def tagged_hasher(tag: str) -> Callable[[bytes], bytes]:
    begin = _tag_state(tag).copy

    def hash_part(part: bytes) -> bytes:
        state = begin()
        state.update(part)
        digest: bytes = state.digest()
        return digest

    return hash_part


def tagged_hash(tag: str, *parts: bytes) -> bytes:
    """Return SHA256(SHA256(tag) || SHA256(tag) || parts...), 32 bytes (BIP-340).

    Parts are concatenated: pass at most one of variable length, last.
    """
    state = _tag_state(tag).copy()
    for part in parts:
        state.update(part)
    result: bytes = state.digest()
    return result

"""Stateless session challenges.

Expiry, nonce and a MAC over both and the key; only used ones are remembered, until expiry.
"""

from __future__ import annotations

import hmac
import secrets

from consensus.chain.session_message import CHALLENGE_SIZE_BYTES
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u64
from node.api.ports import Clock

CHALLENGE_LIFETIME_MS = 60_000
USED_OF_KEY_MAX_COUNT = 256
_NONCE_BYTES = 8
_CODE_BYTES = 16
_SECRET_BYTES = 32
assert 8 + _NONCE_BYTES + _CODE_BYTES == CHALLENGE_SIZE_BYTES


class ChallengeBook:
    """Makes challenges and checks them."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._secret = secrets.token_bytes(_SECRET_BYTES)
        self._used: dict[bytes, dict[bytes, int]] = {}

    def issue(self, public_key: bytes) -> tuple[bytes, int]:
        """32 bytes, and its expiry in ms."""
        expires_at_ms = self._clock.now_ms() + CHALLENGE_LIFETIME_MS
        head = u64(expires_at_ms) + secrets.token_bytes(_NONCE_BYTES)
        return head + self._code(head, public_key), expires_at_ms

    def require(self, public_key: bytes, challenge: bytes) -> None:
        """Raises CHALLENGE_INVALID unless it is this key's, in time and unused; RATE_LIMITED for too many sessions."""
        head, code = challenge[: 8 + _NONCE_BYTES], challenge[8 + _NONCE_BYTES :]
        if not hmac.compare_digest(code, self._code(head, public_key)):
            raise BlockRobotError("CHALLENGE_INVALID")
        now_ms = self._clock.now_ms()
        used = self._used.get(public_key, {})
        if int.from_bytes(head[:8], "big") <= now_ms or challenge in used:
            raise BlockRobotError("CHALLENGE_INVALID")
        if sum(ends_ms > now_ms for ends_ms in used.values()) >= USED_OF_KEY_MAX_COUNT:
            raise BlockRobotError("RATE_LIMITED", "This key opened too many sessions within a minute.")

    def use_up(self, public_key: bytes, challenge: bytes) -> None:
        now_ms = self._clock.now_ms()
        self._used.setdefault(public_key, {})[challenge] = int.from_bytes(challenge[:8], "big")
        for key, used in list(self._used.items()):
            for old in [old for old, ends_ms in used.items() if ends_ms <= now_ms]:
                del used[old]
            if not used:
                del self._used[key]

    def _code(self, head: bytes, public_key: bytes) -> bytes:
        return hmac.digest(self._secret, head + public_key, "sha256")[:_CODE_BYTES]

"""Sessions: a client proves its key once and gets a short-lived token. Must never log, store or return a token twice.

Tokens are kept as hashes only. Both tables are bounded; when one is full, the oldest entries make room, so a flood
of challenges costs its sender's own challenges and no memory.
"""

from __future__ import annotations

import secrets
from collections import OrderedDict
from dataclasses import dataclass

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import is_public_key
from consensus.session import CHALLENGE_SIZE_BYTES, verify_session
from node.api.services import Clock, LedgerReader
from node.api.standing import SessionKind, Standing, find_standing

CHALLENGE_LIFETIME_MS = 60_000
SESSION_LIFETIME_MS = 10 * 60_000
CHALLENGES_MAX_COUNT = 4096
SESSIONS_MAX_COUNT = 4096
TOKEN_SIZE_BYTES = 32


@dataclass(frozen=True, slots=True)
class Session:
    """One proven key. `roles` are those of the key when it was last looked up."""

    public_key: bytes
    kind: SessionKind
    roles: frozenset[str]
    expires_at_ms: int


class SessionTable:
    """The open challenges and sessions of one node."""

    def __init__(self, chain_id: bytes, node_name: str, clock: Clock, ledger: LedgerReader) -> None:
        self._chain_id = chain_id
        self._node_name = node_name
        self._clock = clock
        self._ledger = ledger
        self._challenges: OrderedDict[bytes, tuple[bytes, int]] = OrderedDict()
        self._sessions: OrderedDict[bytes, tuple[bytes, int]] = OrderedDict()

    def challenge(self, public_key: bytes) -> tuple[bytes, int]:
        """Return a fresh single-use challenge (32 bytes) for this key and when it ends. Raises KEY_INVALID."""
        if not is_public_key(public_key):
            raise BlockRobotError("KEY_INVALID", "The public key is not a compressed point of secp256k1.")
        challenge = secrets.token_bytes(CHALLENGE_SIZE_BYTES)
        expires_at_ms = self._clock.now_ms() + CHALLENGE_LIFETIME_MS
        self._challenges[challenge] = (public_key, expires_at_ms)
        while len(self._challenges) > CHALLENGES_MAX_COUNT:
            self._challenges.popitem(last=False)
        return challenge, expires_at_ms

    def open(self, public_key: bytes, challenge: bytes, signature: bytes) -> tuple[bytes, Session]:
        """Answer a challenge and return a new token (32 bytes) with its session.

        The challenge is used up whatever the outcome. Raises CHALLENGE_INVALID, SIGNATURE_*, SESSION_REFUSED.
        """
        known = self._challenges.pop(challenge, None)
        if known is None or known[0] != public_key or known[1] <= self._clock.now_ms():
            raise BlockRobotError("CHALLENGE_INVALID")
        verify_session(public_key, signature, self._chain_id, self._node_name, challenge)
        standing = self._standing(public_key)
        if standing is None:
            raise BlockRobotError("SESSION_REFUSED")
        token = secrets.token_bytes(TOKEN_SIZE_BYTES)
        expires_at_ms = self._clock.now_ms() + SESSION_LIFETIME_MS
        self._sessions[sha256(token)] = (public_key, expires_at_ms)
        while len(self._sessions) > SESSIONS_MAX_COUNT:
            self._sessions.popitem(last=False)
        return token, _session(public_key, standing, expires_at_ms)

    def resolve(self, token: bytes) -> Session:
        """Return the session behind a token, with the key's standing as it is now on the finalized state.

        Raises SESSION_EXPIRED, or SESSION_REFUSED if the key has lost its standing since.
        """
        digest = sha256(token)
        known = self._sessions.get(digest)
        if known is None:
            raise BlockRobotError("SESSION_EXPIRED")
        public_key, expires_at_ms = known
        if expires_at_ms <= self._clock.now_ms():
            del self._sessions[digest]
            raise BlockRobotError("SESSION_EXPIRED")
        standing = self._standing(public_key)
        if standing is None:
            del self._sessions[digest]
            raise BlockRobotError("SESSION_REFUSED")
        return _session(public_key, standing, expires_at_ms)

    def close(self, token: bytes) -> None:
        """Forget a session; an unknown token is no error."""
        self._sessions.pop(sha256(token), None)

    def _standing(self, public_key: bytes) -> Standing | None:
        with self._ledger.snapshot() as snapshot:
            return find_standing(snapshot, public_key)


def _session(public_key: bytes, standing: Standing, expires_at_ms: int) -> Session:
    return Session(public_key=public_key, kind=standing.kind, roles=standing.roles, expires_at_ms=expires_at_ms)

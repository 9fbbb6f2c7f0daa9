"""Sessions: a client proves its key once and gets a short-lived token.

Only token hashes are kept. A full account loses its oldest; visits never evict members.
"""

from __future__ import annotations

import secrets
from collections import Counter, OrderedDict
from dataclasses import dataclass

from aiohttp import web

from consensus.chain.session_message import verify_session
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import is_public_key
from node.api.access.challenges import ChallengeBook
from node.api.access.principals import Principal, SessionKind, resolve_principal
from node.api.ports import Clock, LedgerReader

SESSION_LIFETIME_MS = 10 * 60_000
SESSIONS_MAX_COUNT = 4096
VISITS_DIVISOR = 2
"""What part of a full table the sessions of all visits have together."""
SESSIONS_OF_KEY_MAX_COUNT = 32
TOKEN_SIZE_BYTES = 32


@dataclass(frozen=True, slots=True)
class Session:
    """One proven key; `roles` as last looked up; `grant_id` only for grantees."""

    public_key: bytes
    kind: SessionKind
    roles: frozenset[str]
    expires_at_ms: int
    grant_id: bytes = b""


@dataclass(frozen=True, slots=True)
class _Kept:
    public_key: bytes
    grant_id: bytes
    expires_at_ms: int
    account: str
    is_of_visit: bool


def read_token(request: web.Request) -> bytes | None:
    """None without one. Raises SESSION_EXPIRED for what is none."""
    header = request.headers.get("Authorization")
    if header is None:
        return None
    scheme, _, text = header.partition(" ")
    if scheme != "Bearer" or len(text) != 2 * TOKEN_SIZE_BYTES or not set(text) <= set("0123456789abcdef"):
        raise BlockRobotError("SESSION_EXPIRED", "The token does not have the form of one.")
    return bytes.fromhex(text)


class SessionTable:
    """Open challenges and sessions of one node."""

    def __init__(self, chain_id: bytes, node_name: str, clock: Clock, ledger: LedgerReader) -> None:
        self._chain_id = chain_id
        self._node_name = node_name
        self._clock = clock
        self._ledger = ledger
        self._challenges = ChallengeBook(clock)
        self._sessions: OrderedDict[bytes, _Kept] = OrderedDict()
        self._of_members: dict[str, OrderedDict[bytes, None]] = {}
        self._of_visits: dict[str, OrderedDict[bytes, None]] = {}
        self._of_visits_count = 0

    def challenge(self, public_key: bytes) -> tuple[bytes, int]:
        """As `ChallengeBook.issue`. Raises KEY_INVALID."""
        if not is_public_key(public_key):
            raise BlockRobotError("KEY_INVALID", "The public key is not a compressed point of secp256k1.")
        return self._challenges.issue(public_key)

    def open(
        self, public_key: bytes, challenge: bytes, signature: bytes, grant_id: bytes = b""
    ) -> tuple[bytes, Session]:
        """Return its 32-byte token and itself; with `grant_id`, a grantee's.

        Raises CHALLENGE_INVALID, RATE_LIMITED, SIGNATURE_*, SESSION_REFUSED.
        """
        self._challenges.require(public_key, challenge)
        verify_session(public_key, signature, self._chain_id, self._node_name, challenge)
        principal = self._resolve_principal(public_key, grant_id)
        if principal is None:
            raise BlockRobotError("SESSION_REFUSED")
        self._challenges.use_up(public_key, challenge)
        token = secrets.token_bytes(TOKEN_SIZE_BYTES)
        expires_at_ms = self._clock.now_ms() + SESSION_LIFETIME_MS
        is_of_visit = principal.kind != "member"
        kept = _Kept(public_key, grant_id, expires_at_ms, principal.account or public_key.hex(), is_of_visit)
        self._insert(sha256(token), kept)
        return token, _session(kept, principal)

    def _accounts(self, kept: _Kept) -> dict[str, OrderedDict[bytes, None]]:
        return self._of_visits if kept.is_of_visit else self._of_members

    def _insert(self, digest: bytes, kept: _Kept) -> None:
        own = self._accounts(kept).setdefault(kept.account, OrderedDict())
        self._sessions[digest] = kept
        own[digest] = None
        self._of_visits_count += kept.is_of_visit
        if len(own) > SESSIONS_OF_KEY_MAX_COUNT:
            self._forget(self._find_surplus(own))
        if len(self._sessions) > SESSIONS_MAX_COUNT:
            accounts = list(self._of_visits.values())
            if self._of_visits_count <= SESSIONS_MAX_COUNT // VISITS_DIVISOR:
                accounts += self._of_members.values()
            self._forget(self._find_surplus(max(accounts, key=len)))

    def _find_surplus(self, own: OrderedDict[bytes, None]) -> bytes:
        greedy, _ = Counter(self._sessions[digest].public_key for digest in own).most_common(1)[0]
        return next(digest for digest in own if self._sessions[digest].public_key == greedy)

    def _forget(self, digest: bytes) -> None:
        known = self._sessions.pop(digest, None)
        if known is not None:
            accounts = self._accounts(known)
            own = accounts[known.account]
            del own[digest]
            self._of_visits_count -= known.is_of_visit
            if not own:
                del accounts[known.account]

    def resolve(self, token: bytes) -> Session:
        """With its current standing. Raises SESSION_EXPIRED, SESSION_REFUSED."""
        digest = sha256(token)
        known = self._sessions.get(digest)
        if known is None:
            raise BlockRobotError("SESSION_EXPIRED")
        if known.expires_at_ms <= self._clock.now_ms():
            self._forget(digest)
            raise BlockRobotError("SESSION_EXPIRED")
        principal = self._resolve_principal(known.public_key, known.grant_id)
        if principal is None:
            self._forget(digest)
            raise BlockRobotError("SESSION_REFUSED")
        return _session(known, principal)

    def close(self, token: bytes) -> None:
        self._forget(sha256(token))

    def _resolve_principal(self, public_key: bytes, grant_id: bytes) -> Principal | None:
        with self._ledger.snapshot() as snapshot:
            return resolve_principal(snapshot, public_key, grant_id)


def _session(kept: _Kept, principal: Principal) -> Session:
    return Session(kept.public_key, principal.kind, principal.roles, kept.expires_at_ms, kept.grant_id)

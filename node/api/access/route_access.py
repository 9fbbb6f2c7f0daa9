"""Access rules of routes: stated once each, enforced in one place."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.errors import BlockRobotError
from node.api.access.principals import ROLE_CUSTODIAN, SessionKind
from node.api.access.sessions import Session


@dataclass(frozen=True, slots=True)
class Access:
    """A rule: session kinds and roles that may call; no kinds: anyone.

    `opens_in_public`: anyone, with a public explorer (node.toml, default off).
    """

    label: str
    kinds: frozenset[SessionKind]
    roles: frozenset[str] = frozenset()
    opens_in_public: bool = False

    @property
    def needs_session(self) -> bool:
        return bool(self.kinds)

    def asks_session(self, *, is_public: bool) -> bool:
        """Return whether a session is required; `is_public`: the explorer is public."""
        return self.needs_session and not (is_public and self.opens_in_public)

    def check(self, session: Session | None) -> None:
        """Raise SESSION_REQUIRED or NOT_PERMITTED unless this caller may pass."""
        if not self.kinds:
            return
        if session is None:
            raise BlockRobotError("SESSION_REQUIRED")
        if session.kind not in self.kinds or (self.roles and not self.roles & session.roles):
            raise BlockRobotError("NOT_PERMITTED", f"This route is for: {self.label}.")


ANYONE = Access("anyone", frozenset())
MEMBER = Access("a member's session", frozenset({"member"}))
OWNER = Access("the session of a visit's owner key", frozenset({"owner"}))
GRANTEE = Access("the session of a grantee's one-time key", frozenset({"grantee"}))
MEMBER_OR_OWNER = Access("a member's or an owner's session", frozenset({"member", "owner"}))
VIEWER = Access("a member's, an owner's or a grantee's session", frozenset({"member", "owner", "grantee"}))
READER = Access(
    "a member's, an owner's or a grantee's session, also for a while after the grant",
    frozenset({"member", "owner", "grantee", "former-grantee"}),
)
EXPLORER = Access(
    "a member's session; anyone, where node.toml makes the explorer public", frozenset({"member"}), opens_in_public=True
)
ROBOT = Access("a robot's session", frozenset({"member"}), frozenset({"robot"}))
CUSTODIAN = Access("a custodian's session", frozenset({"member"}), frozenset({ROLE_CUSTODIAN}))

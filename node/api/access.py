"""Who may call what, stated once for each route and enforced in one place. Must never default to "anyone"."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.errors import BlockRobotError
from node.api.sessions import Session
from node.api.standing import ROLE_CUSTODIAN, SessionKind


@dataclass(frozen=True, slots=True)
class Access:
    """A rule: the kinds of session that may call, narrowed to roles if any are named. No kinds means anyone may."""

    label: str
    kinds: frozenset[SessionKind]
    roles: frozenset[str] = frozenset()

    @property
    def needs_session(self) -> bool:
        """Tell whether the route is for sessions only."""
        return bool(self.kinds)

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
MEMBER_OR_OWNER = Access("a member's, an owner's or a grantee's session", frozenset({"member", "owner", "grantee"}))
READER = Access(
    "a member's, an owner's or a grantee's session, also for a while after the grant",
    frozenset({"member", "owner", "grantee", "former-grantee"}),
)
ROBOT = Access("a robot's session", frozenset({"member"}), frozenset({"robot"}))
CUSTODIAN = Access("a custodian's session", frozenset({"member"}), frozenset({ROLE_CUSTODIAN}))

"""The robot's roster in memory: today's tag owners.

Read whole from a sealed file; asking a node about one tag would reveal who is near. Consent is in
`clients.robot.consent.consent_view`.
"""

from __future__ import annotations

from pathlib import Path

import structlog

from clients.robot.identity.robot_keys import RobotIdentity
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.members.roster import Roster, RosterRow, is_usable, open_roster, roster_tag

_log = structlog.get_logger("rosters")


class RosterBook:
    """Finds a tag's bearer by HMAC(roster key, UID)."""

    def __init__(self, roster: Roster) -> None:
        self._key = roster.key
        self._rows: dict[bytes, RosterRow] = {row.tag: row for row in roster.rows if is_usable(row)}
        if len(self._rows) < len(roster.rows):
            _log.warning("roster_rows_unusable", count=len(roster.rows) - len(self._rows))
        self.not_after_ms = roster.not_after_ms

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rows(self) -> tuple[RosterRow, ...]:
        return tuple(self._rows.values())

    def find(self, uid: str, at_ms: int) -> RosterRow | None:
        """Return a row, None if unregistered or the day is over."""
        return self._rows.get(roster_tag(self._key, uid)) if at_ms < self.not_after_ms else None


def load_roster(path: Path, identity: RobotIdentity, genesis: Genesis, now_ms: int) -> RosterBook:
    """Open a sealed roster. Raises ROSTER_INVALID or ROSTER_EXPIRED."""
    try:
        sealed = path.read_bytes()
    except FileNotFoundError:
        raise BlockRobotError("ROSTER_INVALID", f"There is no roster at {path}.") from None
    registrars = {key for organisation in genesis.organisations for key in organisation.registrars}
    return RosterBook(
        open_roster(
            sealed,
            identity.sealing,
            registrars=registrars,
            now_ms=now_ms,
            robot=identity.identity.public_key,
            chain_id=genesis.chain_id,
        )
    )

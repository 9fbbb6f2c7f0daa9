"""The robot's roster in memory: today's tag owners; and counts of tags that are on none.

Read whole from a sealed file; asking a node about one tag would reveal who is near. Consent is in
`clients.robot.consent.consent_view`.
"""

from __future__ import annotations

import hashlib
import secrets
from pathlib import Path
from typing import Annotated

import structlog

from clients.robot.identity.robot_keys import RobotIdentity
from clients.sdk.new_files import read_given_file
from clients.sdk.terminal.json_answers import Answer, Count, doc
from consensus.errors import BlockRobotError
from consensus.members.roster import Roster, RosterRow, is_usable, open_roster, roster_tag

ROSTER_FILE_MAX_BYTES = 128 * 1024 * 1024
"""10,000 rows, each with proofs of some kilobytes."""
UNKNOWN_TAGS_MAX_COUNT = 4_096
"""So many are told apart; readings of further ones are counted, the tags are not."""

_DIGEST_BYTES = 16
_log = structlog.get_logger("rosters")


class UnknownTagCounts(Answer, frozen=True, kw_only=True):
    """Tags that are not on the roster."""

    readings: Annotated[Count, doc("How many readings")]
    tags: Annotated[Count, doc("Of how many tags")]
    more_tags: Annotated[bool, doc("Whether there were more than could be told apart")]


class RosterBook:
    """Finds a tag's bearer by HMAC(roster key, UID)."""

    def __init__(self, roster: Roster, signer: bytes) -> None:
        """`signer`: the key that signed it; `RegistryReader` asks the chain whose that is."""
        self.signer = signer
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


class UnknownTags:
    """One run's readings of tags that are on no roster, hashed under a key of the run."""

    def __init__(self) -> None:
        self._key = secrets.token_bytes(32)
        self._tags: set[bytes] = set()
        self._has_more = False
        self.readings_count = 0

    def note(self, uid: str) -> None:
        self.readings_count += 1
        tag = hashlib.blake2b(uid.encode(), key=self._key, digest_size=_DIGEST_BYTES).digest()
        if tag in self._tags:
            return
        if len(self._tags) < UNKNOWN_TAGS_MAX_COUNT:
            self._tags.add(tag)
        else:
            self._has_more = True

    def summarise(self) -> UnknownTagCounts:
        return UnknownTagCounts(readings=self.readings_count, tags=len(self._tags), more_tags=self._has_more)


def load_roster(path: Path, identity: RobotIdentity, chain_id: bytes, now_ms: int) -> RosterBook:
    """Open a sealed roster. Raises ROSTER_INVALID, ROSTER_EXPIRED, FILE_UNUSABLE."""
    try:
        sealed = read_given_file(path, ROSTER_FILE_MAX_BYTES)
    except FileNotFoundError:
        raise BlockRobotError("ROSTER_INVALID", f"There is no roster at {path}.") from None
    robot = identity.identity.public_key
    return RosterBook(*open_roster(sealed, identity.sealing, now_ms=now_ms, robot=robot, chain_id=chain_id))

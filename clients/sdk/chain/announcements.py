"""Pages of announcements, proved complete."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from clients.sdk.proof_checks import ProofVerifier
from consensus.api_documents import ProofsAnswer
from consensus.errors import BlockRobotError
from consensus.state.records import ANNOUNCEMENT, ANNOUNCEMENT_COUNT


@dataclass(frozen=True, slots=True)
class Announcement:
    """A visit: keys O, R, robot (33 bytes each), one-byte view tag; `number` from 0, `bucket_ms` begins five minutes.
    With `root` (first owner key), a handover to `owner`.
    """

    number: int
    owner: bytes
    ephemeral: bytes
    view_tag: int
    bucket_ms: int
    robot: bytes
    root: bytes = b""


@dataclass(frozen=True, slots=True)
class AnnouncementPage:
    """Consecutive announcements; `count` is the total."""

    count: int
    items: tuple[Announcement, ...]
    next_number: int


def read_announcements(trust: ProofVerifier, answer: ProofsAnswer, first: int, limit: int) -> AnnouncementPage:
    """Raises PROOF_INVALID, PROOF_STALE."""
    if not answer.proofs:
        raise BlockRobotError("PROOF_INVALID", "The page does not prove how many announcements there are.")
    claimed = len(answer.proofs) - 1
    if claimed > limit:
        raise BlockRobotError("PROOF_INVALID", "The page holds more announcements than were asked for.")
    numbers = range(first, first + claimed)
    keys = [ANNOUNCEMENT_COUNT.flat, *map(ANNOUNCEMENT.key, numbers)]
    proved = trust.values(answer, keys).values
    count = ANNOUNCEMENT_COUNT.among(proved) or 0
    if claimed != max(0, min(limit, count - first)):
        raise BlockRobotError("PROOF_INVALID", "The page leaves announcements out.")
    try:
        rows = [(number, ANNOUNCEMENT.convert(proved[ANNOUNCEMENT.key(number)])) for number in numbers]
    except BlockRobotError as error:
        raise BlockRobotError("PROOF_INVALID", error.detail) from None
    items = tuple(Announcement(number, *msgspec.structs.astuple(row)) for number, row in rows)
    return AnnouncementPage(count=count, items=items, next_number=first + claimed)

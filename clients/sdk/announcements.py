"""Pages of announcements, proved complete. Must never accept a page that leaves one out."""

from __future__ import annotations

from dataclasses import dataclass

from clients.sdk.answers import ProofsAnswer
from clients.sdk.trust import Trust
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u64

_PREFIX = b"records\x00announcement/"
_COUNT_KEY = b"records\x00announcement-count"


@dataclass(frozen=True, slots=True)
class Announcement:
    """One opened visit: owner key O, ephemeral key R, the robot's key (33 bytes each), the one-byte view tag.

    `sequence` is its number on the chain, from 0 on; `bucket_ms` begins its five minutes.
    """

    sequence: int
    owner: bytes
    ephemeral: bytes
    view_tag: int
    bucket_ms: int
    robot: bytes


def read_announcements(trust: Trust, answer: ProofsAnswer, first: int, limit: int) -> list[Announcement]:
    """Check a page: the count is proved, and so is every item that the count says is due.

    Raises PROOF_INVALID, PROOF_STALE and what a wrong finality proof raises.
    """
    if not answer.proofs:
        raise BlockRobotError("PROOF_INVALID", "The page does not prove how many announcements there are.")
    claimed = len(answer.proofs) - 1
    if claimed > limit:
        raise BlockRobotError("PROOF_INVALID", "The page holds more announcements than were asked for.")
    numbers = range(first, first + claimed)
    proved = trust.values(answer, [_COUNT_KEY, *(_PREFIX + u64(number) for number in numbers)]).values
    count = proved[_COUNT_KEY] or 0
    if not isinstance(count, int) or claimed != max(0, min(limit, count - first)):
        raise BlockRobotError("PROOF_INVALID", "The page leaves announcements out.")
    return [_read_item(number, proved[_PREFIX + u64(number)]) for number in numbers]


def _read_item(number: int, value: object) -> Announcement:
    match value:
        case [bytes() as owner, bytes() as ephemeral, int() as view_tag, int() as bucket_ms, bytes() as robot]:
            return Announcement(number, owner, ephemeral, view_tag, bucket_ms, robot)
    raise BlockRobotError("PROOF_INVALID", f"Announcement {number} does not have its five parts.")

"""`rmw_zenoh` layout of topics, types and sequence numbers; invalid input gives None."""

from __future__ import annotations

import re
from dataclasses import dataclass

from consensus.errors import BlockRobotError

DOMAIN_MAX = 232
KEY_MAX_CHARS = 1_024
PUBLISHERS_MAX_COUNT = 256
"""So many publishers' sequence numbers are followed; those heard longest ago are forgotten first."""

GAP_MAX_COUNT = 1_000_000
"""A larger gap is no loss but another beginning."""

HASHES_UNSAID = frozenset({"TypeHashNotSupported", "EMPTY_TOPIC_HASH"})
"""What stands where a publisher's ROS knows no hash of the type, as in Humble."""

_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"([a-z][a-z0-9_]*)::msg::dds_::([A-Za-z][A-Za-z0-9]*)_")
_TOKEN_PARTS_COUNT = 13
_TOKEN_KIND, _TOKEN_TOPIC, _TOKEN_TYPE, _TOKEN_HASH = 5, 9, 10, 11
_GID_BYTES = 16
_NUMBERS_BYTES = 16
_NAMED = (b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid")


@dataclass(frozen=True, slots=True)
class TopicKey:
    """A topic; `type` is `pkg/msg/Name`, `hash` RIHS01."""

    topic: str
    type: str
    hash: str


def subscription_key(topic: str, domain: int) -> str:
    """Raises TOPICS_INVALID."""
    if len(topic) > KEY_MAX_CHARS or not _TOPIC.fullmatch(topic):
        raise BlockRobotError("TOPICS_INVALID", f"{topic[:64]!r} is no name of a ROS topic, such as /camera/depth.")
    return f"{domain}/{topic.lstrip('/')}/*/*"


def parse_key(key: str) -> TopicKey | None:
    """None if it is not of ROS."""
    parts = key.split("/") if len(key) <= KEY_MAX_CHARS else []
    if len(parts) < 4:
        return None
    return _topic_key("/" + "/".join(parts[1:-2]), parts[-2], parts[-1])


def parse_token(token: str) -> TopicKey | None:
    """None for another token."""
    parts = token.split("/") if len(token) <= KEY_MAX_CHARS else []
    if len(parts) != _TOKEN_PARTS_COUNT or parts[_TOKEN_KIND] != "MP":
        return None
    return _topic_key(parts[_TOKEN_TOPIC].replace("%", "/"), parts[_TOKEN_TYPE], parts[_TOKEN_HASH])


def parse_numbers(attachment: bytes) -> tuple[bytes, int] | None:
    """Return publisher and sequence number by either attachment layout, or None."""
    if attachment.startswith(_NAMED[0]):
        parts = [attachment[len(_NAMED[0]) :]]
        for name in _NAMED[1:]:
            if parts[-1][8 : 8 + len(name)] != name:
                return None
            parts.append(parts[-1][8 + len(name) :])
        number, publisher = parts[0][:8], parts[2]
    else:
        number, publisher = attachment[:8], attachment[_NUMBERS_BYTES:]
    if publisher[:1] == bytes([_GID_BYTES]):
        publisher = publisher[1:]
    if len(publisher) != _GID_BYTES:
        return None
    return publisher, int.from_bytes(number, "little", signed=True)


class SequenceGaps:
    """Lost messages by gaps in publishers' sequence numbers."""

    def __init__(self) -> None:
        self._last: dict[bytes, int] = {}

    def take(self, attachment: bytes) -> int:
        """Return how many are missing before this message."""
        parsed = parse_numbers(attachment)
        if parsed is None:
            return 0
        publisher, number = parsed
        before = self._last.pop(publisher, None)
        if len(self._last) >= PUBLISHERS_MAX_COUNT:
            del self._last[next(iter(self._last))]
        self._last[publisher] = number
        gap = 0 if before is None else number - before - 1
        return gap if 0 < gap <= GAP_MAX_COUNT else 0


def _topic_key(topic: str, mangled_type: str, type_hash: str) -> TopicKey | None:
    named = _TYPE.fullmatch(mangled_type)
    if named is None or not _TOPIC.fullmatch(topic):
        return None
    return TopicKey(topic, f"{named[1]}/msg/{named[2]}", type_hash)

"""Reads an event log in the prototype authors' format.

A line is `HH:MM:SS:mmm, ACTIVITY, image sequence number[, tag hash[, txid]]`, ms unpadded, or `time, RFID_RETRIEVE, tag
words, tag hash`. Hashes are reversible, so tags are numbered by appearance. Without dates, midnight is inferred where
nearer.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from clients.robot.recording.event_log import RFID_RETRIEVE
from consensus.errors import BlockRobotError
from network.experiments.pages.event_table import EventTable, LoggedEvent

FORM = "published"
DAY_MS = 24 * 60 * 60 * 1000
_TIME = re.compile(r"([01]\d|2[0-3]):([0-5]\d):([0-5]\d):(\d{1,3})")
_ACTIVITY = re.compile(r"[A-Z][A-Z_]{2,63}")
_HASH = re.compile(r"[0-9a-fA-F]{64}")
_SEQUENCE = re.compile(r"\d{1,18}")


class _Tags:
    """Numbers tags by first appearance."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def alias(self, tag_hash: str) -> str:
        return f"tag-{self._numbers.setdefault(tag_hash.lower(), len(self._numbers) + 1)}"


def parse_published_log(lines: Iterable[str]) -> EventTable:
    """Raises EVENT_LOG_INVALID with the number of the first wrong line."""
    tags = _Tags()
    events = []
    before_ms: int | None = None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        parts = [part.strip() for part in line.split(", ")]
        time_ms = _near(_parse_time(parts[0], number), before_ms)
        before_ms = time_ms
        events.append(_parse_event(time_ms, parts[1:], tags, number))
    return EventTable.of(FORM, events)


def _parse_time(text: str, number: int) -> int:
    found = _TIME.fullmatch(text)
    if not found:
        raise invalid_line(number, "it does not begin with a time HH:MM:SS:mmm")
    hours, minutes, seconds, milliseconds = (int(group) for group in found.groups())
    return ((hours * 60 + minutes) * 60 + seconds) * 1000 + milliseconds


def _near(time_ms: int, before_ms: int | None) -> int:
    if before_ms is None:
        return time_ms
    day = before_ms - before_ms % DAY_MS
    return min((time_ms + day + step for step in (0, DAY_MS, -DAY_MS)), key=lambda at: abs(at - before_ms))


def _parse_event(time_ms: int, parts: list[str], tags: _Tags, number: int) -> LoggedEvent:
    if not parts or not _ACTIVITY.fullmatch(parts[0]):
        raise invalid_line(number, "the second field is not an activity")
    activity, *rest = parts
    if activity == RFID_RETRIEVE:
        if len(rest) != 2 or not _HASH.fullmatch(rest[1]):
            raise invalid_line(number, "a reading needs the tag's words and its hash")
        alias = tags.alias(rest[1])
        return LoggedEvent(time_ms, activity, alias, alias)
    if not rest or not _SEQUENCE.fullmatch(rest[0]):
        raise invalid_line(number, "the third field is not an image's sequence number")
    if len(rest) > 3 or not all(_HASH.fullmatch(field) for field in rest[1:]):
        raise invalid_line(number, "what follows the sequence number is not a tag's hash and a transaction")
    return LoggedEvent(time_ms, activity, f"frame-{int(rest[0])}", tags.alias(rest[1]) if len(rest) > 1 else "")


def invalid_line(number: int, reason: str) -> BlockRobotError:
    return BlockRobotError(
        "EVENT_LOG_INVALID", f"Line {number} of the event log cannot be read: {reason}.", line=number
    )

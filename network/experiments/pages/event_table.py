"""One table of events, whatever log it was read from.

A case is a frame (`frame-7`) or a tag's readings (the tag's alias). An event that is about a tag bears its alias.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

_FRAME_CASE = re.compile(r"frame-(\d{1,18})")


@dataclass(frozen=True, slots=True)
class LoggedEvent:
    """One event. `time_ms` is milliseconds since 1970, or since the midnight before a log that knows no date."""

    time_ms: int
    activity: str
    case: str
    alias: str = ""

    @property
    def sequence(self) -> int | None:
        """The frame's sequence number, or None for an event that is about no frame."""
        found = _FRAME_CASE.fullmatch(self.case)
        return int(found[1]) if found else None


@dataclass(frozen=True, slots=True)
class EventTable:
    """All events of one log in order of time (file order where times are equal), and the log's form."""

    form: str
    events: tuple[LoggedEvent, ...]

    @classmethod
    def of(cls, form: str, events: Iterable[LoggedEvent]) -> EventTable:
        """Return the table of events in any order."""
        return cls(form=form, events=tuple(sorted(events, key=lambda event: event.time_ms)))

    def cases(self) -> dict[str, list[LoggedEvent]]:
        """Return the events of each case, in order of time."""
        cases: dict[str, list[LoggedEvent]] = {}
        for event in self.events:
            cases.setdefault(event.case, []).append(event)
        return cases

    def of_activity(self, activity: str) -> Iterator[LoggedEvent]:
        """Yield the events of one activity, in order of time."""
        return (event for event in self.events if event.activity == activity)


def follow(events: Iterable[LoggedEvent]) -> Iterator[tuple[LoggedEvent | None, LoggedEvent]]:
    """Yield each event of one case with the one that it follows, or None for the first.

    Within a frame that belongs to two people, what is done for one of them follows what was done for her, not what was
    done for the other in between: an event that bears an alias follows the latest event of that alias or of nobody's.
    """
    own: dict[str, LoggedEvent] = {}
    place: dict[int, int] = {}
    shared: LoggedEvent | None = None
    last: LoggedEvent | None = None
    for index, event in enumerate(events):
        place[id(event)] = index
        if event.alias:
            earlier = [item for item in (own.get(event.alias), shared) if item is not None]
            yield max(earlier, key=lambda item: place[id(item)], default=None), event
            own[event.alias] = event
        else:
            yield last, event
            shared = event
        last = event

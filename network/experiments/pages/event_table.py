"""One table of events, independent of the log's form.

A case is a frame (`frame-7`) or a tag's readings (the tag's alias); events about a tag carry its alias.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from clients.robot.recording.event_log import Event

_FRAME_CASE = re.compile(r"frame-(\d{1,18})")


class LoggedEvent(Event, frozen=True):
    """One event. `time_ms`: since 1970, or since midnight for a log without dates."""

    @property
    def sequence(self) -> int | None:
        """The frame's; None if about no frame."""
        found = _FRAME_CASE.fullmatch(self.case)
        return int(found[1]) if found else None


@dataclass(frozen=True, slots=True)
class EventTable:
    """A log's events by time (ties in file order), and its form."""

    form: str
    events: tuple[LoggedEvent, ...]

    @classmethod
    def of(cls, form: str, events: Iterable[LoggedEvent]) -> EventTable:
        return cls(form=form, events=tuple(sorted(events, key=lambda event: event.time_ms)))

    def cases(self) -> dict[str, list[LoggedEvent]]:
        cases: dict[str, list[LoggedEvent]] = {}
        for event in self.events:
            cases.setdefault(event.case, []).append(event)
        return cases

    def of_activity(self, activity: str) -> Iterator[LoggedEvent]:
        return (event for event in self.events if event.activity == activity)


def follow(events: Iterable[LoggedEvent]) -> Iterator[tuple[LoggedEvent | None, LoggedEvent]]:
    """Yield each event of one case with its predecessor (None for the first).

    In a frame with two owners, an event with an alias follows the latest event of that alias or without one.
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

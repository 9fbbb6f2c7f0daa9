"""What the pipeline needs of a source of events, and how the events of a recording are played in real time.

A source gives frames, sightings, other senses, and a `Refused` for each message that it could not use: one bad
message never ends a stream. It must never write what it reads.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Iterator
from typing import Protocol

from clients.robot.sensing.sensor_events import Depth, Frame, Sighting, SourceEvent

NS_PER_MS = 1_000_000


class Clock(Protocol):
    """What real-time playing needs of a clock."""

    def now_ms(self) -> int:
        """Return the time in milliseconds."""

    async def sleep_until(self, at_ms: int) -> None:
        """Return at or after a time."""


class SystemClock:
    """The machine's clock."""

    def now_ms(self) -> int:
        """Return the wall-clock time in milliseconds since 1970."""
        return time.time_ns() // NS_PER_MS

    async def sleep_until(self, at_ms: int) -> None:
        """Return at or after a time, at once (but after letting others run) if it has passed."""
        await asyncio.sleep(max(0.0, (at_ms - self.now_ms()) / 1000))


class StoppableClock(SystemClock):
    """The machine's clock until `stop` is set, which wakes every sleeper; at `ends_ms` it is set by itself."""

    def __init__(self, stop: asyncio.Event, ends_ms: int | None = None) -> None:
        self._stop = stop
        self._ends_ms = ends_ms

    async def sleep_until(self, at_ms: int) -> None:
        """Return at or after a time, or when it is time to stop."""
        until_ms = at_ms if self._ends_ms is None else min(at_ms, self._ends_ms)
        left_ms = until_ms - self.now_ms()
        if left_ms <= 0:
            await asyncio.sleep(0)
        else:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), left_ms / 1000)
        if self._ends_ms is not None and self._ends_ms <= at_ms:
            self._stop.set()


class Source(Protocol):
    """A stream of events with one depth camera and one timeline.

    `events` raises BAG_DAMAGED where a recording breaks off, after everything that stands before the break.
    """

    @property
    def start_ms(self) -> int:
        """When the first event happened, shifts included."""

    @property
    def focal_px(self) -> float | None:
        """The depth camera's focal length in pixels, None if the source does not know it."""

    @property
    def focal_from(self) -> str:
        """Where `focal_px` is from: `topics` (the user's word), `camera-info` or `scenario`."""

    def shift_to(self, start_ms: int) -> None:
        """Move the timeline so that the first event happens at `start_ms`; a live source takes no notice."""

    def empty_frames(self) -> list[Depth]:
        """Return frames of the scene without people, all of one size. Raises EMPTY_SCENE_MISSING."""

    def events(self) -> Iterator[SourceEvent]:
        """Yield everything as fast as it can be had, frames numbered from 0, in the order in which it came."""

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        """Yield the same, each no earlier than `clock` says it came."""


def happened_ms(event: SourceEvent) -> int:
    """Return when an event came: by the host's stamp if there is one, else by its own."""
    if isinstance(event, Frame):
        own = event.captured_at_ms
    elif isinstance(event, Sighting):
        own = event.last_seen_ms
    else:
        own = event.at_ms
    received = getattr(event, "received_at_ms", None)
    return own if received is None else received


async def play_events(events: Iterator[SourceEvent], clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
    """Yield `events`, each no earlier than `clock` (the machine's, if none is given) says it came."""
    ticking = clock or SystemClock()
    for event in events:
        await ticking.sleep_until(happened_ms(event))
        yield event

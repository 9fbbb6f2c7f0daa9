"""Event source interface and real-time playing.

A source yields frames, sightings, other senses, and `RefusedMessage` per unusable message, without ending.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Iterator
from typing import Protocol

from clients.robot.sensing.sensor_events import NS_PER_MS, Depth, Frame, Sighting, SourceEvent

EMPTY_FRAMES_READ_MAX_COUNT = 300
EMPTY_FRAMES_MAX_COUNT = 64
EMPTY_FRAMES_MAX_BYTES = 256 * 1024 * 1024


class Clock(Protocol):
    """For real-time playing."""

    def now_ms(self) -> int: ...

    async def sleep_until(self, at_ms: int) -> None:
        """At or after a time."""


class SystemClock:
    """The machine's clock."""

    def now_ms(self) -> int:
        """Since 1970."""
        return time.time_ns() // NS_PER_MS

    async def sleep_until(self, at_ms: int) -> None:
        await asyncio.sleep(max(0.0, (at_ms - self.now_ms()) / 1000))


class StoppableClock(SystemClock):
    """System clock stopped by `stop`, which is set at `ends_ms`."""

    def __init__(self, stop: asyncio.Event, ends_ms: int | None = None) -> None:
        self._stop = stop
        self._ends_ms = ends_ms

    async def sleep_until(self, at_ms: int) -> None:
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
    """Events with one depth camera and timeline. `events` raises BAG_DAMAGED at a break, after earlier events."""

    @property
    def start_ms(self) -> int:
        """Time of the first event, shifts included."""

    @property
    def focal_px(self) -> float | None:
        """None if unknown."""

    @property
    def focal_from(self) -> str:
        """Origin of `focal_px`: `topics` (set by the user), `camera-info` or `scenario`."""

    def shift_to(self, start_ms: int) -> None:
        """Shift the timeline to begin at `start_ms`; live sources ignore it."""

    def empty_frames(self) -> list[Depth]:
        """Return frames without people, all of one size. Raises EMPTY_SCENE_MISSING."""

    def events(self) -> Iterator[SourceEvent]:
        """Yield events unthrottled in arrival order, frames numbered from 0."""

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        """No earlier than their arrival on `clock`."""


def happened_ms(event: SourceEvent) -> int:
    """Return an event's host timestamp if present, else its own."""
    if isinstance(event, Frame):
        own = event.captured_at_ms
    elif isinstance(event, Sighting):
        own = event.last_seen_ms
    else:
        own = event.at_ms
    received = getattr(event, "received_at_ms", None)
    return own if received is None else received


async def play_events(events: Iterator[SourceEvent], clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
    """No earlier than their arrival on `clock` (default: system)."""
    ticking = clock or SystemClock()
    for event in events:
        await ticking.sleep_until(happened_ms(event))
        yield event


class EmptyFrames:
    """Of a bounded number and size, evenly spread; all of the first's size."""

    def __init__(self) -> None:
        self.frames: list[Depth] = []
        self._usable_count = 0
        self._step = 1

    @property
    def is_enough(self) -> bool:
        return self._usable_count >= EMPTY_FRAMES_READ_MAX_COUNT

    def add(self, depth: Depth) -> None:
        if self.frames and depth.shape != self.frames[0].shape:
            return
        if self._usable_count % self._step == 0:
            self.frames.append(depth)
        if len(self.frames) > max(1, min(EMPTY_FRAMES_MAX_COUNT, EMPTY_FRAMES_MAX_BYTES // depth.nbytes)):
            self.frames, self._step = self.frames[::2], 2 * self._step
        self._usable_count += 1

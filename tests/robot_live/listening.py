"""Listens to live feeds as a robot does, without the rest of the robot: what they bring, and what is said of it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass, field

from clients.robot.sensing.sensor_events import Frame, RefusedMessage, Sighting, SourceEvent
from clients.robot.sources.live.live_feed import Feed
from clients.robot.sources.live.live_source import LiveCounts, LiveSource
from clients.robot.sources.messages.topics import Topics
from clients.robot.sources.source import StoppableClock

WAIT_S = 60.0


@dataclass
class Heard:
    """What came so far, and what was said."""

    source: LiveSource
    events: list[SourceEvent] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    @property
    def frames(self) -> list[Frame]:
        return [event for event in self.events if isinstance(event, Frame)]

    @property
    def sightings(self) -> list[Sighting]:
        return [event for event in self.events if isinstance(event, Sighting)]

    @property
    def refused(self) -> list[tuple[str, str]]:
        return [(event.kind, event.reason) for event in self.events if isinstance(event, RefusedMessage)]

    def told_of(self, part: str) -> list[str]:
        """What was said of one part, such as a reader."""
        return [sentence for sentence in self.said if sentence.startswith(part)]

    @property
    def intake(self) -> LiveCounts:
        return self.source.count_intake()

    async def until(self, is_so: Callable[[], bool]) -> None:
        """Return once something is so."""
        async with asyncio.timeout(WAIT_S):
            while not is_so():  # noqa: ASYNC110 - what is waited for happens in threads of others
                await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def listening(feeds: Sequence[Feed], topics: Topics) -> AsyncIterator[Heard]:
    """Listen to `feeds` while inside."""
    said: list[str] = []
    source = LiveSource(feeds, topics, said.append)
    heard = Heard(source, said=said)
    stop = asyncio.Event()

    async def take() -> None:
        async for event in source.play(StoppableClock(stop)):
            heard.events.append(event)

    with source:
        taking = asyncio.create_task(take())
        await asyncio.sleep(0)  # now it plays
        try:
            yield heard
        finally:
            stop.set()
            await asyncio.wait_for(taking, WAIT_S)

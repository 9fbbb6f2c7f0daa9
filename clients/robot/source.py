"""Reads a recording (rosbag2 folder or .mcap/.db3 file) as frames and sightings in time order, at once or in real time.

A damaged recording ends in BAG_DAMAGED, BAG_TOPIC_MISSING or FRAME_INVALID, never in another exception. Must never
write anything.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Protocol

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from clients.robot.bag import DEPTH_TOPIC, EMPTY_TOPIC, SIGHTING_TOPIC
from clients.robot.events import Depth, Event, Frame
from clients.robot.messages import IMAGE_TYPE, NS_PER_MS, SIGHTING_TYPE, MessageCodec
from consensus.errors import BlockRobotError

EMPTY_FRAMES_MAX_COUNT = 300


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


class BagSource:
    """One recording. `shift_ms` is added to every time in it, so that an old recording plays in the present.

    Raises BAG_DAMAGED when the recording cannot be opened and BAG_TOPIC_MISSING when it has no depth or no sightings.
    """

    def __init__(
        self,
        path: Path,
        *,
        shift_ms: int = 0,
        depth_topic: str = DEPTH_TOPIC,
        sighting_topic: str = SIGHTING_TOPIC,
        empty_topic: str = EMPTY_TOPIC,
    ) -> None:
        self.path = path
        self.shift_ms = shift_ms
        self._depth_topic, self._sighting_topic, self._empty_topic = depth_topic, sighting_topic, empty_topic
        self._codec = MessageCodec()
        counts = self._inspect()
        self.frame_count = counts[depth_topic]
        self.sighting_count = counts[sighting_topic]
        self.empty_frame_count = counts.get(empty_topic, 0)

    @property
    def start_ms(self) -> int:
        """When the first frame or sighting was recorded, `shift_ms` included. Raises BAG_DAMAGED if there is none."""
        for _, at_ns, _ in self._messages(self._depth_topic, self._sighting_topic):
            return at_ns // NS_PER_MS + self.shift_ms
        raise BlockRobotError("BAG_DAMAGED", "The recording holds no frame.")

    def shift_to(self, start_ms: int) -> None:
        """Move the timeline so that the first frame or sighting happens at `start_ms`."""
        self.shift_ms += start_ms - self.start_ms

    def empty_frames(self) -> list[Depth]:
        """Return the recorded frames of the empty scene; raises BAG_TOPIC_MISSING if there are none."""
        frames: list[Depth] = []
        for _, _, data in self._messages(self._empty_topic):
            frames.append(self._codec.decode_image(data, len(frames)).depth)
            if len(frames) == EMPTY_FRAMES_MAX_COUNT:
                break
        if not frames:
            raise BlockRobotError("BAG_TOPIC_MISSING", f"The recording has no empty frames on {self._empty_topic}.")
        return frames

    def events(self) -> Iterator[Event]:
        """Yield frames (numbered from 0) and sightings in the order in which they were recorded."""
        sequence = 0
        for topic, at_ns, data in self._messages(self._depth_topic, self._sighting_topic):
            if topic == self._depth_topic:
                yield self._codec.decode_image(data, sequence, self.shift_ms, at_ns // NS_PER_MS + self.shift_ms)
                sequence += 1
            else:
                yield self._codec.decode_sighting(data, self.shift_ms)

    async def play(self, clock: Clock | None = None) -> AsyncIterator[Event]:
        """Yield the same events, each no earlier than `clock` says it happened. Shift the timeline first."""
        ticking = clock or SystemClock()
        for event in self.events():
            await ticking.sleep_until(_happened_ms(event))
            yield event

    def _inspect(self) -> dict[str, int]:
        try:
            with Reader(self.path) as reader:
                found = {connection.topic: connection for connection in reader.connections}
                counts = {topic: connection.msgcount for topic, connection in found.items()}
        except Exception as error:
            raise _damaged(self.path) from error
        for topic, kind in ((self._depth_topic, IMAGE_TYPE), (self._sighting_topic, SIGHTING_TYPE)):
            if topic not in found:
                raise BlockRobotError("BAG_TOPIC_MISSING", f"The recording has no topic {topic}.")
            if found[topic].msgtype != kind:
                raise BlockRobotError("BAG_TOPIC_MISSING", f"Topic {topic} carries {found[topic].msgtype}, not {kind}.")
        return counts

    def _messages(self, *topics: str) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time in ns, bytes); every fault of the reader becomes BAG_DAMAGED."""
        try:
            with Reader(self.path) as reader:
                chosen: list[Connection] = [c for c in reader.connections if c.topic in topics]
                if not chosen:
                    return
                for connection, at_ns, data in reader.messages(chosen):
                    yield connection.topic, at_ns, data
        except Exception as error:  # a truncated or flipped chunk fails in many ways
            raise _damaged(self.path) from error


def _happened_ms(event: Event) -> int:
    if event.received_at_ms is not None:
        return event.received_at_ms  # what the camera's or the reader's own clock says may be a day off
    return event.captured_at_ms if isinstance(event, Frame) else event.last_seen_ms


def _damaged(path: Path) -> BlockRobotError:
    return BlockRobotError("BAG_DAMAGED", f"The recording {path.name} is damaged, truncated or not a recording.")

"""Samples live feeds: topics on air, and empty-scene frames."""

from __future__ import annotations

import asyncio
import threading
import time
from contextlib import ExitStack, suppress
from typing import Any

from clients.robot.sensing.sensor_events import Depth, Frame, RefusedMessage, Sighting
from clients.robot.sources.live.live_feed import Feed
from clients.robot.sources.live.live_source import LiveSource
from clients.robot.sources.messages.decoding import KINDS
from clients.robot.sources.messages.message_types import LearntTypes, Message, MessageTypes, own_types
from clients.robot.sources.recordings.recording import TopicFigures, explain_undefined
from clients.robot.sources.source import EmptyFrames, StoppableClock, SystemClock
from consensus.errors import BlockRobotError

TOPICS_MAX_COUNT = 512
SAMPLES_MAX_COUNT, SMALL_MAX_BYTES = 32, 4_096  # kept of a topic; a message that is larger is kept alone


class Sample:
    """A feed's topics and messages within some seconds, listed like recordings."""

    def __init__(self, feed: Feed) -> None:
        self.topics: dict[str, TopicFigures] = {}
        self.listened_s = 0.0
        self._feed = feed
        self._types = LearntTypes(own_types(), ros1=feed.ros1)
        self._first: dict[str, list[tuple[Message, MessageTypes]]] = {}
        self._lock = threading.Lock()

    def listen(self, seconds: float) -> None:
        """Subscribe to all topics. Raises FEED_UNREACHABLE, MIDDLEWARE_MISSING."""
        advertised = dict(sorted(self._feed.topics().items())[:TOPICS_MAX_COUNT])
        self.topics = {topic: TopicFigures(topic, kind, types={kind}) for topic, kind in advertised.items()}
        with ExitStack() as closing:
            closing.callback(self._feed.close)
            # No type is configured for them: one whose type cannot be had here must not keep the rest from sight.
            self._feed.open(dict.fromkeys(advertised, ""), self)
            time.sleep(seconds)
        self.listened_s = seconds
        with self._lock:
            for figures in self.topics.values():
                figures.rate_hz = round(figures.count / seconds, 2)

    def explain_unknown(self, topic: str) -> str:
        figures = self.topics[topic]
        if self._feed.ros1 and not figures.count:
            return (
                f"No message of {topic} came in {self.listened_s:g} s, and with one comes what {figures.type} is. If it "
                "holds tag readings, hold a tag before the reader and list again, or listen longer with --seconds."
            )
        return explain_undefined(figures, "neither the robot's middleware nor BlockRobot defines")

    def types_of(self, type_name: str) -> MessageTypes:
        return self._types.of(type_name)

    def samples(self, topic: str, most: int = 1) -> list[Any]:
        """Return the first that can be decoded; of large messages only one is kept."""
        found = []
        for message, types in self._first.get(topic, [])[:most]:
            with suppress(BlockRobotError):
                found.append(types.decode(message))
        return found

    def learn(self, type_name: str, definition: str) -> None:
        with self._lock:
            self._types.learn(type_name, definition)

    def deliver(self, message: Message, definition: str = "") -> None:
        with self._lock:
            if message.topic in self.topics:
                if definition:
                    self._types.learn(message.type, definition)
                self.topics[message.topic].count += 1
                self.topics[message.topic].type = message.type or self.topics[message.topic].type
                kept = self._first.setdefault(message.topic, [])
                if not kept or (len(message.data) <= SMALL_MAX_BYTES and len(kept) < SAMPLES_MAX_COUNT):
                    kept.append((message, self._types.of(message.type, definition)))

    def sight(self, sighting: Sighting) -> None:
        """Ignored: a reader has no topics."""

    def refuse(self, refused: RefusedMessage) -> None:
        """Ignored."""

    def miss(self, topic: str, count: int) -> None:
        """Ignored."""

    def presence(self, part: str, *, here: bool) -> None:
        """Ignored."""

    def unusable(self, topic: str, error: BlockRobotError, *, for_good: bool) -> None:
        """Ignored."""

    def fail(self, error: BlockRobotError) -> None:
        """Ignored: what came before is listed."""


def record_empty_frames(source: LiveSource, seconds: float) -> list[Depth]:
    """Return equally sized frames of `seconds`. Raises CAMERA_SILENT."""
    gathered, refused = asyncio.run(_gather(source, seconds))
    if gathered.frames:
        return gathered.frames
    why = f"none of {sum(refused.values())} could be used, for {', '.join(sorted(refused))}" if refused else "none came"
    raise BlockRobotError(
        "CAMERA_SILENT",
        f"No usable frame of {source.camera_topic} within {seconds:g} s: {why}. {source.describe_images()}",
    )


async def _gather(source: LiveSource, seconds: float) -> tuple[EmptyFrames, dict[str, int]]:
    gathered, refused, stop = EmptyFrames(), dict[str, int](), asyncio.Event()
    ends_ms = SystemClock().now_ms() + round(seconds * 1000)
    async for event in source.play(StoppableClock(stop, ends_ms)):
        if isinstance(event, Frame):
            gathered.add(event.depth)
        elif isinstance(event, RefusedMessage) and event.kind == KINDS["depth"]:
            refused[event.reason] = refused.get(event.reason, 0) + 1
        if gathered.is_enough:
            break
    return gathered, refused

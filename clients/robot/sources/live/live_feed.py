"""Middleware as feeds: topics and undecoded messages.

Adapters import their library only in `open` or `topics`. They never decode, write, or let exceptions into library
threads.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from clients.robot.sensing.sensor_events import RefusedMessage, Sighting
from clients.robot.sources.messages.message_types import Message
from consensus.errors import BlockRobotError

CLOSE_MAX_S = 5.0
"""How long a feed may take to close, whatever state its middleware is in."""

MESSAGE_MAX_BYTES = 80 * 1024 * 1024
"""Room for a depth image of 4096x4096 in metres, the largest that the robot takes."""

NODE_NAME = "blockrobot"
"""How the robot's own node is called on a ROS graph."""


class Listener(Protocol):
    """A feed's listener; any thread may call, never blocks or raises."""

    def learn(self, type_name: str, definition: str) -> None:
        """Add a ROS type definition, nested ones after `=` and `MSG: pkg/Name` lines."""

    def deliver(self, message: Message, definition: str = "") -> None:
        """Receive a wanted topic's message, with its publisher's definition if any."""

    def sight(self, sighting: Sighting) -> None:
        """Receive a reading that needs no decoding."""

    def refuse(self, refused: RefusedMessage) -> None:
        """Count input unusable as message or reading."""

    def miss(self, topic: str, count: int) -> None:
        """Count a topic's messages lost by the middleware."""

    def presence(self, part: str, *, here: bool) -> None:
        """Note a feed part (reader or topic's only publisher) gone or back."""

    def unusable(self, topic: str, error: BlockRobotError, *, for_good: bool) -> None:
        """Note an unhearable topic; `presence` ends it unless `for_good`."""

    def fail(self, error: BlockRobotError) -> None:
        """The feed is lost for good (FEED_LOST); the run ends."""


class Feed(Protocol):
    """A middleware or reader, opened once, reconnecting itself; `ros1`: ROS 1 serialisation, otherwise CDR."""

    name: str
    ros1: bool

    def topics(self) -> dict[str, str]:
        """Return topics by type, from any thread. Raises FEED_UNREACHABLE, MIDDLEWARE_MISSING."""

    def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
        """Subscribe to `wanted` (topic to type, maybe empty). Raises FEED_UNREACHABLE, MIDDLEWARE_MISSING."""

    def close(self) -> None:
        """End all threads within `CLOSE_MAX_S`; idempotent, also before `open`."""

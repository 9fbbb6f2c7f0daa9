"""What a robot's middleware is to the rest: a feed that lists topics and delivers messages as they come, undecoded.

Each adapter implements `Feed`, imports its library in `open` or `topics` and nowhere else, and tells everything to a
`Listener`. A feed must never decode a message, write one, or let an exception into its library's threads.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from clients.robot.sensing.sensor_events import Refused, Sighting
from consensus.errors import BlockRobotError

CLOSE_MAX_S = 5.0
"""How long a feed may take to close, whatever state its middleware is in."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it came: `type` is `pkg/msg/Name`, `at_ns` the host's wall clock, in ns since 1970, when it came.

    `data` is in the feed's serialisation: ROS 1's own, or CDR.
    """

    topic: str
    type: str
    at_ns: int
    data: bytes


class Listener(Protocol):
    """What a feed tells what comes. Every method may be called from any thread, never blocks and never raises."""

    def learn(self, type_name: str, definition: str) -> None:
        """Take the definition of a type (`pkg/msg/Name`), as ROS writes it, for messages delivered from now on.

        The text may go on with the definitions of the types in it, each after a line of `=` and a line `MSG: pkg/Name`.
        """

    def deliver(self, message: Message, definition: str = "") -> None:
        """Take one message of a wanted topic; by `definition` it is read if its publisher told one with it."""

    def sight(self, sighting: Sighting) -> None:
        """Take one reading of a tag from a reader that needs no decoding."""

    def refuse(self, refused: Refused) -> None:
        """Take note of what came and could not be used even as a message or a reading; it is counted like any other."""

    def miss(self, topic: str, count: int) -> None:
        """Learn that the middleware lost so many messages of a topic on the way, by gaps in a publisher's numbers."""

    def presence(self, part: str, *, here: bool) -> None:
        """Learn that a part of the feed, a reader or a topic's only publisher, is gone for now, or is back."""

    def unusable(self, topic: str, error: BlockRobotError, *, for_good: bool) -> None:
        """Learn that a wanted topic cannot be heard as it is advertised now, and why; `for_good` says that it never can.

        `presence` tells when it can again.
        """

    def fail(self, error: BlockRobotError) -> None:
        """Learn that the feed is gone for good (FEED_LOST): what came before is worked through, and the run ends."""


class Feed(Protocol):
    """One middleware, or one reader. It is opened at most once; what it lost it takes up again by itself.

    `name` begins a sentence about it, `ros1` says that messages are in ROS 1's serialisation; all others are CDR.
    """

    name: str
    ros1: bool

    def topics(self) -> dict[str, str]:
        """Return what is advertised now: topic to type (`pkg/msg/Name`), nothing if the middleware has no topics.

        May be called before `open` and while the feed is open, from any thread. Raises FEED_UNREACHABLE,
        MIDDLEWARE_MISSING.
        """

    def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
        """Subscribe to `wanted`, topic to type (empty if nobody said), advertised already or not; return when done.

        Raises FEED_UNREACHABLE, MIDDLEWARE_MISSING.
        """

    def close(self) -> None:
        """End all threads of the feed within `CLOSE_MAX_S`; may be called twice, and before `open`."""

"""Bounded arrival queue: many writers, one reader.

When full, drops oldest images first, then sound, labels and odometry, tag readings last: a lost reading could misattribute
frames.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from clients.robot.sensing.sensor_events import RefusedMessage, Sighting
from clients.robot.sources.messages.message_types import Message, MessageTypes

QUEUE_MAX_COUNT = 20_000
QUEUE_MAX_BYTES = 128 * 1024 * 1024
ENTRY_BYTES = 512
"""What an entry takes in addition to its data, about."""

_LANES = {"frame": 0, "rgb": 0, "sighting": 2}
_OTHERS_LANE = 1


@dataclass(frozen=True, slots=True)
class Queued:
    """A message with types to decode, or decoded input, counted by `kind`."""

    kind: str
    what: tuple[Message, MessageTypes] | Sighting | RefusedMessage = field(repr=False)

    @property
    def size_bytes(self) -> int:
        return ENTRY_BYTES + (len(self.what[0].data) if isinstance(self.what, tuple) else 0)


class LiveQueue:
    """Bounded by `max_count` and `max_bytes`; `missed` counts drops by kind."""

    def __init__(self, max_count: int = QUEUE_MAX_COUNT, max_bytes: int = QUEUE_MAX_BYTES) -> None:
        self.missed: Counter[str] = Counter()
        self._max_count = max_count
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._lanes: tuple[deque[tuple[int, Queued]], ...] = (deque(), deque(), deque())
        self._put_count = 0
        self._bytes = 0
        self._wake: Callable[[], None] | None = None

    def __len__(self) -> int:
        with self._lock:
            return sum(len(lane) for lane in self._lanes)

    @property
    def size_bytes(self) -> int:
        with self._lock:
            return self._bytes

    def put(self, entry: Queued) -> None:
        """Add an entry, dropping any, even this one, without room."""
        with self._lock:
            self._put_count += 1
            self._lanes[_LANES.get(entry.kind, _OTHERS_LANE)].append((self._put_count, entry))
            self._bytes += entry.size_bytes
            while self._bytes > self._max_bytes or sum(map(len, self._lanes)) > self._max_count:
                _, dropped = next(lane for lane in self._lanes if lane).popleft()
                self._bytes -= dropped.size_bytes
                self.missed[dropped.kind] += 1
            wake, self._wake = self._wake, None
        if wake is not None:
            wake()

    def take(self, wake: Callable[[], None] | None = None) -> Queued | None:
        """Return the oldest, or None; `wake` is called from any thread."""
        with self._lock:
            oldest = min((lane for lane in self._lanes if lane), key=lambda lane: lane[0][0], default=None)
            if oldest is None:
                self._wake = wake
                return None
            _, entry = oldest.popleft()
            self._bytes -= entry.size_bytes
            return entry

    def clear(self) -> Counter[str]:
        """Return the number by kind."""
        with self._lock:
            left = Counter(entry.kind for lane in self._lanes for _, entry in lane)
            for lane in self._lanes:
                lane.clear()
            self._bytes, self._wake = 0, None
        return left

"""Records a run within a memory limit and reports what it dropped.

Over the limit, every second moment of the older half is dropped. Routine events have a share of their own and displace
no others.
"""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Sequence

import msgspec

from consensus.bounded_text import read_json_text
from network.console.console_documents import Dropped, KnownNetwork, NetworkFacts
from network.console.snapshots import ConsoleSnapshot
from network.console.timeline import ROUTINE_KINDS, Event

MOMENTS_MAX_BYTES = 12 * 1024 * 1024
EVENTS_MAX_COUNT = 4_000
ROUTINE_MAX_COUNT = 1_000
NETWORKS_MAX_COUNT = 500


class Recorder:
    """One run, from the console's start."""

    def __init__(
        self,
        moments_max_bytes: int = MOMENTS_MAX_BYTES,
        events_max_count: int = EVENTS_MAX_COUNT,
        routine_max_count: int = ROUTINE_MAX_COUNT,
    ) -> None:
        self._max_bytes = moments_max_bytes
        self._moments: list[bytes] = []
        self._times_ms: list[int] = []
        self._size_bytes = 0
        self._last: ConsoleSnapshot | None = None
        self._looked_ms = 0
        self._events: deque[Event] = deque(maxlen=events_max_count)
        self._routine: deque[Event] = deque(maxlen=routine_max_count)
        self._networks: deque[KnownNetwork] = deque(maxlen=NETWORKS_MAX_COUNT)
        self._number = 0
        self.moments_dropped_count = 0
        self.events_dropped_count = 0

    @property
    def size_bytes(self) -> int:
        return self._size_bytes

    @property
    def moments_count(self) -> int:
        return len(self._moments)

    @property
    def last_event_number(self) -> int:
        return self._number

    def note_network(self, at_ms: int, network: NetworkFacts) -> None:
        if not self._networks or self._networks[-1].network != network:
            self._networks.append(KnownNetwork(at_ms, network))

    def network_at(self, at_ms: int) -> NetworkFacts | None:
        """The network at a time, else the first known."""
        if not self._networks:
            return None
        place = bisect.bisect_right(self._networks, at_ms, key=lambda known: known.at_ms) - 1
        return self._networks[max(0, place)].network

    def networks(self) -> list[KnownNetwork]:
        return list(self._networks)

    def names(self) -> list[str]:
        return list(dict.fromkeys(node.name for known in self._networks for node in known.network.nodes))

    def add(self, moment: ConsoleSnapshot, events: Sequence[Event]) -> None:
        for event in events:
            self.tell(event)
        self._looked_ms = moment["at_ms"]
        if self._last is not None and {**moment, "at_ms": 0} == {**self._last, "at_ms": 0}:
            return
        self._last = moment
        data = msgspec.json.encode(moment)
        self._moments.append(data)
        self._times_ms.append(moment["at_ms"])
        self._size_bytes += len(data)
        if self._size_bytes > self._max_bytes:
            self._thin()

    def tell(self, event: Event) -> None:
        self._number += 1
        place = self._routine if event["kind"] in ROUTINE_KINDS else self._events
        self.events_dropped_count += len(place) == place.maxlen
        place.append({**event, "number": self._number})

    def _thin(self) -> None:
        while self._size_bytes > self._max_bytes and len(self._moments) > 3:
            half = max(3, len(self._moments) // 2)
            older, newer = self._moments[:half], self._moments[half:]
            kept = older[::2]
            self.moments_dropped_count += len(older) - len(kept)
            self._size_bytes -= sum(len(data) for data in older[1::2])
            self._moments = kept + newer
            self._times_ms = self._times_ms[:half:2] + self._times_ms[half:]

    def moment_at(self, at_ms: int) -> ConsoleSnapshot | None:
        """The newest at this time, else the first."""
        if not self._moments:
            return None
        place = max(0, bisect.bisect_right(self._times_ms, at_ms) - 1)
        moment: ConsoleSnapshot = read_json_text(self._moments[place])
        return moment

    def events_after(self, number: int) -> list[Event]:
        found = [event for place in (self._events, self._routine) for event in place if event["number"] > number]
        return sorted(found, key=lambda event: int(event["number"]))

    def dropped(self, rounds_count: int = 0) -> Dropped:
        """How many, and a sentence (empty: nothing dropped)."""
        counts = {
            "moments": self.moments_dropped_count,
            "events": self.events_dropped_count,
            "rounds": rounds_count,
        }
        counted = [f"{count} {what}" for what, count in counts.items() if count]
        words = f"To stay within its limit the recording dropped {', '.join(counted)} of long ago." if counted else ""
        return Dropped(**counts, words=words)

    def moments_json(self) -> bytes:
        """Oldest first, ending with the last poll."""
        moments = list(self._moments)
        if self._last is not None and self._looked_ms > self._times_ms[-1]:
            moments.append(msgspec.json.encode({**self._last, "at_ms": self._looked_ms}))
        return b"[" + b",".join(moments) + b"]"

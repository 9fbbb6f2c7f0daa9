"""Keeps a run within a limit of memory, and says what it dropped.

Pure. A moment that differs from the last one by its time alone is no news and is not kept twice. When moments take more
than their share, every second one of the older half goes: the whole run stays, the older the coarser. Of events the
routine ones (who leads, who is connected) have a share of their own, so that they drive out nothing else. Who is who is
kept with the time from which it was so: a moment is shown with the nodes of its time.
"""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Sequence
from typing import Any

import msgspec

from consensus.bounded_text import read_json_text
from network.console.chronicle import ROUTINE_KINDS, Event
from network.console.moments import Moment

MOMENTS_MAX_BYTES = 12 * 1024 * 1024
EVENTS_MAX_COUNT = 4_000
ROUTINE_MAX_COUNT = 1_000
NETWORKS_MAX_COUNT = 500


class Recorder:
    """One run, from when the console was opened."""

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
        self._last: Moment | None = None
        self._looked_ms = 0
        self._events: deque[Event] = deque(maxlen=events_max_count)
        self._routine: deque[Event] = deque(maxlen=routine_max_count)
        self._networks: deque[tuple[int, dict[str, Any]]] = deque(maxlen=NETWORKS_MAX_COUNT)
        self._number = 0
        self.moments_dropped_count = 0
        self.events_dropped_count = 0

    @property
    def size_bytes(self) -> int:
        """How much memory the moments take."""
        return self._size_bytes

    @property
    def moments_count(self) -> int:
        """How many moments are kept."""
        return len(self._moments)

    @property
    def last_event_number(self) -> int:
        """The number of the newest event; 0 before the first."""
        return self._number

    def note_network(self, at_ms: int, network: dict[str, Any]) -> None:
        """Keep who is who from this time on, if it is not as before."""
        if not self._networks or self._networks[-1][1] != network:
            self._networks.append((at_ms, network))

    def network_at(self, at_ms: int) -> dict[str, Any] | None:
        """Return who was who at this time, the first that is known for a time before; None if nothing is known."""
        if not self._networks:
            return None
        place = bisect.bisect_right(self._networks, at_ms, key=lambda known: known[0]) - 1
        return self._networks[max(0, place)][1]

    def networks(self) -> list[dict[str, Any]]:
        """Return who was who from when on, ready for JSON, oldest first."""
        return [{"at_ms": at_ms, "network": network} for at_ms, network in self._networks]

    def names(self) -> list[str]:
        """Return every node that the run has known, in the order in which they came."""
        return list(dict.fromkeys(node["name"] for _, network in self._networks for node in network["nodes"]))

    def add(self, moment: Moment, events: Sequence[Event]) -> None:
        """Keep a moment and what is new in it."""
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
        """Keep an event, and number it."""
        self._number += 1
        place = self._routine if event["kind"] in ROUTINE_KINDS else self._events
        self.events_dropped_count += len(place) == place.maxlen
        place.append({**event, "number": self._number})

    def _thin(self) -> None:
        """Drop every second moment of the older half (but the first) until the rest fits."""
        while self._size_bytes > self._max_bytes and len(self._moments) > 3:
            half = max(3, len(self._moments) // 2)
            older, newer = self._moments[:half], self._moments[half:]
            kept = older[::2]
            self.moments_dropped_count += len(older) - len(kept)
            self._size_bytes -= sum(len(data) for data in older[1::2])
            self._moments = kept + newer
            self._times_ms = self._times_ms[:half:2] + self._times_ms[half:]

    def moment_at(self, at_ms: int) -> Moment | None:
        """Return the moment that was the newest at this time, the first one for a time before; None if there is none."""
        if not self._moments:
            return None
        place = max(0, bisect.bisect_right(self._times_ms, at_ms) - 1)
        moment: Moment = read_json_text(self._moments[place])
        return moment

    def events_after(self, number: int) -> list[Event]:
        """Return the events behind this number, in order."""
        found = [event for place in (self._events, self._routine) for event in place if event["number"] > number]
        return sorted(found, key=lambda event: int(event["number"]))

    def dropped(self, rounds_count: int = 0) -> dict[str, Any]:
        """Return what is not there any more: counts, and a sentence (empty: nothing was dropped)."""
        counts = {
            "moments": self.moments_dropped_count,
            "events": self.events_dropped_count,
            "rounds": rounds_count,
        }
        said = [f"{count} {what}" for what, count in counts.items() if count]
        words = f"To stay within its limit the recording dropped {', '.join(said)} of long ago." if said else ""
        return {**counts, "words": words}

    def moments_json(self) -> bytes:
        """Return all moments as one JSON array, oldest first; the last one is that of the last look, changed or not."""
        moments = list(self._moments)
        if self._last is not None and self._looked_ms > self._times_ms[-1]:
            moments.append(msgspec.json.encode({**self._last, "at_ms": self._looked_ms}))
        return b"[" + b",".join(moments) + b"]"

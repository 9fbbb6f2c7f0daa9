"""Decides when ROS 2 discovery is complete, since DDS never says so."""

from __future__ import annotations

from collections.abc import Mapping

OWN_TOPIC = "/parameter_events"
"""What every node publishes, ours too, and nobody wants of it."""

SETTLED_S = 1.0
"""For how long nothing new is to be heard of."""

LOOK_MIN_S, LOOK_MAX_S = 4.0, 8.0
"""Who is lost in the first packets is heard of with the next announcement, which Fast DDS makes every three seconds
(`leaseDuration_announcementperiod`). Of an empty graph only time tells that it is empty."""


class Discovery:
    """Discovery since `started_s`, in monotonic seconds."""

    def __init__(self, started_s: float) -> None:
        self.found: dict[str, str] = {}
        self._started_s = self._changed_s = started_s

    def is_known(self, advertised: Mapping[str, str], now_s: float) -> bool:
        """Return whether the advertised topics (by type) are complete."""
        if advertised != self.found:
            self.found, self._changed_s = dict(advertised), now_s
        looked_s = now_s - self._started_s
        if looked_s < LOOK_MIN_S or not self.found.keys() - {OWN_TOPIC}:
            return looked_s >= LOOK_MAX_S
        return now_s - self._changed_s >= SETTLED_S or looked_s >= LOOK_MAX_S

"""Reports feed topics falling silent, vanishing or returning; no own clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping

SILENT_AFTER_S = 5.0


class Watch:
    """Watches a feed's `wanted` topics, and silence of `camera`."""

    def __init__(self, name: str, wanted: Collection[str], camera: str) -> None:
        self.gone: Counter[str] = Counter()
        self._name = name
        self._wanted = sorted(wanted)
        self._camera = camera
        self._there: dict[str, bool] = {}
        self._reachable = True
        self._silent_since_s: float | None = None

    def look(self, advertised: Mapping[str, str] | None) -> list[str]:
        """Return changes; `advertised` None: the feed does not answer."""
        if advertised is None:
            told = [f"{self._name} does not answer; what is connected goes on."] if self._reachable else []
            self._reachable = False
            return told
        told = [] if self._reachable else [f"{self._name} answers again."]
        self._reachable = True
        for topic in self._wanted:
            is_there = topic in advertised
            if is_there and self._there.get(topic) is False:
                told.append(f"{topic} is there.")
            elif not is_there and self._there.get(topic, True):
                self.gone[topic] += topic in self._there
                told.append(f"{topic} is not advertised; it is waited for.")
            self._there[topic] = is_there
        return told

    def listen(self, now_s: float, heard_s: float) -> list[str]:
        """Return changes, by present and last-heard seconds of one clock."""
        if now_s - heard_s >= SILENT_AFTER_S:
            is_new = self._silent_since_s is None
            self._silent_since_s = heard_s if is_new else self._silent_since_s
            return [f"{self._camera} is silent: no frame for {SILENT_AFTER_S:g} s."] if is_new else []
        if self._silent_since_s is None:
            return []
        lasted_s, self._silent_since_s = heard_s - self._silent_since_s, None
        return [f"{self._camera} is heard again, after {max(lasted_s, SILENT_AFTER_S):.0f} s."]

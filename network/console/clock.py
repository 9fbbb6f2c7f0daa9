"""A recording clock: ms since 1970, never going back."""

from __future__ import annotations

import time
from collections.abc import Callable


def _wall_ms() -> int:
    return time.time_ns() // 1_000_000


class ForwardClock:
    """Follows the machine's clock; after a setback it continues, ahead by as much."""

    def __init__(self, wall_ms: Callable[[], int] = _wall_ms) -> None:
        self._wall_ms = wall_ms
        self._last_ms = 0
        self._ahead_ms = 0

    def now_ms(self) -> int:
        now_ms = self._wall_ms() + self._ahead_ms
        if now_ms < self._last_ms:
            self._ahead_ms += self._last_ms - now_ms
            now_ms = self._last_ms
        self._last_ms = now_ms
        return now_ms

"""Measures time without finality; informational only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from consensus.chain.epoch_settings import ChainSettings, parse_production

LATE_MIN_S = 5.0
LATE_TIMEOUTS_COUNT = 6
"""Work that has waited for so many base timeouts, and for LATE_MIN_S at least, has waited for too long."""


class StallDetector:
    """Seconds since the newest final block (or start), and with work waiting."""

    def __init__(self, stopwatch: Callable[[], float], settings: Callable[[], ChainSettings]) -> None:
        """`stopwatch`: monotonic seconds; `settings`: those of the current epoch."""
        self._stopwatch = stopwatch
        self._settings = settings
        self._final_s = stopwatch()
        self._waiting_since_s: float | None = None

    def note_final(self, _blocks: Sequence[object], _proof: object, _position: object) -> None:
        self._final_s = self._stopwatch()
        self._waiting_since_s = None

    def look(self, waiting_count: int) -> None:
        if not waiting_count:
            self._waiting_since_s = None
        elif self._waiting_since_s is None:
            self._waiting_since_s = self._stopwatch()

    def describe(self) -> dict[str, Any]:
        now_s = self._stopwatch()
        age_s = now_s - self._final_s
        waiting_s = 0.0 if self._waiting_since_s is None else now_s - self._waiting_since_s
        return {"age_s": round(age_s, 1), "waiting_s": round(waiting_s, 1), "late": self._is_late(age_s, waiting_s)}

    def gauges(self) -> dict[str, tuple[str, Callable[[], float]]]:
        return {
            "blockrobot_finality_age_seconds": (
                "Time since a block became final here, or since the start.",
                lambda: self._stopwatch() - self._final_s,
            ),
            "blockrobot_finality_late": (
                "1 while a final block is overdue, by the chain's settings.",
                lambda: float(self.describe()["late"]),
            ),
        }

    def _is_late(self, age_s: float, waiting_s: float) -> bool:
        settings = self._settings()
        limit_s = max(LATE_MIN_S, LATE_TIMEOUTS_COUNT * settings.base_timeout_ms / 1000)
        interval_ms = parse_production(settings.production)
        if interval_ms is None:
            return False
        idle_s = (interval_ms or settings.heartbeat_ms) / 1000
        return waiting_s > limit_s or age_s > idle_s + limit_s

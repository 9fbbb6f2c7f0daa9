"""Measures time without finality, and the clock by new blocks; informational only."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from consensus.chain.epoch_settings import ChainSettings, parse_production
from node.storage.ledger_store import Position

LATE_MIN_S = 5.0
LATE_TIMEOUTS_COUNT = 6
"""Work that has waited for so many base timeouts, and for LATE_MIN_S at least, has waited for too long."""
CLOCK_BLOCKS_COUNT = 3
"""So many blocks in a row have to disagree with the clock: one may be late, or of a producer whose clock is wrong."""


class StallDetector:
    """Seconds since the newest final block (or start), and with work waiting."""

    def __init__(
        self,
        stopwatch: Callable[[], float],
        settings: Callable[[], ChainSettings],
        clock: Callable[[], int],
        is_catching_up: Callable[[], bool],
    ) -> None:
        """`stopwatch`: monotonic seconds; `settings`: those of the current epoch; `clock`: ms since 1970."""
        self._is_catching_up = is_catching_up
        self._stopwatch = stopwatch
        self._clock = clock
        self._lags_ms: deque[int] = deque(maxlen=CLOCK_BLOCKS_COUNT)
        self._settings = settings
        self._final_s = stopwatch()
        self._waiting_since_s: float | None = None

    def note_final(self, _blocks: Sequence[object], _proof: object, position: Position) -> None:
        if self._is_catching_up():
            self._lags_ms.clear()  # old blocks say nothing of the clock
        else:
            self._lags_ms.append(self._clock() - position.timestamp_ms)
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
        late = self._is_late(age_s, waiting_s)
        error_s = 0.0 if late else round(self._clock_error_ms() / 1000, 1)
        return {"age_s": round(age_s, 1), "waiting_s": round(waiting_s, 1), "late": late, "clock_error_s": error_s}

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

    def _clock_error_ms(self) -> int:
        """By how much the clock is ahead (behind, if negative) of new final blocks; 0 within what is usual."""
        settings, interval_ms = self._settings(), parse_production(self._settings().production)
        if len(self._lags_ms) < CLOCK_BLOCKS_COUNT:
            return 0
        # An empty block becomes final when the next one is due.
        usual_ms = self._limit_s() * 1000 + (interval_ms or settings.heartbeat_ms)
        is_ahead = interval_ms is not None and min(self._lags_ms) > settings.max_clock_drift_ms + usual_ms
        is_behind = max(self._lags_ms) < -settings.max_clock_drift_ms
        return min(self._lags_ms) if is_ahead or is_behind else 0

    def _limit_s(self) -> float:
        return max(LATE_MIN_S, LATE_TIMEOUTS_COUNT * self._settings().base_timeout_ms / 1000)

    def _is_late(self, age_s: float, waiting_s: float) -> bool:
        settings = self._settings()
        limit_s = self._limit_s()
        interval_ms = parse_production(settings.production)
        if interval_ms is None:
            return False
        idle_s = (interval_ms or settings.heartbeat_ms) / 1000
        return waiting_s > limit_s or age_s > idle_s + limit_s

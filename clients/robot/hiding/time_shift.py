"""Detects clock delays of tag distances; reporting only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clients.robot.hiding.tracking import Track
from clients.robot.sensing.sensor_events import Sighting

SHIFT_MAX_MS = 4_000
SHIFT_STEP_MS = 250
READINGS_MIN_COUNT = 8
READINGS_LOOKED_AT_MAX_COUNT = 64
_BETTER = 0.4  # the spread that is left must be this small beside the one without a shift
_SIGMAS_LEFT = 2.5  # and no more than so many stated errors


def find_delay_ms(readings: Sequence[Sighting], track: Track) -> int | None:
    """Return delay in ms, None if no shift helps."""
    measured = [reading for reading in readings if reading.distance_m is not None][-READINGS_LOOKED_AT_MAX_COUNT:]
    if len(measured) < READINGS_MIN_COUNT or not track.times:
        return None
    at_ms = np.array([reading.middle_ms for reading in measured], dtype=np.float64)
    distances = np.array([reading.distance_m for reading in measured], dtype=np.float64)
    sigma_m = float(np.mean([reading.sigma_m or 0.0 for reading in measured]))
    times, ranges = np.array(track.times, dtype=np.float64), np.array(track.ranges)
    found = {}
    for shift_ms in sorted(range(-SHIFT_MAX_MS, SHIFT_MAX_MS + 1, SHIFT_STEP_MS), key=abs):
        then_ms = at_ms - shift_ms
        inside = (then_ms >= times[0]) & (then_ms <= times[-1])
        if np.count_nonzero(inside) >= max(READINGS_MIN_COUNT, len(measured) // 2):
            gaps = distances[inside] - np.interp(then_ms[inside], times, ranges)
            found[shift_ms] = float(np.sqrt(np.mean(gaps * gaps)))
    if 0 not in found:
        return None
    best_ms = min(found, key=lambda shift_ms: found[shift_ms])
    is_better = found[best_ms] <= min(_BETTER * found[0], _SIGMAS_LEFT * sigma_m)
    return best_ms if best_ms and is_better else None

"""Forecasts time to bind a lone person, by simulating the matcher."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from clients.robot.hiding.matcher import Matcher
from clients.robot.hiding.tracking import Track
from clients.robot.sensing.sensor_events import Facing, Sighting

FORECAST_S = 30
FRAME_EVERY_MS = 100
_STANDS_AT_M = 2.5
_WALKS_M, _WALKS_EVERY_S = 1.0, 8.0  # to and fro by a metre, a turn every eight seconds: about 0.8 m/s at most


@lru_cache(maxsize=128)
def time_to_bind_s(sigma_m: float, facing: Facing, every_ms: int, *, walks: bool, seed: int = 1) -> float | None:
    """Return seconds until binding, None if over `FORECAST_S`; error `sigma_m`."""
    noise = np.random.default_rng(seed)
    matcher, track = Matcher(), Track(1, 0, 0, 0.0, _STANDS_AT_M)
    matcher.add_track(track)
    for at_ms in range(0, FORECAST_S * 1000, FRAME_EVERY_MS):
        turn = math.sin(2 * math.pi * at_ms / 1000 / _WALKS_EVERY_S) if walks else 0.0
        range_m = _STANDS_AT_M + _WALKS_M * turn
        track.times.append(at_ms)
        track.ranges.append(range_m)
        track.seen_ms = at_ms
        if at_ms % every_ms == 0:
            distance_m = max(0.01, range_m + float(noise.normal(0.0, sigma_m)))
            matcher.add_sighting("tag", Sighting(at_ms, at_ms, "tag", 0, facing, 0.0, distance_m, sigma_m))
        matcher.advance(at_ms)
        if matcher.bound_track("tag", [1]) is not None:
            return at_ms / 1000
    return None

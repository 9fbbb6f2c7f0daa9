"""Measures how far apart two antennas hear a tag, by the bearing at which the camera sees its bearer walk.

The line is fitted by repeated medians (Siegel 1982), which half of the readings, by reflections, cannot bend.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from clients.robot.sensing.antenna_pairs import PAIRED_WITHIN_MS, AntennaPair
from clients.robot.sensing.sensor_events import BEARING_SIGMA_MAX_DEG, RSSI_UNKNOWN_DBM, Sighting
from consensus.errors import BlockRobotError

READINGS_MIN_COUNT = 60  # of both antennas together
READINGS_MAX_COUNT = 2_000  # repeated medians take the square of it
TURN_MIN_DEG = 20.0  # between the tenth and the ninetieth of a hundred readings
SEEN_WITHIN_MS = 200
SLOPE_MIN_ERRORS = 5.0  # a slope counts if it is so many of its standard errors
ANTENNAS_MAX_COUNT = 32

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Pairs that tell bearings, the most exact first; `readings`: used of each; `turn_deg`: how far the bearer walked."""

    pairs: tuple[AntennaPair, ...]
    readings: tuple[int, ...]
    turn_deg: float


def calibrate(seen: Sequence[tuple[int, float]], sightings: Sequence[Sighting]) -> Calibration:
    """Fit all pairs of one tag's readings. `seen`: (ms, degrees) of the bearer, by the camera, in time order.

    Raises CALIBRATION_FAILED (`few-readings`, `one-antenna`, `little-turn`, `no-slope`).
    """
    times, bearings = [at for at, _ in seen], [bearing for _, bearing in seen]
    heard: dict[tuple[str, int], list[tuple[int, float]]] = {}
    for sighting in (one for one in sightings if one.rssi_dbm != RSSI_UNKNOWN_DBM):
        heard.setdefault((sighting.origin, sighting.antenna), []).append((sighting.middle_ms, sighting.rssi_dbm))
    if len(heard) < 2:
        raise _failed(
            "one-antenna",
            "Readings with an RSSI came from one antenna or none: two are needed that look to different sides.",
        )
    fits, most_count, most_deg = [], 0, 0.0
    loudest = sorted(heard, key=lambda one: -len(heard[one]))[:ANTENNAS_MAX_COUNT]
    for first, second in combinations(sorted(loudest), 2):
        if first[0] != second[0]:
            continue
        at_deg, contrast_db = _compare(heard[first], heard[second], times, bearings)
        most_count = max(most_count, at_deg.size)
        if at_deg.size < READINGS_MIN_COUNT:
            continue
        turn_deg = float(np.ptp(np.quantile(at_deg, (0.1, 0.9))))
        most_deg = max(most_deg, turn_deg)
        pair = _fit(first, second[1], at_deg, contrast_db) if turn_deg >= TURN_MIN_DEG else None
        if pair is not None:
            fits.append((pair, int(at_deg.size)))
    if most_count < READINGS_MIN_COUNT:
        raise _failed(
            "few-readings",
            f"Two antennas heard the tag at one time {most_count} times, in sight of the camera; {READINGS_MIN_COUNT} are "
            "needed. Walk longer.",
        )
    if most_deg < TURN_MIN_DEG:
        raise _failed(
            "little-turn",
            f"Its bearer stayed within {most_deg:.0f} degrees; {TURN_MIN_DEG:.0f} are needed. Walk from one side of the "
            "picture to the other.",
        )
    if not fits:
        raise _failed("no-slope", "No two antennas hear the tag differently on the two sides: turn them apart.")
    fits.sort(key=lambda fit: fit[0].sigma_deg)
    return Calibration(tuple(pair for pair, _ in fits), tuple(count for _, count in fits), most_deg)


def _compare(
    left: list[tuple[int, float]], right: list[tuple[int, float]], times: list[int], bearings: list[float]
) -> tuple[Floats, Floats]:
    """Return bearings (degrees) and right minus left (dB), each reading used once."""
    at_deg, contrast_db = [], []
    rest = sorted(right)
    for at_ms, left_dbm in sorted(left):
        place = bisect_left(rest, (at_ms, -math.inf))
        near = [i for i in (place - 1, place) if 0 <= i < len(rest)]
        best = min(near, key=lambda i: abs(rest[i][0] - at_ms), default=None)
        if best is None or abs(rest[best][0] - at_ms) > PAIRED_WITHIN_MS:
            continue
        other_ms, right_dbm = rest.pop(best)
        bearing_deg = _bearing_at((at_ms + other_ms) // 2, times, bearings)
        if bearing_deg is not None:
            at_deg.append(bearing_deg)
            contrast_db.append(right_dbm - left_dbm)
    return np.array(at_deg[-READINGS_MAX_COUNT:]), np.array(contrast_db[-READINGS_MAX_COUNT:])


def _bearing_at(at_ms: int, times: list[int], bearings: list[float]) -> float | None:
    place = bisect_left(times, at_ms)
    near = [i for i in (place - 1, place) if 0 <= i < len(times)]
    best = min(near, key=lambda i: abs(times[i] - at_ms), default=None)
    return None if best is None or abs(times[best] - at_ms) > SEEN_WITHIN_MS else bearings[best]


def _fit(first: tuple[str, int], second: int, at_deg: Floats, contrast_db: Floats) -> AntennaPair | None:
    from scipy.stats import siegelslopes  # noqa: PLC0415 - takes half of the start of every robot's command

    slope, offset = (float(value) for value in siegelslopes(contrast_db, at_deg))
    sigma_db = float(np.std(contrast_db - offset - slope * at_deg, ddof=2))
    error = sigma_db / (float(np.std(at_deg)) * math.sqrt(at_deg.size))
    if abs(slope) < SLOPE_MIN_ERRORS * error or sigma_db > BEARING_SIGMA_MAX_DEG * abs(slope):
        return None
    origin, number = first
    left, right = (number, second) if slope > 0 else (second, number)
    sign = 1.0 if slope > 0 else -1.0
    made = AntennaPair(left, right, round(sign * offset, 2), round(abs(slope), 3), round(sigma_db, 2), origin)
    return made if made.is_usable() else None


def _failed(reason: str, detail: str) -> BlockRobotError:
    return BlockRobotError("CALIBRATION_FAILED", detail, reason=reason)

"""Draws the matcher's test cases: 30 s of people and one tag's readings, with truth.

Independent of the matcher's constants: changing them there leaves the draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from clients.robot.matching.tracking import Track
from clients.robot.sensing.sensor_events import Facing, Sighting

TRACK_MS = 30_000
FRAME_EVERY_MS = 100
MISSED_SHARE = 0.3
STANDING_SHARE = 0.4
BIAS_SIGMA_M = 0.15
OUTLIER_SHARE, OUTLIER_MAX_M = 0.1, 4.0  # reflections: a reading that is too far by up to so much
RANGE_SCALE_SIGMA, RANGE_NOISE_M = 0.03, 0.10  # a camera's range: a factor of each person's, and noise of each frame's
NEAREST_M, FARTHEST_M = 0.8, 6.0
DRIFT_S = 2.0
# How often the antenna that faces as the camera does hears a tag: Beta of each draw. Who is aside stands in front of
# the robot but beside the picture, and keeps at the range of somebody in view as others do.
FRONT_SHARES = {"present": (18, 2), "absent": (4, 16), "behind": (2, 18), "aside": (18, 2)}
WEAK_FRONT_SHARES = {"present": (12, 4), "absent": (6, 10), "behind": (4, 12), "aside": (12, 4)}

# Bearings: of whoever is in the picture, and of a bearer who is not, by where they are: from, to, on either side.
VIEW_MAX_DEG = 28.0
BEARINGS_DEG = {"absent": (32.0, 180.0), "behind": (100.0, 180.0), "aside": (32.0, 60.0)}
WALK_M_PER_S, BEARING_SPEED_DEG_S = 0.6, 12.0
BEARING_BIAS_SIGMA_DEG, BEARING_BIAS_OFF_SIGMA_DEG = 4.0, 10.0
BEARING_OUTLIER_SHARE, BEARING_OUTLIER_MAX_DEG = 0.15, 90.0
BEARING_UNDERSTATED, BEARING_OFF_DRIFT_S = 1.5, 6.0

Bearer = Literal["present", "absent", "behind", "aside"]
Array = npt.NDArray[np.float64]
_TIMES_MS = list(range(0, TRACK_MS + 1, FRAME_EVERY_MS))
TIMES_S = np.array(_TIMES_MS) / 1000


@dataclass(frozen=True, slots=True)
class Setting:
    """One draw's parameters: reading rate, distance error, reader's data."""

    rate_hz: int
    sigma_m: float
    people: int
    bearer: Bearer
    understated: bool = False
    drifting: bool = False
    facing: bool = True
    distance: bool = True
    bias_sigma_m: float = BIAS_SIGMA_M
    drift_s: float = DRIFT_S
    weak_fronts: bool = False
    outliers: bool = False
    ranges_off: bool = False
    bearing_sigma_deg: float | None = None
    bearings_off: bool = False


@dataclass(frozen=True, slots=True)
class Drawn:
    """Tracks, readings in time order, the bearer's track (None: not in view), gap.

    `gap_m`: mean range difference between bearer and nearest other person.
    """

    setting: Setting
    tracks: tuple[Track, ...]
    readings: tuple[Sighting, ...]
    bearer: int | None
    gap_m: float


def draw(setting: Setting, seed: int, number: int) -> Drawn:
    rng = np.random.default_rng([seed, number])
    near = _walk(rng)
    ranges = [near, *(_beside(rng, near) for _ in range(setting.people - 1))]
    if setting.bearer == "present":
        owner = int(rng.integers(setting.people))
        worn, others = ranges[owner], [other for i, other in enumerate(ranges) if i != owner]
    else:
        owner = -1
        worn, others = _beside(rng, near) if setting.bearer == "aside" else _walk(rng), ranges
    gaps = [float(np.abs(worn - other).mean()) for other in others]
    readings = draw_readings(rng, setting, worn)
    seen = [as_measured(rng, values) if setting.ranges_off else values for values in ranges]
    tracks = tuple(_track(i + 1, values) for i, values in enumerate(seen))
    if setting.bearing_sigma_deg is not None:
        # Chance of its own, so that draws without bearings stay as they are.
        rng = np.random.default_rng([seed, number, 1])
        readings = add_bearings(rng, setting, readings, _draw_bearings(rng, setting, tracks, owner))
    return Drawn(setting, tracks, readings, owner + 1 if owner >= 0 else None, min(gaps, default=np.inf))


def _walk(rng: np.random.Generator) -> Array:
    start = float(rng.uniform(1.2, 5.0))
    sway = 0.03 * np.sin(TIMES_S * rng.uniform(0.5, 1.5) + rng.uniform(0, 6))
    if rng.random() < STANDING_SHARE:
        return np.asarray(start + sway)
    return _reflect(start + wander(rng, WALK_M_PER_S)) + sway


def wander(rng: np.random.Generator, speed_sigma: float) -> Array:
    places = np.sort(rng.uniform(0, TRACK_MS / 1000, size=6))
    speeds = np.where(rng.random(7) < 0.25, 0.0, rng.normal(0, speed_sigma, size=7))
    return np.asarray(np.cumsum(speeds[np.searchsorted(places, TIMES_S)] * FRAME_EVERY_MS / 1000))


def _beside(rng: np.random.Generator, other: Array) -> Array:
    kind = rng.random()
    if kind < 0.5:
        return _walk(rng)
    offset = float(rng.choice([-1, 1]) * rng.uniform(0.1, 1.5))
    if kind < 0.8:
        return _reflect(other + offset + 0.05 * np.sin(TIMES_S * rng.uniform(0.5, 2)))
    mine = _walk(rng)
    return _reflect(mine - mine[0] + other[0] + offset)


def _reflect(values: Array, least: float = NEAREST_M, most: float = FARTHEST_M) -> Array:
    width = most - least
    return np.asarray(least + width - np.abs(np.mod(values - least, 2 * width) - width))


def as_measured(rng: np.random.Generator, ranges: Array) -> Array:
    factor = 1 + float(rng.normal(0, RANGE_SCALE_SIGMA))
    return np.asarray(ranges * factor + rng.normal(0, RANGE_NOISE_M, size=ranges.size))


def _track(number: int, ranges: Array) -> Track:
    track = Track(number, 0, TRACK_MS, 0.0, float(ranges[-1]))
    track.times, track.ranges, track.bearings = list(_TIMES_MS), ranges.tolist(), [0.0] * ranges.size
    return track


def draw_readings(
    rng: np.random.Generator, setting: Setting, worn: Array, front_share: Array | None = None
) -> tuple[Sighting, ...]:
    """`worn`: the tag's range; `front_share`: how often it is heard in front, None: as often as the setting's bearer is."""
    every_ms = 1000 / setting.rate_hz
    asked = np.arange(rng.uniform(0, every_ms), TRACK_MS, every_ms)
    times = np.floor(asked[rng.random(asked.size) >= MISSED_SHARE]).astype(np.int64)
    true_sigma = setting.sigma_m * (2 if setting.understated else 1)
    noise = _drifting(rng, times, setting.drift_s) if setting.drifting else rng.normal(size=times.size)
    ranges = np.interp(times / 1000, TIMES_S, worn)
    distances = np.maximum(0.05, ranges + float(rng.normal(0, setting.bias_sigma_m)) + true_sigma * noise)
    front = rng.random(times.size) < (
        rng.beta(*front_shares(setting)[setting.bearer])
        if front_share is None
        else np.interp(times / 1000, TIMES_S, front_share)
    )
    if setting.outliers:
        distances += rng.uniform(0, OUTLIER_MAX_M, times.size) * (rng.random(times.size) < OUTLIER_SHARE)
    made = []
    for at, distance, ahead in zip(times.tolist(), distances.tolist(), front.tolist(), strict=True):
        facing = (Facing.FRONT if ahead else Facing.BACK) if setting.facing else Facing.UNKNOWN
        measured = (distance, setting.sigma_m) if setting.distance else (None, None)
        made.append(Sighting(at, at, "", 1 if ahead else 2, facing, -50.0, *measured))
    return tuple(made)


def front_shares(setting: Setting) -> dict[str, tuple[int, int]]:
    return WEAK_FRONT_SHARES if setting.weak_fronts else FRONT_SHARES


def _draw_bearings(rng: np.random.Generator, setting: Setting, tracks: Sequence[Track], owner: int) -> Array:
    """Give every track its bearings; return the bearer's."""
    for track in tracks:
        track.bearings = _turn(rng, -VIEW_MAX_DEG, VIEW_MAX_DEG).tolist()
    if owner >= 0:
        return np.array(tracks[owner].bearings)
    return float(rng.choice([-1, 1])) * _turn(rng, *BEARINGS_DEG[setting.bearer])


def add_bearings(
    rng: np.random.Generator, setting: Setting, readings: tuple[Sighting, ...], worn: Array
) -> tuple[Sighting, ...]:
    """Give every reading the tag's bearing, `worn`, as the reader measures it."""
    times = np.array([reading.middle_ms for reading in readings], dtype=np.int64)
    off, sigma_deg = setting.bearings_off, setting.bearing_sigma_deg or 0.0
    noise = _drifting(rng, times, BEARING_OFF_DRIFT_S) if off else rng.normal(size=times.size)
    bias = float(rng.normal(0, BEARING_BIAS_OFF_SIGMA_DEG if off else BEARING_BIAS_SIGMA_DEG))
    measured = np.interp(times / 1000, TIMES_S, worn) + bias
    measured += sigma_deg * (BEARING_UNDERSTATED if off else 1) * noise
    if off:
        reflected = rng.random(times.size) < BEARING_OUTLIER_SHARE
        measured += rng.uniform(-BEARING_OUTLIER_MAX_DEG, BEARING_OUTLIER_MAX_DEG, times.size) * reflected
    return tuple(
        replace(reading, bearing_deg=bearing, bearing_sigma_deg=sigma_deg)
        for reading, bearing in zip(readings, ((measured + 180) % 360 - 180).tolist(), strict=True)
    )


def _turn(rng: np.random.Generator, least_deg: float, most_deg: float) -> Array:
    start = float(rng.uniform(least_deg, most_deg))
    if rng.random() < STANDING_SHARE:
        return np.full(TIMES_S.size, start)
    return _reflect(start + wander(rng, BEARING_SPEED_DEG_S), least_deg, most_deg)


def _drifting(rng: np.random.Generator, times: npt.NDArray[np.int64], drift_s: float) -> Array:
    """Return unit-variance errors whose correlation falls to 1/e in `drift_s`."""
    fresh = rng.normal(size=times.size)
    values = np.empty(times.size)
    before, last = 0.0, None
    for i, at in enumerate(times.tolist()):
        kept = 0.0 if last is None else float(np.exp(-(at - last) / 1000 / drift_s))
        before = kept * before + float(np.sqrt(1 - kept * kept)) * float(fresh[i])
        values[i], last = before, at
    return values

"""How the robot drives: speeds with smooth accelerations, the way that follows, and how its body wobbles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Manoeuvre = Literal["straight", "curve", "turn", "stop", "to-and-fro"]
Track = tuple[tuple[float, float, float, float], ...]
"""(t, x, z, yaw): seconds, metres, radians to the right, not wrapped."""
Knot = tuple[float, float, float]
"""(t, speed in m/s, turn in radians/s)."""

STEP_S = 0.01
KEPT_STEPS_COUNT = 4
EASING_S = 1.2  # from one speed to another; 1 m/s then needs at most 1.25 m/s2
WOBBLE_MAX_RAD = math.radians(0.5)
STEADY_MPS, STEADY_RADPS = 0.3, 0.3  # from here on the body wobbles as it does at full speed


def draw_speeds(rng: np.random.Generator, manoeuvre: Manoeuvre, duration_s: float) -> tuple[Knot, ...]:
    """Speeds change smoothly between knots; the last stays."""
    speed = float(rng.uniform(0.2, 1.0))
    rolls = bool(rng.random() < 0.5)
    start = (0.0, speed if rolls else 0.0, 0.0)
    if manoeuvre == "straight":
        return start, (EASING_S, speed, 0.0)
    if manoeuvre == "stop":
        begin, rest = float(rng.uniform(0.25, 0.4)) * duration_s, float(rng.uniform(1.5, 2.5))
        times = (begin, begin + EASING_S, begin + EASING_S + rest, begin + 2 * EASING_S + rest)
        stopped: list[Knot] = [(t, v, 0.0) for t, v in zip(times, (speed, 0.0, 0.0, speed), strict=True)]
        return start, (EASING_S, speed, 0.0), *stopped
    side = float(rng.choice([-1.0, 1.0]))
    if manoeuvre == "to-and-fro":
        speed = float(rng.uniform(0.2, 0.6))
        back = float(rng.uniform(0.3, 0.4)) * duration_s
        again = back + 2 * EASING_S + float(rng.uniform(0.5, 2.0))
        knots: list[Knot] = [(0.0, 0.0, 0.0), (EASING_S, speed, 0.0), (back, speed, 0.0)]
        knots += [(back + 2 * EASING_S, -speed, 0.0), (again, -speed, 0.0), (again + 2 * EASING_S, speed, 0.0)]
        return tuple(knots)
    if manoeuvre == "turn":
        turn = side * math.radians(float(rng.uniform(10, 40)))
        pause = float(rng.uniform(0.4, 0.6)) * duration_s
        after = -turn if rng.random() < 0.4 else turn
        return (0.0, 0.0, 0.0), (1.0, 0.0, turn), (pause, 0.0, turn), (pause + 1.5, 0.0, after)
    speed, turn = float(rng.uniform(0.2, 0.7)), side * math.radians(float(rng.uniform(5, 20)))
    middle = float(rng.uniform(0.4, 0.6)) * duration_s
    after = float(rng.choice([-1.0, 0.0, 1.0])) * turn
    start = (0.0, speed if rolls else 0.0, 0.0)
    return start, (EASING_S, speed, turn), (middle, speed, turn), (middle + EASING_S, speed, after)


def drive_along(knots: tuple[Knot, ...], duration_s: float) -> Track:
    """Return the way of a robot that starts at the origin and looks ahead."""
    times = np.arange(0.0, duration_s + 1.5 * STEP_S * KEPT_STEPS_COUNT, STEP_S)
    speed, turn = _eased(times, knots, 1), _eased(times, knots, 2)
    yaw = np.concatenate([[0.0], np.cumsum(turn * STEP_S)[:-1]])
    middle = yaw + 0.5 * STEP_S * turn
    x, z = (np.concatenate([[0.0], np.cumsum(speed * part(middle) * STEP_S)[:-1]]) for part in (np.sin, np.cos))
    table = np.stack([times, x, z, yaw], axis=1)[::KEPT_STEPS_COUNT]
    return tuple((round(float(t), 6), float(x), float(z), float(yaw)) for t, x, z, yaw in table)


def move_track(track: Track, x: float, z: float, yaw: float) -> Track:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return tuple((t, x + px * cos + pz * sin, z - px * sin + pz * cos, yaw + turned) for t, px, pz, turned in track)


def _eased(times: npt.NDArray[np.float64], knots: tuple[Knot, ...], what: int) -> npt.NDArray[np.float64]:
    at = np.array([knot[0] for knot in knots])
    values = np.array([knot[what] for knot in knots])
    after = np.clip(np.searchsorted(at, times, side="right"), 1, len(at) - 1)
    share = np.clip((times - at[after - 1]) / (at[after] - at[after - 1]), 0.0, 1.0)
    eased = share * share * (3 - 2 * share)
    return np.asarray(values[after - 1] + (values[after] - values[after - 1]) * eased)


@dataclass(frozen=True, slots=True)
class Wobble:
    """Waves (radians, hertz, phase) of a driving robot's body, of its pitch and of its roll."""

    pitch: tuple[tuple[float, float, float], ...] = ()
    roll: tuple[tuple[float, float, float], ...] = ()

    def at(self, at_s: float, driving: float) -> tuple[float, float]:
        """Return (pitch, roll) at a time; `driving` is 0 (stands) to 1."""
        first, second = (
            driving * sum(size * math.sin(2 * math.pi * hertz * at_s + phase) for size, hertz, phase in waves)
            for waves in (self.pitch, self.roll)
        )
        return first, second


def draw_wobble(rng: np.random.Generator) -> Wobble:
    def waves() -> tuple[tuple[float, float, float], ...]:
        size = float(rng.uniform(0.1, 1.0)) * WOBBLE_MAX_RAD
        return tuple(
            (share * size, float(rng.uniform(0.7, 4.0)), float(rng.uniform(0, 2 * math.pi))) for share in (0.6, 0.4)
        )

    return Wobble(waves(), waves())

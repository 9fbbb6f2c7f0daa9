"""What the robot's wheels say of its way: drift, delay, and faults that can be switched on. Deterministic by seed."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from clients.robot.synthetic.driving.robot_motion import Track

Fault = Literal["jump", "stop", "slip", "gap", "clock"]
FAULTS: tuple[Fault, ...] = get_args(Fault)

RATE_HZ = 30
DISTANCE_DRIFT = 0.02
TURN_DRIFT = 0.02
YAW_DRIFT_RADPM = math.radians(1.0)
DELAY_S, DELAY_JITTER_S = (0.005, 0.08), 0.01
FAULT_LASTS_S = (1.0, 2.0)
SLIP = (1.3, 1.8)  # what the wheels turn for each metre and degree that the robot moves
JUMP_M, JUMP_RAD = (0.3, 1.0), (math.radians(15), math.radians(60))
CLOCK_S = (0.3, 3.0)


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """Where the wheels say that the robot is: from its start, in its own frame; `at_s` by its clock."""

    at_s: float
    arrives_s: float
    x_m: float
    z_m: float
    yaw: float  # radians to the right, not wrapped


def fault_window(seed: int, fault: Fault, duration_s: float) -> tuple[float, float]:
    """Return from when to when a fault lasts; a jump is at its beginning, another clock is there all the time."""
    rng = np.random.default_rng([seed, 6, FAULTS.index(fault)])
    begin = float(rng.uniform(0.3, 0.6)) * duration_s
    return begin, begin + float(rng.uniform(*FAULT_LASTS_S))


def measure_odometry(track: Track, seed: int, faults: Collection[Fault] = ()) -> tuple[OdometrySample, ...]:
    """Return samples in the order in which they arrive. One seed has one drift, whatever the faults."""
    rng = np.random.default_rng([seed, 5])
    distance, turn, by_metre = rng.uniform(-1, 1, 3) * (DISTANCE_DRIFT, TURN_DRIFT, YAW_DRIFT_RADPM)
    table = np.array(track)
    duration_s = float(table[-1, 0])
    times = np.arange(0.0, duration_s, 1 / RATE_HZ)
    windows = {fault: fault_window(seed, fault, duration_s) for fault in FAULTS if fault in faults}
    x, z, yaw = (np.interp(times, table[:, 0], table[:, column]) for column in (1, 2, 3))
    middle, turned = (yaw[1:] + yaw[:-1]) / 2, np.diff(yaw)
    ahead = np.diff(x) * np.sin(middle) + np.diff(z) * np.cos(middle)
    for fault, share in (("stop", 0.0), ("slip", float(np.random.default_rng([seed, 7]).uniform(*SLIP)))):
        if fault in windows:
            begin, end = windows[fault]
            during = (times[1:] > begin) & (times[1:] <= end)
            ahead, turned = (np.where(during, share * steps, steps) for steps in (ahead, turned))
    turned = turned * (1 + turn) + np.abs(ahead) * by_metre
    yaw = np.concatenate([[0.0], np.cumsum(turned)])
    middle, ahead = (yaw[1:] + yaw[:-1]) / 2, ahead * (1 + distance)
    x, z = (np.concatenate([[0.0], np.cumsum(ahead * part(middle))]) for part in (np.sin, np.cos))
    late = np.random.default_rng([seed, 8])
    delay_s = late.uniform(*DELAY_S) + late.uniform(0, DELAY_JITTER_S, len(times))
    rows = zip(times, times + delay_s, x, z, yaw, strict=True)
    samples = [OdometrySample(*(float(value) for value in row)) for row in rows]
    for fault, window in windows.items():
        samples = _with_fault(samples, fault, window, seed)
    return tuple(samples)


def _with_fault(
    samples: list[OdometrySample], fault: Fault, window: tuple[float, float], seed: int
) -> list[OdometrySample]:
    begin, end = window
    rng = np.random.default_rng([seed, 9, FAULTS.index(fault)])
    sign = float(rng.choice([-1.0, 1.0]))
    if fault == "gap":
        return [sample for sample in samples if not begin <= sample.at_s < end]
    if fault == "clock":
        offset_s = sign * float(rng.uniform(*CLOCK_S))
        return [replace(sample, at_s=sample.at_s + offset_s) for sample in samples]
    if fault == "jump":
        far, towards = float(rng.uniform(*JUMP_M)), float(rng.uniform(-math.pi, math.pi))
        dx, dz, turned = far * math.sin(towards), far * math.cos(towards), sign * float(rng.uniform(*JUMP_RAD))
        return [
            replace(sample, x_m=sample.x_m + dx, z_m=sample.z_m + dz, yaw=sample.yaw + turned)
            if sample.at_s >= begin
            else sample
            for sample in samples
        ]
    return samples

"""What the wheels say: within the drift that is allowed, and off in the way that each fault says."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from clients.robot.synthetic.driving.odometry import (
    DELAY_JITTER_S,
    DELAY_S,
    DISTANCE_DRIFT,
    FAULTS,
    JUMP_M,
    JUMP_RAD,
    RATE_HZ,
    SLIP,
    TURN_DRIFT,
    YAW_DRIFT_RADPM,
    Fault,
    OdometrySample,
    fault_window,
    measure_odometry,
)
from clients.robot.synthetic.driving.robot_motion import Track, drive_along, move_track

DURATION_S = 9.0
WAY = drive_along(
    ((0.0, 0.0, 0.0), (1.2, 0.6, 0.0), (3.0, 0.6, 0.3), (6.0, 0.5, -0.3), (DURATION_S, 0.4, 0.2)), DURATION_S
)
SEEDS = range(12)
Floats = npt.NDArray[np.float64]


def table(samples: tuple[OdometrySample, ...]) -> Floats:
    return np.array([(s.at_s, s.x_m, s.z_m, s.yaw) for s in samples])


def truth(track: Track, times: Floats) -> Floats:
    """Return the true (x, z, yaw) seen from the start."""
    known = np.array(track)
    x, z, yaw = (np.interp(times, known[:, 0], known[:, column]) for column in (1, 2, 3))
    dx, dz, start = x - x[0], z - z[0], yaw[0]
    right, ahead = dx * math.cos(start) - dz * math.sin(start), dx * math.sin(start) + dz * math.cos(start)
    return np.stack([right, ahead, yaw - start], axis=1)


def steps(points: Floats) -> Floats:
    return np.asarray(np.hypot(*np.diff(points[:, :2], axis=0).T))


@pytest.mark.parametrize("seed", SEEDS)
def test_drift_stays_within_its_bounds_wherever_the_robot_starts(seed: int) -> None:
    samples = measure_odometry(move_track(WAY, 2.0, -3.0, 2.1), seed)
    measured = table(samples)
    true = truth(WAY, measured[:, 0])
    assert np.allclose(np.diff(measured[:, 0]), 1 / RATE_HZ)
    assert np.allclose(measured[0, 1:], 0)
    way, turned = np.cumsum(steps(true)), np.cumsum(np.abs(np.diff(true[:, 2])))
    assert np.allclose(np.cumsum(steps(measured[:, 1:])) / way, 1, atol=DISTANCE_DRIFT + 1e-3)
    yaw_bound = TURN_DRIFT * turned + YAW_DRIFT_RADPM * way
    assert (np.abs(measured[1:, 3] - true[1:, 2]) <= yaw_bound + 1e-3).all()
    off = np.hypot(*(measured[1:, 1:3] - true[1:, :2]).T)
    assert (off <= (DISTANCE_DRIFT + yaw_bound) * way + 1e-3).all()
    assert off[-1] > 1e-3


def test_samples_arrive_late_and_in_order_and_a_seed_has_one_drift() -> None:
    drifts = set()
    for seed in SEEDS:
        samples = measure_odometry(WAY, seed)
        assert samples == measure_odometry(WAY, seed)
        late = [sample.arrives_s - sample.at_s for sample in samples]
        assert DELAY_S[0] <= min(late) <= max(late) <= DELAY_S[1] + DELAY_JITTER_S
        assert [sample.arrives_s for sample in samples] == sorted(sample.arrives_s for sample in samples)
        drifts.add(samples[-1].yaw)
    assert len(drifts) == len(SEEDS)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", ["jump", "stop", "slip"])
def test_a_fault_changes_nothing_before_it_begins(fault: Fault, seed: int) -> None:
    begin, _ = fault_window(seed, fault, WAY[-1][0])
    good, bad = measure_odometry(WAY, seed), measure_odometry(WAY, seed, (fault,))
    assert [sample for sample in good if sample.at_s < begin] == [sample for sample in bad if sample.at_s < begin]
    assert good != bad
    assert 0.3 * DURATION_S <= begin <= 0.6 * DURATION_S + 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_each_fault_is_what_it_says(seed: int) -> None:
    good = table(measure_odometry(WAY, seed))
    bad = {fault: table(measure_odometry(WAY, seed, (fault,))) for fault in FAULTS}
    within = {}
    for fault in FAULTS[:4]:
        begin, end = fault_window(seed, fault, WAY[-1][0])
        within[fault] = (good[1:, 0] > begin) & (good[1:, 0] <= end)
        assert 1.0 <= end - begin <= 2.0
    jumped = bad["jump"] - good
    assert JUMP_M[0] - 1e-9 <= math.hypot(*jumped[-1, 1:3]) <= JUMP_M[1] + 1e-9
    assert JUMP_RAD[0] <= abs(jumped[-1, 3]) <= JUMP_RAD[1]
    assert np.count_nonzero(np.abs(np.diff(jumped[:, 3])) > 1e-6) == 1
    assert np.allclose(steps(bad["stop"][:, 1:])[within["stop"]], 0)
    assert np.allclose(steps(bad["stop"][:, 1:])[~within["stop"]], steps(good[:, 1:])[~within["stop"]])
    slipped = steps(bad["slip"][:, 1:])[within["slip"]] / steps(good[:, 1:])[within["slip"]]
    assert SLIP[0] - 0.01 <= slipped.min() <= slipped.max() <= SLIP[1] + 0.01
    assert 1.0 <= np.diff(bad["gap"][:, 0]).max() <= 2.1
    assert len(bad["gap"]) < len(good) - RATE_HZ + 2
    assert np.array_equal(bad["clock"][:, 1:], good[:, 1:])
    offset = bad["clock"][:, 0] - good[:, 0]
    assert 0.3 <= abs(offset[0]) <= 3.0
    assert np.allclose(offset, offset[0])


def test_faults_come_together() -> None:
    both = measure_odometry(WAY, 3, ("gap", "stop", "clock"))
    alone: dict[Fault, tuple[OdometrySample, ...]] = {fault: measure_odometry(WAY, 3, (fault,)) for fault in FAULTS}
    assert len(both) == len(alone["gap"])
    assert both[0].at_s == alone["clock"][0].at_s
    assert both[-1].x_m == alone["stop"][-1].x_m

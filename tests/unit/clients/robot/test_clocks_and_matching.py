"""A reader's wrong stamp must not give a tag to whoever walks where its bearer walked a moment ago."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Track
from clients.robot.sensing.sensor_clocks import RunClocks
from clients.robot.sensing.sensor_events import Facing, Frame, Sighting

FRAME_MS = 100
BEHIND_MS = 1_500
WRONG_AT_MS = 60_000
IN_VIEW_MS = 61_000
UNTIL_MS = 100_000
SIGMA_M = 0.2
START_MS = 1_700_000_000_000
DEPTH = np.zeros((1, 1), dtype=np.uint16)


def range_m(at_ms: int) -> float:
    """Where one who walks to and fro before the robot is."""
    return 3.5 + 1.5 * math.sin(at_ms / 1_700)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rate", [1, 2])
def test_one_stamp_ahead_gives_the_followers_tag_to_nobody_else(rate: int, seed: int) -> None:
    chance = random.Random(seed)
    clocks, matcher = RunClocks(), Matcher()
    ahead, follower = (Track(number, START_MS + IN_VIEW_MS, 0, 0.0, 3.5) for number in (1, 2))
    bound = set()
    for at_ms in range(0, UNTIL_MS, FRAME_MS):
        now_ms = START_MS + at_ms
        clocks.admit(Frame(now_ms, at_ms // FRAME_MS, DEPTH, now_ms))
        for track, distance_m in ((ahead, range_m(at_ms)), (follower, range_m(at_ms - BEHIND_MS))):
            if at_ms < IN_VIEW_MS:
                continue
            track.seen_ms = now_ms
            track.times.append(now_ms)
            track.ranges.append(distance_m)
            track.bearings.append(0.0)
            matcher.add_track(track)
        if at_ms % (1000 // rate) == 0:
            distance_m = range_m(at_ms - BEHIND_MS) + chance.gauss(0, SIGMA_M)
            stamp_ms = now_ms + (BEHIND_MS if at_ms == WRONG_AT_MS else 0)
            received_ms = now_ms + round(min(chance.expovariate(1 / 30), 300))
            reading = Sighting(stamp_ms, stamp_ms, "E1", 1, Facing.FRONT, -50.0, distance_m, SIGMA_M)
            for event in clocks.admit(replace(reading, received_at_ms=received_ms)):
                assert isinstance(event, Sighting)
                matcher.add_sighting("tag", event)
        matcher.advance(now_ms)
        bound.add(matcher.bound_track("tag", (1, 2)))
    assert bound == {None, 2}

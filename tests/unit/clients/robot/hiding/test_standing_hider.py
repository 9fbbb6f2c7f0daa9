"""Who is shown before the empty scene."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.standing_hider import StandingHider

FOCAL_PX, ROOM_MM = 525.0, 8_000


@pytest.mark.parametrize(("range_max_m", "reason"), [(math.inf, ""), (5.0, "out-of-range")])
def test_beyond_a_limit_nobody_is_shown(range_max_m: float, reason: str) -> None:
    empty = np.full((480, 640), ROOM_MM, np.uint16)
    depth = empty.copy()
    depth[160:320, 290:345] = 5_500  # 1.7 m tall, half a metre broad
    depth[150:170, 306:328] = 5_500
    hider = StandingHider(learn_background([empty] * 3), FOCAL_PX, range_max_m)
    found = hider.find_people(depth, None, 0)
    assert found is not None
    (person,) = found.silhouettes
    assert person.range_m > 5
    assert person.withhold_reason == reason

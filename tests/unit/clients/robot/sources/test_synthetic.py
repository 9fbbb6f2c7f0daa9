"""The corridor as a source gives what its recording gives."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from clients.robot.events import Frame, Sighting
from clients.robot.scenario import Scenario
from clients.robot.sources.rosbag import BagSource
from clients.robot.sources.source import Source
from clients.robot.sources.synthetic import SyntheticSource
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.test_bag import FakeClock

UIDS = {"ann": "E200000000000001"}


def test_the_source_gives_what_a_recording_of_the_same_scene_gives(small_scenario: Scenario, small_bag: Path) -> None:
    direct: Source = SyntheticSource(small_scenario, UIDS)
    recorded: Source = BagSource(small_bag)
    assert direct.start_ms == recorded.start_ms
    for one, two in zip(direct.events(), recorded.events(), strict=True):
        assert type(one) is type(two)
        if isinstance(one, Frame) and isinstance(two, Frame):
            assert np.array_equal(one.depth, two.depth)
            assert (one.captured_at_ms, one.sequence, one.received_at_ms) == (
                two.captured_at_ms,
                two.sequence,
                two.received_at_ms,
            )
        if isinstance(one, Sighting) and isinstance(two, Sighting):
            assert (one.uid, one.received_at_ms) == (two.uid, two.received_at_ms)
            for value, told in zip(astuple(one), astuple(two), strict=True):
                assert told == (pytest.approx(value, rel=1e-6) if isinstance(value, float) else value)
    for empty, told_empty in zip(direct.empty_frames(), recorded.empty_frames(), strict=True):
        assert empty.shape == told_empty.shape


async def test_it_plays_on_a_shifted_timeline(small_scenario: Scenario) -> None:
    source = SyntheticSource(small_scenario, UIDS)
    source.shift_to(1_000_000)
    clock = FakeClock(1_000_000)
    times = [event.captured_at_ms async for event in source.play(clock) if isinstance(event, Frame)]
    assert times == [1_000_000 + 100 * index for index in range(6)]
    assert clock.now == 1_000_500


def test_a_tag_without_uid_is_refused(small_scenario: Scenario) -> None:
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID"):
        SyntheticSource(small_scenario, {})

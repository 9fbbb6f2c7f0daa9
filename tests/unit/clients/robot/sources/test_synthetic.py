"""The corridor as a source gives what its recording gives."""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from clients.robot.sensing.sensor_events import Frame, Sighting, SourceEvent
from clients.robot.sources.live.synthetic_source import SyntheticSource
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.source import Source
from clients.robot.synthetic.scenario import Scenario
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
            for value, told in zip(astuple(one), astuple(replace(two, origin="")), strict=True):
                assert told == (pytest.approx(value, rel=1e-6) if isinstance(value, float) else value)
    for empty, told_empty in zip(direct.empty_frames(), recorded.empty_frames(), strict=True):
        assert empty.shape == told_empty.shape


async def test_the_scene_plays_on_a_shifted_timeline_and_thinned_to_fewer_frames(small_scenario: Scenario) -> None:
    source = SyntheticSource(small_scenario, UIDS)
    source.shift_to(1_000_000)
    clock = FakeClock(1_000_000)
    times = [event.captured_at_ms async for event in source.play(clock) if isinstance(event, Frame)]
    assert times == [1_000_000 + 100 * index for index in range(6)]
    assert clock.now == 1_000_500
    every, some = (SyntheticSource(small_scenario, UIDS, frames_per_s=rate) for rate in (None, 5))
    whole = [event for event in every.events() if isinstance(event, Frame)]
    thinned = [event for event in some.events() if isinstance(event, Frame)]
    assert [frame.captured_at_ms for frame in thinned] == [frame.captured_at_ms for frame in whole[::2]]
    assert [frame.sequence for frame in thinned] == [0, 1, 2]
    assert all(np.array_equal(one.depth, two.depth) for one, two in zip(thinned, whole[::2], strict=True))


async def played(source: SyntheticSource, clock: FakeClock, count: int) -> list[SourceEvent]:
    """Return the first events of a source that need not end."""
    found: list[SourceEvent] = []
    async for event in source.play(clock):
        found.append(event)
        if len(found) == count:
            break
    return found


async def test_an_endless_corridor_begins_again_with_time_and_frame_numbers_going_on(small_scenario: Scenario) -> None:
    source = SyntheticSource(small_scenario, UIDS, endless=True)
    source.shift_to(1_000_000)
    events = await played(source, FakeClock(1_000_000), 27)
    frames = [event for event in events if isinstance(event, Frame)]
    assert [(frame.sequence, frame.captured_at_ms) for frame in frames] == [
        (index, 1_000_000 + 100 * index) for index in range(18)
    ]
    assert np.array_equal(frames[0].depth, frames[6].depth)
    seen = [event.first_seen_ms for event in events if isinstance(event, Sighting)]
    assert seen == [1_000_000 + at for lap in (0, 600, 1_200) for at in (lap + 100, lap + 300, lap + 500)]


async def test_what_the_machine_is_too_slow_for_is_never_seen_and_no_reading_is_lost(small_scenario: Scenario) -> None:
    """As with a camera: the newest frame comes, on time, and the ones in between do not."""
    clock = FakeClock(1_000_000)
    source = SyntheticSource(small_scenario, UIDS)
    source.shift_to(1_000_000)
    frames, readings = [], 0
    async for event in source.play(clock):
        if isinstance(event, Frame):
            frames.append((event.sequence, event.captured_at_ms - 1_000_000, event.received_at_ms))
            clock.now += 250
        else:
            readings += 1
    assert frames == [(0, 0, 1_000_000), (1, 200, 1_000_250), (2, 500, 1_000_500)]
    assert readings == 3


def test_a_tag_without_uid_is_refused(small_scenario: Scenario) -> None:
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID"):
        SyntheticSource(small_scenario, {})

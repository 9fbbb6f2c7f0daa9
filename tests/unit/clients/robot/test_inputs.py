"""The gate before the pipeline: bad messages are counted by reason, a stream that breaks off or is useless ends well."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from typing import get_args

import numpy as np
import pytest

from clients.robot.sensing.input_checks import (
    KIND_WORDS,
    NOTED_EACH_COUNT,
    NOTED_TOGETHER_COUNT,
    REFUSED_IN_A_ROW_MAX_COUNT,
    RUN_ENDS,
    Inputs,
    RunFault,
)
from clients.robot.sensing.sensor_events import (
    AudioClip,
    ColourFrame,
    Event,
    Frame,
    Label,
    Odometry,
    RefusedMessage,
    SensorSample,
    Sighting,
    SourceEvent,
)
from clients.robot.sources.live.llrp_readings import LlrpReadings
from clients.robot.sources.messages.decoding import KINDS
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.test_llrp_readings import NOW_MS, READER, report

SHAPE = (4, 6)
SIGHTING = Sighting(1, 2, "E1")


def frame(sequence: int, shape: tuple[int, int] = SHAPE) -> Frame:
    return Frame(sequence, sequence, np.ones(shape, np.uint16))


async def stream(events: Sequence[SourceEvent], end: BlockRobotError | None = None) -> AsyncIterator[SourceEvent]:
    for event in events:
        yield event
    if end is not None:
        raise end


async def drain(inputs: Inputs, events: Sequence[SourceEvent], end: BlockRobotError | None = None) -> list[SourceEvent]:
    return [event async for event in inputs.usable(stream(events, end))]


async def test_what_can_be_used_comes_through_and_the_rest_is_counted_and_noted() -> None:
    noted: list[RefusedMessage] = []
    inputs = Inputs(SHAPE, lambda refused, _: noted.append(refused))
    wrong = frame(1, (4, 5))
    events = [
        frame(0),
        wrong,
        RefusedMessage(3, "frame", "step"),
        SIGHTING,
        RefusedMessage(4, "sighting", "tag"),
        frame(2),
    ]
    assert await drain(inputs, events) == [events[0], SIGHTING, events[5]]
    assert inputs.summarise_refused() == {"frame": {"size": 1, "step": 1}, "sighting": {"tag": 1}}
    assert (inputs.first_detail, inputs.summarise_fault()) == ({}, None)
    assert [(refused.kind, refused.reason) for refused in noted] == [
        ("frame", "size"),
        ("frame", "step"),
        ("sighting", "tag"),
    ]


async def test_every_kind_of_event_comes_through_and_has_a_word() -> None:
    events: list[SourceEvent] = [
        frame(0),
        SIGHTING,
        Odometry(1, 0.0, 0.0, 0.0),
        ColourFrame(1, 0, np.zeros((1, 1, 3), np.uint8)),
        Label(1, 0, "calm"),
        AudioClip(1, 0, b""),
    ]
    assert {type(event) for event in events} == {*get_args(Event), *get_args(SensorSample)}
    assert await drain(Inputs(SHAPE), events) == events
    assert set(KINDS.values()) == set(KIND_WORDS)


async def test_odometry_of_no_use_is_counted_and_ends_no_run() -> None:
    inputs = Inputs(SHAPE)
    refused = [RefusedMessage(1, "odometry", "frame")] * (2 * REFUSED_IN_A_ROW_MAX_COUNT)
    assert await drain(inputs, [*refused, frame(1)])
    assert (inputs.summarise_refused(), inputs.fault) == ({"odometry": {"frame": len(refused)}}, None)


async def test_registered_colour_has_the_size_of_depth_and_other_colour_any() -> None:
    fits, free, odd = (
        ColourFrame(1, 0, np.zeros((*SHAPE, 3), np.uint8), registered=True),
        ColourFrame(2, 1, np.zeros((9, 9, 3), np.uint8)),
        ColourFrame(3, 2, np.zeros((9, 9, 3), np.uint8), registered=True),
    )
    inputs = Inputs(SHAPE)
    assert await drain(inputs, [fits, free, odd]) == [fits, free]
    assert inputs.refused == {"rgb": {"size": 1}}


async def test_too_many_bad_frames_in_a_row_end_the_stream_and_a_good_one_begins_the_count_anew() -> None:
    inputs = Inputs(SHAPE)
    events = [frame(0), *[RefusedMessage(1, "frame", "encoding")] * REFUSED_IN_A_ROW_MAX_COUNT, frame(1)]
    assert await drain(inputs, events) == events[:1]
    assert inputs.fault is not None
    assert inputs.fault.code == "FRAMES_UNUSABLE"
    assert "encoding" in inputs.fault.detail
    inputs = Inputs(SHAPE)
    bad: list[SourceEvent] = [RefusedMessage(1, "frame", "size")] * (REFUSED_IN_A_ROW_MAX_COUNT - 1)
    assert len(await drain(inputs, [*bad, frame(0), *bad])) == 1
    assert inputs.fault is None
    assert len(await drain(Inputs(SHAPE), [*bad, SIGHTING, *bad])) == 1


@pytest.mark.parametrize("kind", ["sighting", "rgb", "label", "audio"])
async def test_what_strangers_send_never_ends_a_live_run_and_is_counted(kind: str) -> None:
    inputs = Inputs(SHAPE, live=True)
    events = [*[RefusedMessage(1, kind, "tag")] * (5 * REFUSED_IN_A_ROW_MAX_COUNT), frame(1)]
    assert await drain(inputs, events) == events[-1:]
    assert inputs.summarise_refused() == {kind: {"tag": 5 * REFUSED_IN_A_ROW_MAX_COUNT}}
    assert (inputs.first_detail, inputs.fault) == ({}, None)
    recorded = Inputs(SHAPE)
    assert await drain(recorded, events) == []
    assert recorded.fault is not None
    assert recorded.fault.code == "FRAMES_UNUSABLE"


async def test_an_odd_tag_before_a_reader_does_not_end_a_live_run() -> None:
    readings, inputs = LlrpReadings(READER), Inputs(SHAPE, live=True)
    events: list[SourceEvent] = []
    for number in range(1_000):
        events += readings.convert_report(report(epc=bytes(62)), NOW_MS + number * 10)
        events += [frame(number)] if number % 100 == 99 else []
    assert [event for event in await drain(inputs, events) if isinstance(event, Frame)] == events[100::101]
    assert inputs.summarise_refused() == {"sighting": {"tag": 1_000}}
    assert (inputs.first_detail, inputs.fault) == ({}, None)


async def test_a_live_camera_of_which_nothing_can_be_used_ends_the_run_whatever_else_comes() -> None:
    inputs = Inputs(SHAPE, live=True)
    events = [RefusedMessage(1, "frame", "encoding"), SIGHTING] * REFUSED_IN_A_ROW_MAX_COUNT
    assert len(await drain(inputs, [*events, SIGHTING])) == REFUSED_IN_A_ROW_MAX_COUNT - 1
    assert inputs.fault is not None
    assert inputs.fault.code == "FRAMES_UNUSABLE"


async def test_a_storm_of_bad_messages_does_not_fill_the_log_and_none_is_lost_from_it() -> None:
    noted: list[int] = []
    inputs = Inputs(SHAPE, lambda _, count: noted.append(count), live=True)
    await drain(inputs, [RefusedMessage(1, "sighting", "tag")] * (NOTED_EACH_COUNT + 2 * NOTED_TOGETHER_COUNT + 5))
    assert noted == [1] * NOTED_EACH_COUNT + [NOTED_TOGETHER_COUNT] * 2
    inputs.close()
    assert sum(noted) == NOTED_EACH_COUNT + 2 * NOTED_TOGETHER_COUNT + 5


async def test_a_stream_that_breaks_off_gives_all_before_and_any_other_failure_is_no_end() -> None:
    inputs = Inputs(SHAPE)
    events = [frame(0), SIGHTING]
    assert await drain(inputs, events, BlockRobotError("BAG_DAMAGED", "It breaks off.")) == events
    assert inputs.summarise_fault() == RunFault(code="BAG_DAMAGED", detail="It breaks off.")
    with pytest.raises(BlockRobotError, match="BAG_TOPIC_MISSING"):
        await drain(Inputs(SHAPE), [frame(0)], BlockRobotError("BAG_TOPIC_MISSING"))


@pytest.mark.parametrize("code", sorted(RUN_ENDS))
async def test_what_ends_a_run_before_its_stream_is_its_fault(code: str) -> None:
    inputs = Inputs(SHAPE)
    assert await drain(inputs, [SIGHTING], BlockRobotError(code, "It is over.")) == [SIGHTING]
    assert inputs.summarise_fault() == RunFault(code=code, detail="It is over.")

"""The whole robot when time is wrong or too much arrives: every frame accounted for, and the log says what happened."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clients.robot.hiding.frame_redactor import FrameRedactor, Output
from clients.robot.recording.event_log import Event as LoggedEvent
from clients.robot.recording.event_log import read_events
from clients.robot.sensing.sensor_events import Event, Frame, Sighting
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.test_pipeline import UID, Robot, roster
from tests.virtual_time import run_virtual, virtual_now_ms

DAY_MS = 86_400_000
STORM_PER_FRAME = 1_000  # at ten frames a second: 10,000 readings a second

Change = Callable[[list[Event]], Iterable[Event]]


class ChangedRobot(Robot):
    """A run over the small recording with its events changed on the way."""

    change: Change

    async def events(self) -> AsyncIterator[Event]:
        recorded = [event for event in self.source.events() if isinstance(event, Frame | Sighting)]
        for event in self.change(recorded):
            await asyncio.sleep(0)
            yield event


class LiveRobot(ChangedRobot):
    """A run whose events come when they are received, and whose sensors then fall silent for a minute."""

    live = True

    async def events(self) -> AsyncIterator[Event]:
        async for event in super().events():
            await asyncio.sleep(max(0, (event.received_at_ms or 0) - virtual_now_ms()) / 1000)
            yield event
        await asyncio.sleep(60)


@pytest.fixture
def run(tmp_path: Path, small_bag: Path) -> Callable[[Change], ChangedRobot]:
    def play(change: Change) -> ChangedRobot:
        robot = ChangedRobot(tmp_path, small_bag, roster())
        robot.change = change
        run_virtual(robot.run())
        counts = robot.statistics.count_frames()
        assert counts.lost == 0
        assert counts.kept + counts.withheld == counts.covered
        return robot

    return play


def logged(robot: Robot, activity: str) -> list[LoggedEvent]:
    return [event for event in read_events(robot.log_path) if event.activity == activity]


def shifted(event: Event, by_ms: int, *, received_too: bool = False) -> Event:
    received = event.received_at_ms
    if received is not None and received_too:
        received += by_ms
    if isinstance(event, Frame):
        return replace(event, captured_at_ms=event.captured_at_ms + by_ms, received_at_ms=received)
    first, last = event.first_seen_ms + by_ms, event.last_seen_ms + by_ms
    return replace(event, first_seen_ms=first, last_seen_ms=last, received_at_ms=received)


def test_the_log_tells_what_is_known_of_both_clocks(run: Callable[[Change], ChangedRobot]) -> None:
    robot = run(lambda events: events)
    assert {event.case for event in logged(robot, "CLOCK_ESTIMATED")} == {
        "clock-reader /rfid/sightings",
        "clock-camera",
    }
    for event in logged(robot, "CLOCK_ESTIMATED"):
        assert event.detail["offset_ms"] == 0
        assert event.detail["uncertainty_ms"] > 0
    assert robot.statistics.covered == 6


@pytest.mark.parametrize("off_ms", [DAY_MS, -DAY_MS, 777])
def test_a_readers_wrong_clock_changes_nothing_but_the_estimate(
    run: Callable[[Change], ChangedRobot], off_ms: int
) -> None:
    robot = run(lambda events: [shifted(one, off_ms) if isinstance(one, Sighting) else one for one in events])
    assert robot.statistics.covered == 6
    found = [event for event in logged(robot, "CLOCK_ESTIMATED") if event.case == "clock-reader /rfid/sightings"]
    assert {event.detail["offset_ms"] for event in found} == {-off_ms}
    assert logged(robot, "MESSAGE_REFUSED") == []


@pytest.mark.parametrize("off_ms", [DAY_MS, -DAY_MS])
def test_one_frame_stamped_a_day_off_is_refused_and_logged_and_the_others_are_paired(
    run: Callable[[Change], ChangedRobot], off_ms: int
) -> None:
    robot = run(lambda events: [shifted(one, off_ms) if is_frame(one, 2) else one for one in events])
    assert robot.statistics.covered == 5
    assert {event.case for event in logged(robot, "IMAGE_PAIRED")} == {f"frame-{n}" for n in (0, 1, 3, 4, 5)}
    assert [event.detail for event in logged(robot, "MESSAGE_REFUSED")] == [{"reason": "frame-time", "count": 1}]


def is_frame(event: Event, sequence: int) -> bool:
    return isinstance(event, Frame) and event.sequence == sequence


@pytest.mark.parametrize("off_ms", [-3_600_000, 3_600_000])
def test_when_the_hosts_clock_is_set_during_a_run_every_frame_before_and_after_is_decided(
    run: Callable[[Change], ChangedRobot], off_ms: int
) -> None:
    """The camera and the reader are stamped by the host here: all jump together, nothing is in doubt."""

    def change(events: list[Event]) -> Iterable[Event]:
        half = next(i for i, event in enumerate(events) if is_frame(event, 3))
        return [*events[:half], *(shifted(one, off_ms, received_too=True) for one in events[half:])]

    robot = run(change)
    decided = {event.case for event in read_events(robot.log_path) if event.activity.startswith("IMAGE_")}
    assert decided == {f"frame-{number}" for number in range(6)}
    assert robot.statistics.covered == 6
    assert logged(robot, "MESSAGE_REFUSED") == []


def test_frames_of_equal_stamps_are_each_accounted_for(run: Callable[[Change], ChangedRobot]) -> None:
    def change(events: list[Event]) -> Iterable[Event]:
        at = next(event.captured_at_ms for event in events if isinstance(event, Frame))
        return [replace(one, captured_at_ms=at) if isinstance(one, Frame) else one for one in events]

    robot = run(change)
    assert robot.statistics.covered == 6
    assert robot.statistics.withheld["disordered"] == 5


@pytest.mark.parametrize("distinct", [1, 100, 10**9])
def test_a_storm_of_strangers_tags_changes_no_owner_and_hardly_the_log(
    run: Callable[[Change], ChangedRobot], distinct: int
) -> None:
    def change(events: list[Event]) -> Iterable[Event]:
        number = 0
        for event in events:
            yield event
            if isinstance(event, Frame):
                for step in range(STORM_PER_FRAME):
                    number += 1
                    at = event.captured_at_ms + step // 10
                    yield Sighting(at, at, f"STRANGER{number % distinct}", received_at_ms=at)

    robot = run(change)
    assert robot.statistics.covered == 6
    assert len({event.alias for event in logged(robot, "IMAGE_PAIRED")}) == 1
    assert len(logged(robot, "RFID_RETRIEVE")) <= 2 * 50 + 4


def test_a_storm_of_the_bearers_own_tag_changes_no_owner(run: Callable[[Change], ChangedRobot]) -> None:
    def change(events: list[Event]) -> Iterable[Event]:
        for event in events:
            yield event
            if isinstance(event, Sighting):
                yield from [event] * STORM_PER_FRAME

    robot = run(change)
    assert robot.statistics.covered == 6
    readings = len(logged(robot, "RFID_RETRIEVE"))
    assert readings == sum(isinstance(event, Sighting) and event.uid == UID for event in robot.source.events())


async def at_once(work: Callable[..., Any], *arguments: Any) -> Any:
    """Stand in for a thread, during which virtual time would run away."""
    return work(*arguments)


def test_in_a_live_stream_that_falls_silent_frames_are_decided_when_due_and_not_before(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(asyncio, "to_thread", at_once)
    robot = LiveRobot(tmp_path, small_bag, roster())
    robot.change = lambda events: events
    run_virtual(robot.run())
    decided = {event.case: event.time_ms for event in logged(robot, "IMAGE_PAIRED")}
    assert sorted(decided) == [f"frame-{number}" for number in range(6)]
    taken = {event.case: event.time_ms for event in logged(robot, "IMAGE_RETRIEVE")}
    for case, decided_ms in decided.items():
        assert 6_000 < decided_ms - taken[case] < 9_000
    assert robot.statistics.count_frames().lost == 0


def test_what_fails_while_a_live_stream_is_silent_ends_the_run(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_arguments: object) -> list[Output]:
        raise BlockRobotError("SPOOL_FULL")

    monkeypatch.setattr(FrameRedactor, "advance", full)
    robot = LiveRobot(tmp_path, small_bag, roster())
    robot.change = lambda events: events
    with pytest.raises(BlockRobotError, match="SPOOL_FULL"):
        run_virtual(robot.run())

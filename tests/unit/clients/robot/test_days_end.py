"""A run whose roster's day ends, or whose empty frames are no longer approved, in virtual time: it ends in good order."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clients.robot.backgrounds.background_banks import DAY_MS, FOLDER, approve_scene, record_scene
from clients.robot.pairing.rosters import RosterBook
from clients.robot.run.run_summary import RunSummary
from clients.robot.run.run_validity import LOOK_EVERY_S
from clients.robot.sensing.sensor_events import Depth, Frame, SourceEvent
from clients.robot.sources.source import Clock, StoppableClock
from tests.unit.clients.robot.registry_stand_in import SIGNER
from tests.unit.clients.robot.test_pipeline import UID, roster
from tests.unit.clients.robot.test_replay_start import Start, begin
from tests.virtual_time import VirtualLoop, virtual_now_ms

pytestmark = pytest.mark.usefixtures("inline_threads")

SPENT_FRAMES = 4
VIEWPOINT = "ward-3"


def pass_time(milliseconds: int) -> None:
    """Let the wall clock go on, as while a robot is busy."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop._jumping.now_s += milliseconds / 1000


class Day:
    """A run during which something ends: after some frames, or while nothing comes any more."""

    def __init__(self, start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
        self.start = start
        self.folder = start.run._folder
        self.monkeypatch = monkeypatch
        self.after_frames: Callable[[], None] = lambda: None
        start.registry.block()
        start.registry.idle = False
        recorded = start.source.events
        monkeypatch.setattr(start.source, "events", lambda: self._spoilt(recorded()))

    def _spoilt(self, events: Iterator[SourceEvent]) -> Iterator[SourceEvent]:
        count = 0
        for event in events:
            yield event
            count += isinstance(event, Frame)
            if isinstance(event, Frame) and count == SPENT_FRAMES:
                self.after_frames()

    def roster_until(self, at_ms: int) -> None:
        self.start.run._roster = RosterBook(msgspec.structs.replace(roster(), not_after_ms=at_ms), SIGNER)

    def approve(self, *, for_s: float = DAY_MS / 1000) -> list[Depth]:
        empty = self.start.source.empty_frames()
        frames = (empty * 8)[:8]
        record_scene(self.folder, VIEWPOINT, frames, virtual_now_ms())
        approved_ms = virtual_now_ms() - DAY_MS + round(for_s * 1000)
        approve_scene(self.folder, VIEWPOINT, by="A. Nurse", days=1, now_ms=approved_ms)
        self.start.run._options = replace(self.start.run._options, viewpoint=VIEWPOINT)
        return frames

    def live(self) -> None:
        """Let what was recorded come at once, and then nothing more, as from a camera that has stopped."""

        async def play(clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
            assert isinstance(clock, StoppableClock)
            for event in self.start.source.events():
                yield event
            await clock.sleep_until(1 << 53)

        self.monkeypatch.setattr(self.start.source, "play", play)
        self.start.run._options = replace(self.start.run._options, real_time=True)

    async def ends_with(self, code: str, *, frames: int) -> RunSummary:
        summary = await asyncio.wait_for(self.start.run.work(self.start.source), 3_600)
        counts, fault = summary.frames, summary.intake.fault
        assert (fault and fault.code) == (code or None)
        assert counts.published == counts.covered == frames
        assert (counts.lost, counts.kept + counts.withheld) == (0, frames)
        assert summary.records > 0, "what was seen until then is recorded"
        assert self.start.run._spool.names() == []
        network = self.start.network
        assert set(network.closed) == set(network.visits), "every visit is closed"
        return summary


def a_day(folder: Path, bag: Path, monkeypatch: pytest.MonkeyPatch, story: Callable[[Day], Any]) -> None:
    async def told(start: Start) -> None:
        await story(Day(start, monkeypatch))

    begin(folder, bag, monkeypatch, told)


def test_a_rosters_tags_lead_to_nobody_once_its_day_is_over() -> None:
    book = RosterBook(msgspec.structs.replace(roster(), not_after_ms=1_000), SIGNER)
    assert book.find(UID, 999) is not None
    assert book.find(UID, 1_000) is None


def test_a_run_ends_in_good_order_when_its_rosters_day_is_over(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(day: Day) -> None:
        day.after_frames = lambda: setattr(day.start.run._roster, "not_after_ms", virtual_now_ms())
        await day.ends_with("ROSTER_EXPIRED", frames=SPENT_FRAMES)

    a_day(tmp_path, small_bag, monkeypatch, story)


def test_a_live_run_ends_with_its_rosters_day_though_nothing_comes(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(day: Day) -> None:
        day.live()
        over_ms = virtual_now_ms() + 60_000
        day.roster_until(over_ms)
        await day.ends_with("ROSTER_EXPIRED", frames=6)
        assert virtual_now_ms() >= over_ms

    a_day(tmp_path, small_bag, monkeypatch, story)


def test_a_run_whose_day_lasts_ends_without_a_fault(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(day: Day) -> None:
        day.approve()
        await day.ends_with("", frames=6)

    a_day(tmp_path, small_bag, monkeypatch, story)


def test_a_run_ends_in_good_order_when_the_approval_of_its_empty_frames_is_over(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(day: Day) -> None:
        day.approve(for_s=60)
        day.after_frames = lambda: pass_time(60_000)
        await day.ends_with("BACKGROUND_EXPIRED", frames=SPENT_FRAMES)

    a_day(tmp_path, small_bag, monkeypatch, story)


def record_others(day: Day, frames: list[Depth]) -> None:
    """Approve another bank in the place of the one with which the run began."""
    record_scene(day.folder, VIEWPOINT, [frame + 7 for frame in frames], virtual_now_ms())
    approve_scene(day.folder, VIEWPOINT, by="A. Nurse", days=1, now_ms=virtual_now_ms())


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (
            lambda day, _: record_scene(day.folder, VIEWPOINT, day.approve(), virtual_now_ms()),
            "BACKGROUND_NOT_APPROVED",
        ),
        (lambda day, _: (day.folder / FOLDER / VIEWPOINT / "scene.json").unlink(), "BACKGROUND_NOT_FOUND"),
        (lambda day, _: (day.folder / FOLDER / VIEWPOINT / "000.png").write_bytes(b"other"), "BACKGROUND_NOT_APPROVED"),
        (record_others, "BACKGROUND_NOT_APPROVED"),
    ],
    ids=["recorded-anew", "withdrawn", "changed", "others-approved"],
)
def test_a_live_run_ends_when_its_empty_frames_are_changed_or_withdrawn(
    tmp_path: Path,
    small_bag: Path,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[Day, list[Depth]], object],
    code: str,
) -> None:
    async def story(day: Day) -> None:
        day.live()
        frames = day.approve()
        asyncio.get_running_loop().call_later(60, change, day, frames)
        began_ms = virtual_now_ms()
        await day.ends_with(code, frames=6)
        assert virtual_now_ms() - began_ms >= 60_000

    a_day(tmp_path, small_bag, monkeypatch, story)


def test_an_approval_that_is_renewed_in_time_lets_a_run_go_on(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(day: Day) -> None:
        day.live()
        day.approve(for_s=60)
        loop = asyncio.get_running_loop()
        loop.call_later(
            60 - 3 * LOOK_EVERY_S,
            lambda: approve_scene(day.folder, VIEWPOINT, by="A. Nurse", days=1, now_ms=virtual_now_ms()),
        )
        loop.call_later(120, day.start.stop.set)
        await day.ends_with("", frames=6)

    a_day(tmp_path, small_bag, monkeypatch, story)

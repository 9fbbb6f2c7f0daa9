"""A run ends when its user says so: with all that was seen in order, or at once with what is sealed in the spool."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from clients.robot.cli import main
from clients.robot.identity.robot_keys import create_identity
from clients.robot.pairing.rosters import RosterBook
from clients.robot.run.run_summary import RunProgress, RunSummary
from clients.robot.run.run_validity import RunValidity
from clients.robot.run.runner import ReplayOptions, _events
from clients.robot.sensing.sensor_events import Label, SourceEvent
from clients.robot.sources.live.synthetic_source import SyntheticSource
from clients.robot.sources.source import Clock, StoppableClock, SystemClock, play_events
from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.scenario_bag import load_or_draw_tags
from tests.unit.clients.robot.registry_stand_in import SIGNER
from tests.unit.clients.robot.run_summaries import FRAMES, summary_of
from tests.unit.clients.robot.test_pipeline import roster
from tests.virtual_time import run_virtual

FAR_S = 3_600


class Estimates:
    """A source of one estimate a second, for ever."""

    def __init__(self) -> None:
        self.start_ms = SystemClock().now_ms()

    def events(self) -> Any:
        number = 0
        while True:
            yield Label(self.start_ms + 1_000 * number, number, "calm")
            number += 1

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        return play_events(self.events(), clock)


async def listen(stop: asyncio.Event, options: ReplayOptions, stop_after: int = 0) -> int:
    """Return how many events came until the end."""
    count = 0
    source: Any = Estimates()
    tenure = RunValidity(RosterBook(roster(), SIGNER), SystemClock().now_ms)
    async for _ in _events(source, stop, options, tenure):
        count += 1
        if count == stop_after:
            stop.set()
    return count


@pytest.mark.parametrize("real_time", [True, False])
def test_a_source_that_never_ends_ends_where_it_is_stopped(real_time: bool) -> None:
    options = ReplayOptions(Path("roster"), "demo", 500, Path("events"), False, real_time)
    assert run_virtual(listen(asyncio.Event(), options, stop_after=3)) == 3


async def test_whoever_waits_for_the_next_event_hears_at_once() -> None:
    stop = asyncio.Event()
    clock = StoppableClock(stop)
    waiting = asyncio.create_task(clock.sleep_until(clock.now_ms() + FAR_S * 1_000))
    await asyncio.sleep(0)
    assert not waiting.done()
    stop.set()
    async with asyncio.timeout(5):
        await waiting


async def test_a_run_of_so_many_seconds_ends_by_itself() -> None:
    stop = asyncio.Event()
    clock = StoppableClock(stop, ends_ms=SystemClock().now_ms() - 1)
    await clock.sleep_until(clock.now_ms() + FAR_S * 1_000)
    assert stop.is_set()
    early = asyncio.Event()
    await StoppableClock(early, ends_ms=clock.now_ms() + FAR_S * 1_000).sleep_until(0)
    assert not early.is_set()


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Run the command; the run itself is a stand-in that waits to be stopped, and works on for a while then."""
    seen: list[Any] = []

    def start(*options: str, signals: int = 1) -> tuple[Any, list[Any]]:
        async def recording(
            folder: Path, source: Any, _genesis: Any, chosen: ReplayOptions, progress: Any, stop: asyncio.Event
        ) -> RunSummary:
            seen.extend((source, chosen))
            progress(RunProgress(frames_read=7, frames_recorded=4, records=2, waiting=1))
            (folder / "spool").mkdir(parents=True)
            for name in ("000000000001.clip", "000000000002.clip", ".tmp-000000000003.clip"):
                (folder / "spool" / name).touch()
            for _number in range(signals):
                os.kill(os.getpid(), signal.SIGINT)
                await asyncio.sleep(0.01)
            await stop.wait()
            return replace(summary_of(FRAMES), records=3)

        monkeypatch.setattr(main, "replay_recording", recording)
        monkeypatch.setattr(main, "load_genesis", lambda _path: None)
        monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
        create_identity(tmp_path / "robot")
        return CliRunner().invoke(main.robot, ["--robot-dir", str(tmp_path), "run", *options]), seen

    return start


def test_ctrl_c_ends_a_live_run_in_good_order_and_says_so(run: Any, tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGTERM)
    done, (source, chosen) = run("--rate", "5", "--seconds", "60")
    assert done.exit_code == 0
    assert "So far 7 frames were read; 4, counted for each owner, are recorded in 2 records." in done.output
    assert "What is in memory is now sealed and recorded too" in done.output
    assert "Ended as you asked: all that was seen until then is settled" in done.output
    assert "6 kept in 3 records" in done.output
    assert isinstance(source, SyntheticSource)
    assert (chosen.real_time, chosen.lasts_s) == (True, 60)
    assert (tmp_path / "recordings" / "tags.json").exists()
    assert signal.getsignal(signal.SIGTERM) == before


def test_ctrl_c_twice_ends_it_at_once_and_says_what_becomes_of_the_rest(run: Any) -> None:
    done, _ = run(signals=2)
    assert done.exit_code == 1
    assert "7 frames were read; 4, counted for each owner, are recorded in 2 records." in done.output
    assert "2 sealed clips wait in " in done.output
    assert " run` as before: it first records what waits" in done.output


def test_a_program_that_ends_a_run_at_once_is_told_in_one_object(run: Any) -> None:
    done, _ = run("--json", signals=2)
    assert done.exit_code == 1
    told = json.loads(done.stdout)
    assert (told["ok"], told["ended"], told["spooled_clips"]) == (False, "at-once", 2)
    assert told["progress"]["frames_recorded"] == 4


def test_a_scenario_that_cannot_be_read_is_named_before_the_run(run: Any, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("name = 1", encoding="utf-8")
    done, seen = run("--scenario", str(tmp_path / "scene.toml"))
    assert (done.exit_code != 0, seen) == (True, [])
    assert "CONFIGURATION_INVALID" in done.output


def test_tags_are_drawn_once_and_those_of_another_scene_are_not_lost(small_scenario: Scenario, tmp_path: Path) -> None:
    other = dataclasses.replace(small_scenario, people=(dataclasses.replace(small_scenario.people[0], alias="ben"),))
    first = load_or_draw_tags(tmp_path, small_scenario)
    both = load_or_draw_tags(tmp_path, other)
    assert set(first) == {"ann"}
    assert set(both) == {"ann", "ben"}
    assert load_or_draw_tags(tmp_path, small_scenario)["ann"] == first["ann"] == both["ann"]
    assert (tmp_path / "tags.json").stat().st_mode & 0o077 == 0

"""Whole runs of the robot, in virtual time: consent withdrawn while frames wait; a registry that cannot be reached."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from clients.robot.consent.consent_view import STALE_AFTER_MS
from clients.robot.recording.event_log import read_events
from clients.robot.recording.spool import Spool
from clients.robot.recording.visit_keyring import CLOSE_DELAY_MAX_MS
from clients.robot.run.pipeline import CLOSE_EVERY_S
from clients.robot.sensing.sensor_events import Frame, SourceEvent
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag
from consensus.errors import BlockRobotError
from consensus.limits import VISIT_MAX_MS
from consensus.primitives.encoding import decode
from consensus.records.envelopes import open_metadata
from consensus.records.metadata import RecordMetadata
from tests.unit.clients.robot.test_pipeline import ANN, UID, Robot, roster
from tests.unit.clients.robot.test_spool import KEY
from tests.virtual_time import in_virtual_time, run_virtual, virtual_now_ms
from tests.walking_alone import walking_alone

pytestmark = pytest.mark.usefixtures("inline_threads")

WALK = walking_alone(
    "walk",
    1.5,
    [(0.0, -0.4, 2.5), (1.5, 0.5, 2.0)],
    [0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3],
    frame_rate=10,
    also_every_s=0.2,
)


@pytest.fixture(scope="module")
def walk_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Someone walks past, near enough to be kept in every frame."""
    return make_bag(parse_scenario(WALK), {"ann": UID}, tmp_path_factory.mktemp("bags"), workers=1)


Act = Callable[["Meddled"], None]


class Meddled(Robot):
    """A run in which something happens after some frames, or while the last ones wait."""

    after_frames: int = 10**9
    act: Act
    pause_s: float = 0.0
    acted_at_ms: int = 0

    async def events(self) -> AsyncIterator[SourceEvent]:
        """Play the recording in real time; act after so many frames, and then wait."""
        count = 0
        async for event in super().events():
            at_ms = event.captured_at_ms if isinstance(event, Frame) else virtual_now_ms()
            await asyncio.sleep(max(0, at_ms - virtual_now_ms()) / 1000)
            yield event
            count += isinstance(event, Frame)
            if count == self.after_frames and not self.acted_at_ms:
                self.acted_at_ms = virtual_now_ms()
                self.act(self)
                await asyncio.sleep(self.pause_s)

    def handle(self) -> bytes:
        return self.known.rows[0].handle

    def told(self) -> dict[str, int]:
        """What the owner's records tell her of withheld frames."""
        counts: dict[str, int] = {}
        for done in self.delivered:
            for reason, count in decode(open_metadata(bytes(ANN), done.clip.sealed_metadata), RecordMetadata).withheld:
                counts[reason] = counts.get(reason, 0) + count
        return counts


def meddled(folder: Path, bag: Path, act: Act, *, after_frames: int, pause_s: float) -> Meddled:
    robot = Meddled(folder, bag, roster())
    robot.act, robot.after_frames, robot.pause_s = act, after_frames, pause_s
    run_virtual(robot.run())
    return robot


def withdraw(robot: Meddled) -> None:
    robot.registry.say(robot.handle(), "withdrawn")


def test_without_a_no_every_frame_is_kept(tmp_path: Path, walk_bag: Path) -> None:
    """Else the tests below would show nothing."""
    robot = meddled(tmp_path, walk_bag, lambda _: None, after_frames=3, pause_s=1.5)
    counts = robot.statistics.count_frames()
    assert (counts.kept, counts.withheld, counts.lost) == (15, 0, 0)


def test_consent_that_is_withdrawn_while_frames_wait_for_the_matcher_leaves_nothing(
    tmp_path: Path, walk_bag: Path
) -> None:
    """All frames of this recording still wait for pairing and matching when the robot sees the no."""
    robot = meddled(tmp_path, walk_bag, withdraw, after_frames=3, pause_s=1.5)
    assert robot.network.calls == []
    assert robot.network.uploads == {}
    assert robot.spool.names() == []
    counts = robot.statistics.count_frames()
    assert counts.covered > 0
    assert (counts.lost, counts.kept) == (0, 0)
    assert counts.withheld_reasons == {"no-consent": counts.covered}
    reasons = {event.detail["reason"] for event in read_events(robot.log_path) if "reason" in event.detail}
    assert "no-consent" in reasons


@in_virtual_time
async def test_consent_that_is_withdrawn_while_sealed_clips_wait_for_the_network_leaves_nothing(
    tmp_path: Path, walk_bag: Path
) -> None:
    robot = Meddled(tmp_path, walk_bag, roster())
    robot.network.refusals = ["NODE_UNREACHABLE"] * 10_000
    running = asyncio.create_task(robot.run())
    await asyncio.sleep(30)
    assert robot.spool.names()
    robot.registry.say(robot.handle(), "withdrawn")
    await asyncio.sleep(3)
    robot.network.refusals = []
    await running
    assert (robot.network.visits, robot.network.records, robot.network.uploads) == ({}, {}, {})
    assert robot.spool.names() == []
    counts = robot.statistics.count_frames()
    assert (counts.lost, counts.kept) == (0, 0)
    assert robot.consents.figures.clips_dropped >= 1
    assert robot.open_visits.counts == {}
    assert robot.network.times("close_visit") == [], "a visit that nobody heard of leaves no trace"


def test_a_robot_that_restarts_asks_again_for_what_it_had_sealed(tmp_path: Path, walk_bag: Path) -> None:
    first = Robot(tmp_path, walk_bag, roster())

    async def cut_short() -> None:
        first.network.refusals = ["NODE_UNREACHABLE"] * 10_000
        running = asyncio.create_task(first.run())
        await asyncio.sleep(30)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    run_virtual(cut_short())
    assert first.spool.names()
    second = Robot(tmp_path, walk_bag, roster(), purposes=("research",))
    run_virtual(second.run())
    assert second.spool.names() == []
    assert second.network.records == {}
    assert second.consents.figures.clips_dropped >= 1


async def killed_once(robot: Robot, is_time: Callable[[], bool]) -> None:
    """Let the robot work until it is time, and end it there as a kill would: nothing more is done."""
    running = asyncio.create_task(robot.run())
    for _ in range(6_000):
        if is_time():
            break
        await asyncio.sleep(0.01)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


def test_a_visit_that_was_announced_before_a_kill_is_closed_though_she_said_no_meanwhile(
    tmp_path: Path, walk_bag: Path
) -> None:
    """Everybody has seen it open; she must not wait for records that will never be."""
    first = Robot(tmp_path, walk_bag, roster())
    first.network.upload_refusals = ["NODE_UNREACHABLE"] * 10_000
    run_virtual(killed_once(first, lambda: bool(first.network.visits)))
    second = Robot(tmp_path, walk_bag, roster(), purposes=("research",))
    second.network.visits = first.network.visits
    run_virtual(second.run())
    assert second.network.closed == dict.fromkeys(first.network.visits, 0)
    assert (second.network.records, second.open_visits.counts, second.spool.names()) == ({}, {}, [])


def test_a_visit_that_nobody_heard_of_leaves_no_trace_though_the_robot_was_killed_while_it_destroyed_it(
    tmp_path: Path, walk_bag: Path
) -> None:
    """The last clip is gone already and still counted: the next life must not close what was never announced."""
    first = Robot(tmp_path, walk_bag, roster())
    first.network.refusals = ["NODE_UNREACHABLE"] * 10_000
    run_virtual(killed_once(first, lambda: bool(first.network.calls)))
    for name in first.spool.names():
        first.spool.destroy(name)
    assert sum(first.open_visits.counts.values()) > 0
    second = Robot(tmp_path, walk_bag, roster(), purposes=("research",))
    run_virtual(second.run())
    assert (second.network.calls, second.open_visits.counts) == ([], {})


def test_a_registry_that_cannot_be_reached_closes_the_robot_and_the_owner_is_told_later(
    tmp_path: Path, walk_bag: Path
) -> None:
    def cut(robot: Meddled) -> None:
        robot.registry.failure = "NODE_UNREACHABLE"

    async def main() -> Meddled:
        robot = Meddled(tmp_path, walk_bag, roster())
        robot.act, robot.after_frames, robot.pause_s = cut, 3, STALE_AFTER_MS / 1000 + 30
        running = asyncio.create_task(robot.run())
        await asyncio.sleep(STALE_AFTER_MS / 1000 + 120)
        robot.registry.failure = ""
        await running
        return robot

    robot = run_virtual(main())
    counts = robot.statistics.count_frames()
    figures = robot.consents.figures
    assert (counts.kept, counts.lost) == (0, 0)
    assert counts.covered > 0
    assert set(counts.withheld_reasons) <= {"registry-stale", "no-silhouette", "no-distance", "ambiguous", "disordered"}
    assert counts.withheld_reasons["registry-stale"] > 0
    assert (figures.stale_count, figures.failures > 100) == (1, True)
    assert robot.network.uploads == {}


def test_a_registry_that_is_away_for_a_minute_costs_nothing(tmp_path: Path, walk_bag: Path) -> None:
    """Sealed clips wait in the spool; they go to the chain once the registry was asked again."""

    def cut(robot: Meddled) -> None:
        robot.registry.failure = "NODE_UNREACHABLE"

    async def main() -> Meddled:
        robot = Meddled(tmp_path, walk_bag, roster())
        robot.act, robot.after_frames, robot.pause_s = cut, 3, 0.0
        running = asyncio.create_task(robot.run())
        await asyncio.sleep(60)
        assert robot.network.records == {}
        assert robot.spool.names()
        robot.registry.failure = ""
        await running
        return robot

    robot = run_virtual(main())
    counts = robot.statistics.count_frames()
    assert counts.kept > 0
    assert counts.lost == 0
    assert "registry-stale" not in counts.withheld_reasons
    assert robot.told() == counts.withheld_reasons


def test_of_a_break_between_two_readings_what_was_taken_before_it_is_dropped(tmp_path: Path, walk_bag: Path) -> None:
    def break_off(robot: Meddled) -> None:
        robot.registry.say(robot.handle(), "withdrawn")
        robot.registry.say(robot.handle())

    robot = meddled(tmp_path, walk_bag, break_off, after_frames=8, pause_s=0.0)
    counts = robot.statistics.count_frames()
    assert (counts.kept, counts.withheld_reasons["outside-consent"], counts.lost) == (8, 7, 0), (
        "the eighth is of that moment"
    )
    per_owner = {owner: list(robot.network.records.values()).count(owner) for owner in robot.network.visits}
    assert robot.network.closed == per_owner


@pytest.mark.parametrize("act", [withdraw, lambda _: None])
def test_when_a_visit_is_closed_does_not_tell_that_she_said_no(tmp_path: Path, walk_bag: Path, act: Act) -> None:
    """Her word and the closing both stand on the chain: side by side they would name her."""

    class Live(Meddled):
        live = True

        async def events(self) -> AsyncIterator[SourceEvent]:
            async for event in super().events():
                yield event
            await asyncio.sleep(30)
            act(self)
            await asyncio.sleep((VISIT_MAX_MS + CLOSE_DELAY_MAX_MS) / 1000)
            assert robot.open_visits.counts == {}

    robot = Live(tmp_path, walk_bag, roster())
    robot.act = lambda _: None
    run_virtual(robot.run())
    (opened_ms,), (closed_ms,) = robot.network.times("open_visit"), robot.network.times("close_visit")
    rolled_ms = VISIT_MAX_MS - 60_000
    assert rolled_ms - 5_000 <= closed_ms - opened_ms <= rolled_ms + CLOSE_DELAY_MAX_MS + CLOSE_EVERY_S * 1_000


@pytest.mark.parametrize("after_frames", [3, 15])
@in_virtual_time
async def test_a_robot_whose_key_was_revoked_stops_also_while_nothing_is_to_be_recorded(
    tmp_path: Path, walk_bag: Path, after_frames: int
) -> None:
    """The camera falls silent for good: only the robot itself can notice."""

    def revoke(robot: Meddled) -> None:
        robot.registry.failure = "SESSION_REFUSED"

    class Live(Meddled):
        live = True

    robot = Live(tmp_path, walk_bag, roster(), purposes=("research",))
    robot.act, robot.after_frames, robot.pause_s = revoke, after_frames, 10**6
    began_ms = virtual_now_ms()
    with pytest.raises(BlockRobotError, match="SESSION_REFUSED"):
        await robot.run()
    assert virtual_now_ms() - began_ms < 10_000


@in_virtual_time
async def test_what_fails_while_the_camera_is_silent_ends_the_run(tmp_path: Path, walk_bag: Path) -> None:
    class Live(Meddled):
        live = True

    robot = Live(tmp_path, walk_bag, roster())
    robot.act, robot.after_frames, robot.pause_s = lambda _: None, 15, 10**6
    robot.spool = Spool(tmp_path / "spool", KEY, max_bytes=10)
    began_ms = virtual_now_ms()
    with pytest.raises(BlockRobotError, match="SPOOL_FULL"):
        await robot.run()
    assert virtual_now_ms() - began_ms < 60_000

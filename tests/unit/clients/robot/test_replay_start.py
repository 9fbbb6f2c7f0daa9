"""The beginning of a run, in virtual time: no recording is used up while the chain proves nothing of now."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from clients.robot.hiding.background import EmptyFrame
from clients.robot.identity.robot_keys import RobotIdentity
from clients.robot.pairing.rosters import RosterBook
from clients.robot.run import runner
from clients.robot.run.runner import FRESH_WITHIN_MS, ReplayOptions
from clients.robot.sources.recordings.bag_source import BagSource
from consensus.chain.epoch_settings import ChainSettings
from consensus.errors import BlockRobotError
from consensus.state.identity import HANDLE
from tests.unit.clients.robot.registry_stand_in import ROBOT, SIGNER, RegistryStandIn
from tests.unit.clients.robot.test_delivery import FakeNetwork
from tests.unit.clients.robot.test_pipeline import CHAIN, DAY_MS, roster
from tests.unit.clients.robot.test_spool import KEY
from tests.virtual_time import in_virtual_time, virtual_now_ms

HOUR_MS = 3_600_000
HEARTBEAT_MS = 30_000


class Network(FakeNetwork):
    """What a run needs beside delivery."""

    @property
    def refused_uploads(self) -> dict[str, int]:
        return {}

    async def find_unapproved(self, frames: object) -> list[EmptyFrame]:
        return []

    async def publish_empty_frames(self, frames: object) -> None:
        pass


class Start:
    """A robot before an idle chain whose newest block is an hour old."""

    def __init__(self, folder: Path, bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        known = roster()
        self.registry = RegistryStandIn(known, virtual_now_ms)
        self.registry.say(known.rows[0].handle, since_ms=virtual_now_ms() - DAY_MS)
        self.registry.idle, self.registry.time_ms = True, virtual_now_ms() - HOUR_MS
        settings = ChainSettings(heartbeat_ms=HEARTBEAT_MS)
        client: Any = self.registry
        client.genesis = SimpleNamespace(chain_id=CHAIN, settings=settings)
        self.epoch = SimpleNamespace(settings=settings)
        client.light_client = SimpleNamespace(epoch=self.epoch)
        self.network, self.stop = Network(), asyncio.Event()
        identity = RobotIdentity(ROBOT, ROBOT, ROBOT, bytes(32), KEY)
        monkeypatch.setattr(runner, "load_identity", lambda *_: identity)
        monkeypatch.setattr(runner, "load_roster", lambda *_: RosterBook(known, SIGNER))
        monkeypatch.setattr(runner, "RobotNetwork", lambda *_: self.network)
        monkeypatch.setattr(runner, "NetworkMajority", lambda *_: self.registry)
        self.told: list[str] = []
        options = ReplayOptions(
            folder / "roster", "demo", 200, folder / "events.jsonl", True, False, tell=self.told.append
        )
        self.source = BagSource(bag)
        self.run = runner._Run(folder, client, options, lambda figures, *, last=False: None, self.stop)

    async def block_after(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        self.registry.block()
        self.registry.idle = False


@in_virtual_time
async def begin(
    folder: Path, bag: Path, monkeypatch: pytest.MonkeyPatch, story: Callable[[Start], Awaitable[None]]
) -> None:
    await story(Start(folder, bag, monkeypatch))


def test_the_first_block_after_an_outage_is_waited_for_and_every_frame_covered(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(start: Start) -> None:
        began_ms = virtual_now_ms()
        block = asyncio.create_task(start.block_after(30))
        summary = await start.run.work(start.source)
        await block
        assert virtual_now_ms() - began_ms >= 30_000
        counts = summary.frames
        assert counts.covered == counts.published > 0
        assert "registry-stale" not in counts.withheld_reasons

    begin(tmp_path, small_bag, monkeypatch, story)


def test_a_roster_of_whom_the_chain_confirms_nobody_is_told_of_before_the_recording_is_used_up(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story(start: Start) -> None:
        for row in roster().rows:
            del start.registry.state[HANDLE.key(row.handle)]
        start.registry.block()
        start.stop.set()
        await start.run.work(start.source)
        (said,) = start.told
        assert "confirms nobody of the roster" in said

    begin(tmp_path, small_bag, monkeypatch, story)


@pytest.mark.parametrize(("failure", "code"), [("", "REGISTRY_STALE"), ("SESSION_REFUSED", "SESSION_REFUSED")])
def test_where_no_block_comes_the_run_ends_before_a_frame_is_read(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch, failure: str, code: str
) -> None:
    async def story(start: Start) -> None:
        monkeypatch.setattr(start.source, "shift_to", lambda _: pytest.fail("the recording is played"))
        began_ms, working = virtual_now_ms(), asyncio.create_task(start.run.work(start.source))
        await asyncio.sleep(2)
        start.registry.failure = failure
        with pytest.raises(BlockRobotError, match=code):
            await working
        assert virtual_now_ms() - began_ms <= HEARTBEAT_MS + FRESH_WITHIN_MS + 1_000

    begin(tmp_path, small_bag, monkeypatch, story)


def test_empty_frames_with_somebody_in_them_end_the_run_before_they_are_published(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Network, "publish_empty_frames", lambda *_: pytest.fail("somebody became public"))

    async def story(start: Start) -> None:
        start.registry.block()
        start.registry.idle = False
        empty = start.source.empty_frames() * 4
        somebody = empty[0].copy()
        somebody[20:110, 60:80] = 1_000
        monkeypatch.setattr(start.source, "empty_frames", lambda: [*empty, somebody])
        with pytest.raises(BlockRobotError, match="BACKGROUND_INVALID"):
            await start.run.work(start.source)

    begin(tmp_path, small_bag, monkeypatch, story)


def test_a_heartbeat_that_the_organisations_raised_counts_as_it_is_in_force(
    tmp_path: Path, small_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else an idle chain would look dead to its robots."""

    async def story(start: Start) -> None:
        start.epoch.settings = ChainSettings(heartbeat_ms=HOUR_MS)
        summary = await start.run.work(start.source)
        assert "registry-stale" not in summary.frames.withheld_reasons
        assert summary.consents.stale_times == 0

    begin(tmp_path, small_bag, monkeypatch, story)

"""What a robot must not forget is on the medium in its order, and neither camera nor uploads wait for that."""

from __future__ import annotations

import asyncio
import itertools
import os
import shutil
import threading
from pathlib import Path

import pytest

from clients.robot.delivery.delivery import Delivery
from clients.robot.recording.spool import Spool, SpooledClip
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.counted import note
from tests.unit.clients.robot.test_consent_in_a_run import WALK
from tests.unit.clients.robot.test_delivery import Run
from tests.unit.clients.robot.test_pipeline import UID, Robot, roster
from tests.unit.clients.robot.test_spool import KEY
from tests.virtual_time import in_virtual_time, run_virtual


class Counted(Run):
    """Clips of one visit that is counted in a file, as a whole robot counts them."""

    def __init__(self, folder: Path, clips: int) -> None:
        super().__init__(folder / "spool", clips=clips)
        self.folder = folder
        self.visits = UnclosedVisitStore(folder / "visits", KEY)
        self.owner = self.spool.get(self.names[0]).owner
        note(self.visits, self.owner, clips)

    async def note_dropped(self, clip: SpooledClip) -> None:
        await super().note_dropped(clip)
        self.visits.lower(clip.owner)
        await asyncio.to_thread(self.visits.save)

    def refuse(self, *names: str) -> None:
        self.refused = {self.spool.get(name).upload.record_id for name in names}

    @property
    def on_disk(self) -> tuple[int, dict[bytes, int]]:
        """What a robot that begins again finds: how many clips, and what each visit is counted to have."""
        return len(Spool(self.folder / "spool", KEY).names()), UnclosedVisitStore(self.folder / "visits", KEY).counts


@pytest.fixture
def syncing_threads(monkeypatch: pytest.MonkeyPatch) -> list[threading.Thread]:
    """The threads that wait for the medium, from now on."""
    threads: list[threading.Thread] = []
    sync = os.fsync

    def noted(descriptor: int) -> None:
        threads.append(threading.current_thread())
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    return threads


@in_virtual_time
async def test_the_event_loop_never_waits_for_the_medium(
    tmp_path: Path, syncing_threads: list[threading.Thread]
) -> None:
    run = Counted(tmp_path, clips=4)
    run.refuse(*run.names[:2])
    syncing_threads.clear()
    delivery = await run.deliver_all()
    await delivery.close_over(run.visits, lambda _: False)
    assert (len(run.dropped), run.network.closed, run.on_disk) == (2, {run.owner: 2}, (0, {}))
    assert len(syncing_threads) >= 2 * 3 + 2 + 1, "each clip's name, bytes and name again; each count; the closing"
    assert threading.main_thread() not in syncing_threads


def test_a_clip_is_gone_before_its_visit_is_said_to_be_shorter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed in between, its owner hears of one record too many, never of one too few."""
    run = Counted(tmp_path, clips=3)
    run.refuse(*run.names)
    found = []
    save = run.visits.save

    def noted() -> None:
        found.append(run.on_disk)
        save()

    monkeypatch.setattr(run.visits, "save", noted)
    run_virtual(run.deliver_all())
    assert found == [(2, {run.owner: 3}), (1, {run.owner: 2}), (0, {run.owner: 1})]
    assert run.on_disk == (0, {run.owner: 0})


def test_what_is_being_destroyed_when_a_run_is_ended_is_destroyed_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Counted(tmp_path, clips=2)
    run.refuse(run.names[0])
    begun, may_end = threading.Event(), threading.Event()
    destroy = run.spool.destroy

    def slow(name: str) -> None:
        begun.set()
        assert may_end.wait(10)
        destroy(name)

    monkeypatch.setattr(run.spool, "destroy", slow)

    async def main(delivery: Delivery) -> None:
        delivery.start(run.names[0])
        await asyncio.to_thread(begun.wait, 10)
        stopping = asyncio.create_task(delivery.stop())
        await asyncio.sleep(0)
        may_end.set()
        await stopping

    asyncio.run(main(run.delivery()))
    assert (len(run.dropped), run.on_disk) == (1, (1, {run.owner: 1}))


@pytest.mark.usefixtures("inline_threads")
def test_killed_at_any_sync_of_a_run_a_robot_counts_what_was_ever_spooled_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is counted that never was on the medium, and nothing is on its way to the chain that is not counted."""
    bag = make_bag(parse_scenario(WALK), {"ann": UID}, tmp_path / "bags", workers=1)
    robot = Robot(tmp_path / "robot", bag, roster())
    sync, start, remove = os.fsync, Delivery.start, Spool.remove
    found: list[tuple[int, int]] = []
    delivered: list[str] = []
    copies = itertools.count()

    def look() -> tuple[int, int]:
        """Begin again with a copy of what is on the medium now. Return what was counted, and what was ever spooled."""
        left = tmp_path / f"left-{next(copies)}"
        shutil.copytree(tmp_path / "robot", left)
        with monkeypatch.context() as plain:
            plain.setattr(os, "fsync", sync)
            spool, visits = Spool(left / "spool", KEY), UnclosedVisitStore(left / "open-visits", KEY)
            counted, spooled = sum(visits.counts.values()), len(spool.names()) + len(delivered)
            visits.recover_spooled(spool)
        assert sum(visits.counts.values()) == spooled
        return counted, spooled

    def synced(descriptor: int) -> None:
        sync(descriptor)
        if not robot.network.closed:
            found.append(look())

    def started(delivery: Delivery, name: str) -> None:
        counted, spooled = look()
        assert counted == spooled, "nobody else may hear of it before it is counted"
        start(delivery, name)

    def removed(spool: Spool, name: str) -> None:
        remove(spool, name)
        delivered.append(name)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Delivery, "start", started)
    monkeypatch.setattr(Spool, "remove", removed)
    run_virtual(robot.run())
    assert len(delivered) > 2
    assert {spooled - counted for counted, spooled in found} == {0, 1}


@pytest.mark.usefixtures("inline_threads")
def test_a_clip_for_which_there_is_no_room_counts_as_missing(tmp_path: Path, small_bag: Path) -> None:
    robot = Robot(tmp_path / "robot", small_bag, roster())
    robot.spool = Spool(tmp_path / "robot" / "spool", KEY, max_bytes=10)
    with pytest.raises(BlockRobotError, match="SPOOL_FULL"):
        run_virtual(robot.run())
    assert list(UnclosedVisitStore(tmp_path / "robot" / "open-visits", KEY).counts.values()) == [1]

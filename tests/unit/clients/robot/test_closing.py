"""At the end of a run every visit that the chain knows is closed with its count, and of no other the chain hears."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import msgspec
import pytest

from clients.robot.delivery.delivery import Delivery
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.recording.visit_keyring import CLOSE_DELAY_MAX_MS
from clients.robot.sensing.sensor_events import Odometry, SourceEvent
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenario_bag import make_bag
from consensus.limits import VISIT_MAX_MS
from tests.unit.clients.robot.counted import note
from tests.unit.clients.robot.test_consent_in_a_run import WALK
from tests.unit.clients.robot.test_delivery import LATENCY_MS, Run
from tests.unit.clients.robot.test_pipeline import UID, Robot, roster
from tests.unit.clients.robot.test_spool import KEY, clip
from tests.virtual_time import in_virtual_time, run_virtual, virtual_now_ms

pytestmark = pytest.mark.usefixtures("inline_threads")


@in_virtual_time
async def test_a_visit_is_closed_with_its_count_and_closing_twice_is_harmless(tmp_path: Path) -> None:
    run = Run(tmp_path, clips=2)
    delivery = await run.deliver_all()
    await delivery.close_visit(run.done[0].clip.owner, 2)
    await delivery.close_visit(run.done[0].clip.owner, 2)
    assert run.network.closed == {run.done[0].clip.owner: 2}


def closed_by(run: Run, delivery: Delivery, visits: UnclosedVisitStore) -> dict[bytes, int]:
    run_virtual(delivery.close_visits(visits))
    assert visits.counts == {}
    return run.network.closed


def test_all_that_was_announced_in_this_run_is_closed_and_no_node_is_asked(tmp_path: Path) -> None:
    run = Run(tmp_path / "spool", clips=2)
    owner = run.spool.get(run.names[0]).owner
    visits = UnclosedVisitStore(tmp_path / "visits", KEY)
    note(visits, owner, 2)
    delivery = run_virtual(run.deliver_all())
    assert closed_by(run, delivery, visits) == {owner: 2}
    assert run.network.asked_visits == []


def test_a_visit_that_this_run_never_tried_to_announce_is_forgotten_and_no_node_hears_of_it(tmp_path: Path) -> None:
    run = Run(tmp_path / "spool", clips=0)
    visits = UnclosedVisitStore(tmp_path / "visits", KEY)
    note(visits, b"\x02" * 33, 1)
    assert closed_by(run, run.delivery(), visits) == {}
    assert (run.network.calls, run.network.asked_visits) == ([], [])


@pytest.mark.parametrize("announced", [True, False])
def test_of_an_earlier_runs_visit_the_chain_is_asked_whether_it_was_announced(tmp_path: Path, announced: bool) -> None:
    """The robot was killed: it cannot know. A network that is away is asked until it answers."""
    owner = b"\x02" * 33
    note(UnclosedVisitStore(tmp_path / "visits", KEY), owner, 1)
    run = Run(tmp_path / "spool", clips=0)
    run.network.visits = {owner: []} if announced else {}
    run.network.question_refusals = ["NODE_UNREACHABLE"] * 3
    assert closed_by(run, run.delivery(), UnclosedVisitStore(tmp_path / "visits", KEY)) == (
        {owner: 1} if announced else {}
    )
    assert run.network.asked_visits == [owner]
    assert len(run.network.times("close_visit")) == announced


def test_during_a_run_a_visit_is_closed_once_it_is_over_and_all_its_records_are_final(tmp_path: Path) -> None:
    """A run may last for days, and its people need not wait that long to know that nothing is missing."""
    run = Run(tmp_path / "spool", clips=2)
    owner = run.spool.get(run.names[0]).owner
    visits = UnclosedVisitStore(tmp_path / "visits", KEY)
    note(visits, owner, 2)
    going_on = {owner}

    async def main() -> list[dict[bytes, int]]:
        delivery, found = run.delivery(), []
        delivery.start(run.names[0])
        await delivery.drain()
        going_on.clear()
        await delivery.close_over(visits, going_on.__contains__)
        found.append(dict(run.network.closed))
        delivery.start(run.names[1])
        await delivery.drain()
        going_on.add(owner)
        await delivery.close_over(visits, going_on.__contains__)
        found.append(dict(run.network.closed))
        going_on.clear()
        await delivery.close_over(visits, going_on.__contains__)
        return [*found, dict(run.network.closed)]

    assert run_virtual(main()) == [{}, {}, {owner: 2}]
    assert visits.counts == {}


class TwoOver(Run):
    """Two visits of one record each; the first is being closed, over a cut, when something happens to the second."""

    FIRST, SECOND = b"\x02" * 33, b"\x03" * 33

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / "spool", clips=0)
        self.visits = UnclosedVisitStore(folder / "visits", KEY)
        self.going_on = {self.SECOND}
        self.under_way = self.delivery()

    def seal(self, number: int, owner: bytes) -> None:
        """Do as the pipeline does when it seals the visit's next clip."""
        note(self.visits, owner, self.visits.counts.get(owner, 0) + 1)
        self.under_way.start(self.spool.put(msgspec.structs.replace(clip(number), owner=owner)))

    async def close_while(self, meanwhile: Callable[[], None], *, cut_ms: int) -> dict[bytes, int]:
        """Return what is closed after one round during which that happens, and all is delivered."""
        self.seal(1, self.FIRST)
        self.seal(2, self.SECOND)
        await self.under_way.drain()
        self.network.close_refusals = ["NODE_UNREACHABLE"] * 3
        round_of_closing = asyncio.create_task(self.under_way.close_over(self.visits, self.going_on.__contains__))
        await asyncio.sleep(cut_ms / 1000)
        meanwhile()
        await round_of_closing
        await self.under_way.drain()
        return self.network.closed


@pytest.mark.parametrize("cut_ms", range(1_300, 1_600, 20))
@in_virtual_time
async def test_a_clip_that_is_sealed_while_another_visit_is_closed_is_counted_in_its_own(
    tmp_path: Path, cut_ms: int
) -> None:
    """Its visit is over soon after, and not closed short of it: the chain would refuse it, at each start again."""
    run = TwoOver(tmp_path)

    def seal_the_last() -> None:
        run.seal(3, run.SECOND)
        run.going_on.clear()

    await run.close_while(seal_the_last, cut_ms=cut_ms)
    await run.under_way.close_over(run.visits, run.going_on.__contains__)
    assert run.network.closed == {run.FIRST: 1, run.SECOND: 2}
    assert (run.visits.counts, run.spool.names()) == ({}, [])


@in_virtual_time
async def test_a_visit_that_is_refused_keeps_no_other_from_being_closed(tmp_path: Path) -> None:
    run = TwoOver(tmp_path)
    run.going_on.clear()
    await run.close_while(lambda: run.network.close_refusals.append("SENDER_NOT_ADMITTED"), cut_ms=1)
    assert run.network.closed == {run.SECOND: 1}
    await run.under_way.close_over(run.visits, run.going_on.__contains__)
    assert run.network.closed == {run.FIRST: 1, run.SECOND: 1}


@in_virtual_time
async def test_a_visit_that_went_on_after_a_clip_was_destroyed_is_closed_with_what_is_on_the_chain(
    tmp_path: Path,
) -> None:
    run = Run(tmp_path / "spool", clips=3)
    first = run.spool.get(run.names[0])
    visits = UnclosedVisitStore(tmp_path / "visits", KEY)
    run.refused = {first.upload.record_id}
    delivery = run.delivery()
    for place, name in enumerate(run.names):
        note(visits, first.owner, place + 1)
        delivery.start(name)
        await delivery.drain()
        if place == 0:
            visits.lower(first.owner)
    await delivery.close_over(visits, lambda _: False)
    assert (run.network.closed, visits.counts) == ({first.owner: 2}, {})


def test_a_visit_of_an_earlier_life_is_left_to_the_end_of_the_run(tmp_path: Path) -> None:
    """How many of its records are final only that life knew."""
    note(UnclosedVisitStore(tmp_path / "visits", KEY), b"\x02" * 33, 0)
    run = Run(tmp_path / "spool", clips=0)
    visits = UnclosedVisitStore(tmp_path / "visits", KEY)
    run_virtual(run.delivery().close_over(visits, lambda _: False))
    assert (visits.counts, run.network.asked_visits) == ({b"\x02" * 33: 0}, [])


@in_virtual_time
async def test_a_visit_all_of_whose_clips_were_destroyed_during_the_run_is_forgotten_without_a_word(
    tmp_path: Path,
) -> None:
    run = Run(tmp_path / "spool")
    sealed = run.spool.get(run.names[0])
    visits = UnclosedVisitStore(tmp_path / "visits", KEY)
    note(visits, sealed.owner, 1)
    run.refused = {sealed.upload.record_id}
    delivery = await run.deliver_all()
    visits.lower(sealed.owner)
    await delivery.close_over(visits, lambda _: False)
    assert (visits.counts, run.network.calls, run.network.asked_visits) == ({}, [], [])


def test_an_announcement_whose_answer_was_lost_before_she_said_no_is_closed_all_the_same(tmp_path: Path) -> None:
    run = Run(tmp_path / "spool")
    sealed = run.spool.get(run.names[0])
    visits = UnclosedVisitStore(tmp_path / "visits", KEY)
    note(visits, sealed.owner, 0)

    async def main() -> Delivery:
        run.network.answers_lost_count = 1
        delivery = run.delivery()
        delivery.start(run.names[0])
        await asyncio.sleep(LATENCY_MS / 1000 + 0.01)
        run.refused = {sealed.upload.record_id}
        await delivery.drain()
        return delivery

    assert closed_by(run, run_virtual(main()), visits) == {sealed.owner: 0}
    assert run.network.records == {}


ODOMETRY_EVERY_MS = 500


class Watching(Robot):
    """A live run in which nobody comes any more: `closed_meanwhile` is what was closed before its end."""

    live = True
    closed_meanwhile: dict[bytes, int]

    async def events(self) -> AsyncIterator[SourceEvent]:
        async for event in super().events():
            yield event
        await asyncio.sleep((VISIT_MAX_MS + CLOSE_DELAY_MAX_MS) / 1000)
        self.closed_meanwhile = dict(self.network.closed)


def test_a_robot_that_goes_on_closes_a_visit_when_it_is_over(tmp_path: Path) -> None:
    bag = make_bag(parse_scenario(WALK), {"ann": UID}, tmp_path / "bags", workers=1)
    robot = Watching(tmp_path, bag, roster())
    run_virtual(robot.run())
    owners = list(robot.network.records.values())
    assert robot.closed_meanwhile == {owner: owners.count(owner) for owner in robot.network.visits}
    assert len(robot.network.times("close_visit")) == len(robot.closed_meanwhile) == 1
    assert robot.open_visits.counts == {}


class Parked(Watching):
    """Its camera has ended; its wheels go on telling where it is."""

    async def events(self) -> AsyncIterator[SourceEvent]:
        async for event in Robot.events(self):
            yield event
        for _ in range((VISIT_MAX_MS + CLOSE_DELAY_MAX_MS) // ODOMETRY_EVERY_MS):
            await asyncio.sleep(ODOMETRY_EVERY_MS / 1000)
            yield Odometry(virtual_now_ms(), 0.0, 0.0, 0.0, received_at_ms=virtual_now_ms())
        self.closed_meanwhile = dict(self.network.closed)


def test_odometry_keeps_no_frame_of_a_dead_camera_undecided(tmp_path: Path) -> None:
    bag = make_bag(parse_scenario(WALK), {"ann": UID}, tmp_path / "bags", workers=1)
    robot = Parked(tmp_path, bag, roster())
    run_virtual(robot.run())
    owners = list(robot.network.records.values())
    assert owners
    assert robot.closed_meanwhile == {owner: owners.count(owner) for owner in robot.network.visits}

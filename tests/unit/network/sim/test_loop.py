"""The virtual loop: time jumps, the dead do nothing, the paused wait."""

from __future__ import annotations

import asyncio

from network.sim.world.virtual_time import Owner, PowerCutError, SimLoop


def test_waits_take_no_time_and_things_happen_in_the_order_of_their_times() -> None:
    loop, seen = SimLoop(1), []

    async def wait(seconds: float) -> None:
        await asyncio.sleep(seconds)
        seen.append((loop.time(), seconds))

    for seconds in (3_600.0, 0.5, 60.0):
        loop.create_task(wait(seconds))
    assert not loop.run_until(lambda: False, 4_000.0)
    assert seen == [(0.5, 0.5), (60.0, 60.0), (3_600.0, 3_600.0)]


def test_nothing_of_a_killed_owner_runs_any_more() -> None:
    loop, owner, seen = SimLoop(1), Owner("node"), []
    loop.call_for(owner, 1.0, seen.append, "before")
    loop.call_for(owner, 3.0, seen.append, "after")
    loop.call_for(loop.stage, 2.0, loop.kill, owner)
    loop.run_until(lambda: False, 10.0)
    assert seen == ["before"]


def test_a_power_cut_ends_a_callback_in_its_middle_and_nothing_else() -> None:
    loop, owner, seen = SimLoop(1), Owner("node"), []

    def dies() -> None:
        seen.append("begun")
        loop.kill(owner)
        raise PowerCutError("now")

    loop.call_for(owner, 1.0, dies)
    loop.call_for(loop.stage, 2.0, seen.append, "the rest goes on")
    loop.run_until(lambda: False, 10.0)
    assert seen == ["begun", "the rest goes on"]
    assert loop.faults == []


def test_a_paused_owner_does_what_was_due_once_it_goes_on() -> None:
    loop, owner, seen = SimLoop(1), Owner("node"), []
    loop.pause(owner)
    loop.call_for(owner, 1.0, lambda: seen.append(loop.time()))
    loop.call_for(loop.stage, 5.0, loop.resume, owner)
    loop.run_until(lambda: False, 10.0)
    assert seen == [5.0]


def test_work_for_a_thread_is_done_inline_a_little_later() -> None:
    loop, seen = SimLoop(1), []

    async def ask() -> None:
        seen.append(await asyncio.to_thread(lambda: 7))

    loop.create_task(ask())
    loop.run_until(lambda: bool(seen), 1.0)
    assert seen == [7]
    assert loop.time() > 0


def test_the_stage_is_never_busy_and_an_exception_that_nobody_catches_is_noted_with_its_place() -> None:
    loop = SimLoop(1)

    def fails() -> None:
        raise KeyError("lost")

    loop.call_soon(fails)
    loop.run_until(lambda: False, 1.0)
    assert len(loop.faults) == 1
    assert "KeyError('lost') at fails" in loop.faults[0]
    loop = SimLoop(1)
    loop.call_for(loop.stage, 1.0, loop.occupy, 9.0)
    loop.run_until(lambda: False, 2.0)
    assert loop.stage.free_at_s == 0.0


def test_what_is_due_while_a_core_is_busy_waits_and_is_done_in_its_order() -> None:
    loop, owner, other, seen = SimLoop(1), Owner("node"), Owner("other"), []

    def work(name: str) -> None:
        seen.append((name, round(loop.time(), 3)))
        loop.occupy(0.5)

    for name, at_s in (("a", 1.0), ("b", 1.1), ("c", 1.2), ("d", 3.0)):
        loop.call_for(owner, at_s, work, name)
    loop.call_for(other, 1.3, lambda: seen.append(("other", loop.time())))
    loop.run_until(lambda: False, 10.0)
    assert seen == [("a", 1.0), ("other", 1.3), ("b", 1.5), ("c", 2.0), ("d", 3.0)]


def test_a_busy_owner_that_is_paused_or_killed_does_nothing_more() -> None:
    for end in ("pause", "kill"):
        loop, owner, seen = SimLoop(1), Owner("node"), []
        loop.call_for(owner, 1.0, loop.occupy, 1.0)
        loop.call_for(owner, 1.5, seen.append, "waited")
        loop.call_for(loop.stage, 1.7, getattr(loop, end), owner)
        loop.call_for(loop.stage, 5.0, loop.resume, owner)
        loop.run_until(lambda: False, 4.0)
        assert seen == []
        loop.run_until(lambda: False, 10.0)
        assert seen == (["waited"] if end == "pause" else [])

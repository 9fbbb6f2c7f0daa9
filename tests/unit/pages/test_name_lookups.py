"""Names whose servers are mute hold up no other name, no shutdown, and never more than their part of the lookups."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from pages import name_lookups
from pages.name_lookups import LOOKUPS_MAX_COUNT, REST_FACTOR, SLOW_AFTER_MS, NameLookups, look_up

OF_ONE_ORGANISATION_COUNT = 24


class Servers:
    """A system's lookups: names that begin with `mute` are unanswered until they are given up, `gone` ones are none."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.now_s = 100.0
        self.takes_s = 0.0
        self.given_up = threading.Event()
        self.mute: set[str] = set()

    def look(self, host: str) -> list[str]:
        self.asked.append(host)
        if host.startswith("mute") or host in self.mute:
            assert self.given_up.wait(60)
            raise socket.gaierror(socket.EAI_AGAIN, "no server answered")
        self.now_s += self.takes_s
        if host.startswith("gone"):
            raise socket.gaierror(socket.EAI_NONAME, "no such name")
        return ["10.0.0.1", "fd00::1"]


@pytest.fixture
def servers() -> Iterator[Servers]:
    made = Servers()
    yield made
    made.given_up.set()


@pytest.fixture
def lookups(servers: Servers) -> NameLookups:
    return NameLookups(servers.look, lambda: servers.now_s)


async def begin(lookups: NameLookups, host: str, owner: str | None = None) -> asyncio.Task[list[str]]:
    task = asyncio.create_task(lookups.find(host, owner))
    await asyncio.sleep(0)
    return task


async def fails(finding: asyncio.Task[list[str]]) -> None:
    with pytest.raises(OSError, match="no address"):
        await finding


async def test_an_address_is_not_looked_up(lookups: NameLookups, servers: Servers) -> None:
    assert [await lookups.find(each) for each in ("10.0.0.7", "fd00:0::7")] == [["10.0.0.7"], ["fd00::7"]]
    assert servers.asked == []


async def test_an_honest_name_is_found_beside_all_that_an_organisation_may_leave_mute(
    lookups: NameLookups, servers: Servers
) -> None:
    mute = [await begin(lookups, f"mute{count}.example") for count in range(OF_ONE_ORGANISATION_COUNT)]
    assert await lookups.find("honest.example") == ["10.0.0.1", "fd00::1"]
    assert [task.done() for task in mute] == [False] * OF_ONE_ORGANISATION_COUNT
    servers.given_up.set()
    for task in mute:
        await fails(task)
    assert lookups.under_way_count == 0


async def test_who_gives_up_and_asks_again_begins_no_second_lookup(lookups: NameLookups, servers: Servers) -> None:
    for _ in range(5):
        task = await begin(lookups, "mute.example")
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    both = [await begin(lookups, "mute.example"), await begin(lookups, "mute.example")]
    servers.given_up.set()
    for task in both:
        await fails(task)
    assert servers.asked == ["mute.example"]


async def test_a_node_that_moves_has_one_lookup_under_way_too(lookups: NameLookups, servers: Servers) -> None:
    tasks = [await begin(lookups, f"mute{count}.example", "node") for count in range(5)]
    for task in tasks:
        task.cancel()
    honest = await begin(lookups, "honest.example", "node")
    assert (servers.asked, lookups.under_way_count) == (["mute0.example"], 1)
    servers.given_up.set()
    assert await honest == ["10.0.0.1", "fd00::1"]
    assert servers.asked == ["mute0.example", "honest.example"]


async def test_a_name_that_was_slow_to_fail_rests(lookups: NameLookups, servers: Servers) -> None:
    task = await begin(lookups, "mute.example")
    servers.now_s += 10
    servers.given_up.set()
    await fails(task)
    servers.now_s += 10 * REST_FACTOR - 0.1
    await fails(await begin(lookups, "mute.example"))
    assert len(servers.asked) == 1
    servers.now_s += 0.2
    await fails(await begin(lookups, "mute.example"))
    assert len(servers.asked) == 2


async def test_a_name_that_is_quick_to_fail_is_asked_for_again_at_once(lookups: NameLookups, servers: Servers) -> None:
    servers.takes_s = 0.001
    for _ in range(3):
        await fails(await begin(lookups, "gone.example"))
        servers.now_s += 0.05
    assert len(servers.asked) == 3


async def test_the_former_address_is_used_while_servers_are_mute_and_after(
    lookups: NameLookups, servers: Servers, monkeypatch: pytest.MonkeyPatch
) -> None:
    await lookups.find("honest.example")
    monkeypatch.setattr(name_lookups, "SLOW_AFTER_MS", 0)
    servers.mute.add("honest.example")
    for _ in range(3):
        assert await lookups.find("honest.example") == ["10.0.0.1", "fd00::1"]
    assert len(servers.asked) == 2
    servers.given_up.set()
    assert await lookups.find("honest.example") == ["10.0.0.1", "fd00::1"]


async def test_slow_names_have_half_of_the_lookups_and_none_has_more_than_all(
    servers: Servers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(name_lookups, "LOOKUPS_MAX_COUNT", 4)
    lookups = NameLookups(servers.look, lambda: servers.now_s)
    tasks = [await begin(lookups, f"mute{count}") for count in range(5)]
    assert lookups.under_way_count == 4
    await fails(tasks.pop())
    servers.now_s += SLOW_AFTER_MS / 1000
    servers.given_up.set()
    for task in tasks:
        await fails(task)
    servers.now_s += 10
    servers.given_up.clear()
    again = [await begin(lookups, f"mute{count}") for count in range(4)]
    assert lookups.under_way_count == 2
    assert len(await lookups.find("honest.example")) == 2
    servers.given_up.set()
    await asyncio.gather(*again, return_exceptions=True)


async def test_where_the_system_grants_no_thread_nothing_is_found(
    lookups: NameLookups, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as changes:
        changes.setattr(threading.Thread, "start", refuse)
        await fails(await begin(lookups, "honest.example"))
    assert len(await lookups.find("honest.example")) == 2


async def test_only_so_many_owners_are_remembered(
    lookups: NameLookups, servers: Servers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(name_lookups, "OWNERS_MAX_COUNT", 2)
    for count in range(4):
        await lookups.find(f"{count}.example")
    assert len(lookups._names) == 2


async def test_aiohttp_gets_addresses_of_both_families(lookups: NameLookups) -> None:
    found = await lookups.resolve("honest.example", 443, socket.AF_UNSPEC)
    assert [(each["host"], each["port"], each["family"]) for each in found] == [
        ("10.0.0.1", 443, socket.AF_INET),
        ("fd00::1", 443, socket.AF_INET6),
    ]
    assert [each["host"] for each in await lookups.resolve("honest.example", 443)] == ["10.0.0.1"]


async def test_the_systems_own_names_are_found_and_what_is_no_name_is_not() -> None:
    assert set(look_up("localhost")) <= {"127.0.0.1", "::1"}
    assert set(await NameLookups().find("localhost")) <= {"127.0.0.1", "::1"}
    await fails(await begin(NameLookups(), "a..b"))


def test_an_answer_after_the_loop_was_closed_troubles_nobody(servers: Servers, monkeypatch: pytest.MonkeyPatch) -> None:
    troubles: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", troubles.append)

    async def leave() -> threading.Thread:
        task = await begin(NameLookups(servers.look), "mute.example")
        task.cancel()
        return next(each for each in threading.enumerate() if each.name == "lookup mute.example")

    thread = asyncio.run(leave())
    servers.given_up.set()
    thread.join(60)
    assert (thread.is_alive(), troubles) == (False, [])


PROGRAM = """
import asyncio, threading
from pages.name_lookups import NameLookups
never = threading.Event()
async def main():
    lookups = NameLookups(lambda host: ["10.0.0.1"] if host == "honest" else never.wait())
    mute = [asyncio.ensure_future(lookups.find(f"mute{count}")) for count in range(24)]
    await asyncio.sleep(0)
    print(await lookups.find("honest"), lookups.under_way_count)
asyncio.run(main())
"""


def test_a_program_ends_while_lookups_are_under_way() -> None:
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=True)
    assert (ended.stdout, ended.stderr) == ("['10.0.0.1'] 24\n", "")
    assert LOOKUPS_MAX_COUNT > 64, "the nodes of a network, each with a lookup under way"

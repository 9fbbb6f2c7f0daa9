"""Who leads and who voted, as the console shows it, is what the nodes themselves say of their rounds."""

from __future__ import annotations

import asyncio
from typing import Any

from playwright.async_api import Page, expect

from network.faults.actions import Kill
from network.faults.control import FaultControl
from tests.ui.console_page import LONG_MS, Cells, read_leader, read_rounds
from tests.ui.console_under_test import ConsoleUnderTest

LEADERS_SEEN_COUNT = 3
ROUNDS_COMPARED_COUNT = 8
LOOK_S = 0.3
NEWS_COUNT = 2
"""The look whose news come first may have begun before what it is compared with; the next one begins when it has ended."""
WORDS = {"voted": "voted", "gave up": "gave-up"}
"""What a cell says, and what a node calls it."""
Said = dict[str, dict[tuple[int, int], dict[str, Any]]]
"""By the node's name and (epoch, round): `leader` and `messages`, by the node itself."""


async def ask_nodes(console: ConsoleUnderTest) -> Said:
    """Return what every node says of the last rounds in which it said anything."""
    return {
        report.name: {(said["epoch"], said["round"]): said for said in report.status["rounds"]}
        for report in await console.network.cluster.status()
        if report.status is not None
    }


async def ask_leader(console: ConsoleUnderTest, place: tuple[int, int]) -> str:
    """Return who led a round, by the words of whoever said something in it."""
    async with asyncio.timeout(LONG_MS / 1000):
        while True:
            leaders = {said[place]["leader"] for said in (await ask_nodes(console)).values() if place in said}
            if leaders:
                assert len(leaders) == 1, "all name the same"
                return str(leaders.pop())
            await asyncio.sleep(LOOK_S)


def differences(cells: Cells, place: tuple[int, int], before: Said, after: Said) -> list[str]:
    """Compare a round's cells with the nodes' words, asked before and after: a cell holds all of those, none but these."""
    wrong = []
    for name, said in after.items():
        words, marks = cells[name]["words"].split(", "), cells[name]["marks"]
        if ("led" in words) != (said[place]["leader"] == name) or ("led" in marks) != ("led" in words):
            wrong.append(f"{place}: {name} led: {words}, {marks}")
        shown = {own for word, own in WORDS.items() if word in words}
        if not set(before[name][place]["messages"]) & {*WORDS.values()} <= shown <= set(said[place]["messages"]):
            wrong.append(f"{place}: {name} said {said[place]['messages']}: {words}")
        if marks[0] != ("gave-up" if "gave-up" in shown else "voted" if shown else "silent"):
            wrong.append(f"{place}: {name} is marked {marks}: {words}")
    return wrong


async def looked_again(console: ConsoleUnderTest, page: Page) -> dict[tuple[int, int], Cells]:
    """Return the rounds that are shown once the console has looked at the nodes anew, from the first node to the last."""
    shown, news_count = await read_rounds(page), 0
    while news_count < NEWS_COUNT:
        await asyncio.sleep(LOOK_S)
        missed = await missed_by_a_look(console, page)
        later = await read_rounds(page)
        missed |= await missed_by_a_look(console, page)
        if not missed:  # what such a look did not hear is shown by the next one
            news_count += max(later) > max(shown)
            shown = later
    return shown


async def missed_by_a_look(console: ConsoleUnderTest, page: Page) -> set[str]:
    """Return the nodes that run and did not answer the console in time, as the table of nodes says."""
    return {name for name in (await read_leader(page))["unsaid"] if console.network.cluster.is_running(name)}


async def compare_rounds(console: ConsoleUnderTest, page: Page) -> dict[tuple[int, int], Cells]:
    """Expect the table of rounds to hold the nodes' own words; return the rounds that could be compared."""
    compared: dict[tuple[int, int], Cells] = {}
    cluster = console.network.cluster
    async with asyncio.timeout(LONG_MS / 1000):
        while len(compared) < ROUNDS_COMPARED_COUNT:
            before = await ask_nodes(console)
            shown = await looked_again(console, page)
            after = await ask_nodes(console)
            if not (before.keys() == after.keys() == {name for name in cluster.names if cluster.is_running(name)}):
                continue  # who did not answer in time cannot be compared
            known = set.intersection(*(set(said) for answer in (before, after) for said in answer.values()))
            for place in known & set(shown):
                assert differences(shown[place], place, before, after) == []
                compared[place] = shown[place]
    return compared


async def test_the_crown_the_words_the_table_and_the_figure_name_the_leader_that_the_nodes_name(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page, crowned = open_page, set()
    async with asyncio.timeout(LONG_MS / 1000):
        while len(crowned) < LEADERS_SEEN_COUNT:
            seen = await read_leader(page)
            if seen["figure"] in ("-", *seen["unsaid"]):
                await asyncio.sleep(LOOK_S)
                continue
            leader = await ask_leader(console, (seen["epoch"], seen["round"]))
            assert (seen["crowned"], seen["said"], seen["listed"]) == ([leader], [leader], [leader])
            assert seen["figure"] == leader
            crowned.add(leader)
            await asyncio.sleep(LOOK_S)


async def test_who_led_and_who_voted_in_the_last_rounds_is_what_each_node_says_of_itself(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    compared = await compare_rounds(console, open_page)
    assert any("voted" in cells[name]["words"] for cells in compared.values() for name in console.network.names)


async def test_rounds_of_a_dead_leader_are_shown_given_up_by_whom_the_nodes_say_so(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await FaultControl(console.network.cluster).carry_out(Kill("node-2"))
    # What it said in its last rounds nobody may have asked it in time.
    died = max(place for said in (await ask_nodes(console)).values() for place in said)
    await expect(page.locator("table.rounds td.lost").first).to_be_visible(timeout=LONG_MS)
    led: list[Cells] = []
    while not led:
        compared = await compare_rounds(console, page)
        led = [cells for place, cells in compared.items() if place > died and "led" in cells["node-2"]["words"]]
    for cells in led:
        assert cells["node-2"]["words"] == "led, said nothing"
        assert [cells[name]["marks"] for name in ("node-1", "node-3", "node-4")] == [["gave-up"]] * 3
        assert cells["came of it"]["words"] == "lost"

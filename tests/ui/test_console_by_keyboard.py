"""Who uses the console by keyboard alone stays where he was; and the page says no more than it knows of a quiet network."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from playwright.async_api import Locator, Page, expect

from tests.ui.console_page import LONG_MS, expect_done, expect_state, read_leader
from tests.ui.console_under_test import ConsoleUnderTest

TABS_BETWEEN_BUTTONS_COUNT = 1
LOOK_MS = 300
NAMES = ("node-1", "node-2", "node-3", "node-4")
NETWORK = {"quorum": 3, "nodes": [{"name": name, "producer": True} for name in NAMES]}
_ASK_WORDS = """async ([name, ...handed]) => (await import('./words.js'))[name](...handed)"""
SPLIT = (
    "Links are cut, and no group has a quorum, 3 of 4 producers: nothing can become final until they are healed."
    " Nothing that was final is lost."
)

ONE_APART = "3 of 4 producers reach each other; a quorum is 3. node-4 stands apart."


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def console(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ConsoleUnderTest]:
    """A network to which nobody gives work."""
    made = ConsoleUnderTest(tmp_path_factory.mktemp("console"))
    try:
        await made.network.start()
        yield made
    finally:
        await made.close()


def button(page: Page, name: str) -> Locator:
    """The button of this name beside the drawing."""
    return page.locator(".break").get_by_role("button", name=name, exact=True)


async def confirm(page: Page, dialog: str, name: str) -> None:
    """Confirm a dialogue by keyboard."""
    await page.get_by_role("dialog", name=dialog).get_by_role("button", name=name, exact=True).focus()
    await page.keyboard.press("Enter")


async def press_by_keyboard(page: Page, name: str) -> None:
    await button(page, name).focus()
    await page.keyboard.press("Enter")


async def test_the_focus_stays_on_the_button_that_did_something_also_where_it_can_not_be_pressed_any_more(
    open_page: Page,
) -> None:
    page, kill, restart = open_page, button(open_page, "Kill"), button(open_page, "Restart")
    await page.get_by_label("Node", exact=True).select_option("node-3")
    await press_by_keyboard(page, "Kill")
    await confirm(page, "Kill node-3?", "Kill it")
    await expect_done(page, "kill node-3")
    await expect_state(page, "node-3", "stopped")
    await expect(kill).to_have_attribute("aria-disabled", "true")
    await expect(kill).to_be_focused()
    for _ in range(TABS_BETWEEN_BUTTONS_COUNT):
        await page.keyboard.press("Tab")
    await expect(restart).to_be_focused()
    await page.keyboard.press("Enter")
    await expect_done(page, "restart node-3")
    await expect_state(page, "node-3", "signing")
    await expect(restart).to_have_attribute("aria-disabled", "true")
    await expect(restart).to_be_focused()


async def test_the_focus_stays_on_the_button_that_exported_and_on_the_one_that_came_back_to_now(
    open_page: Page,
) -> None:
    page = open_page
    export = page.get_by_role("button", name="Export the run")
    await export.focus()
    async with page.expect_download():
        await page.keyboard.press("Enter")
    await expect(page.locator("main > .said")).to_contain_text("Exported: ")
    await expect(export).to_be_focused()
    await page.get_by_role("button", name="Event before").click()
    now = page.get_by_role("button", name="Back to now")
    await expect(now).to_be_enabled()
    await now.focus()
    await page.keyboard.press("Enter")
    await expect(now).to_be_disabled()
    await expect(now).to_be_focused()


async def test_two_halves_of_a_quiet_network_are_told_to_have_no_quorum_until_they_are_healed(open_page: Page) -> None:
    page = open_page
    await page.get_by_role("tab", name="Partition").click()
    for name in ("node-3", "node-4"):
        await page.get_by_role("group", name=name, exact=True).get_by_label("B").check()
    await press_by_keyboard(page, "Cut it")
    await expect_done(page, "partition node-1, node-2 | node-3, node-4")
    await expect(page.locator(".seal")).to_have_text(re.compile("^No quorum" + re.escape(SPLIT)), timeout=LONG_MS)
    await expect(page.locator(".seal")).to_have_class(re.compile("bad"))
    await expect(button(page, "Cut it")).to_be_focused()
    await press_by_keyboard(page, "Heal every fault")
    await expect_done(page, "heal everything")
    await expect(page.get_by_text("All is well")).to_be_visible(timeout=LONG_MS)
    await expect(button(page, "Heal every fault")).to_be_focused()


async def test_where_one_node_is_cut_off_those_are_counted_that_reach_each_other_and_it_is_named(
    open_page: Page,
) -> None:
    page = open_page
    await page.get_by_role("tab", name="Partition").click()
    await page.get_by_role("group", name="node-4", exact=True).get_by_label("B").check()
    await press_by_keyboard(page, "Cut it")
    await expect_done(page, "partition node-1, node-2, node-3 | node-4")
    await expect(page.locator(".seal")).to_have_text(f"Links are cut{ONE_APART}", timeout=LONG_MS)
    await press_by_keyboard(page, "Heal every fault")
    await expect_done(page, "heal everything")
    await expect(page.locator(".seal")).to_contain_text("4 of 4 producers take part; a quorum is 3.", timeout=LONG_MS)


async def test_a_leader_that_was_killed_is_not_said_to_lead(console: ConsoleUnderTest, open_page: Page) -> None:
    page = open_page
    async with asyncio.timeout(LONG_MS / 1000):
        while (leader := (await read_leader(page))["figure"]) not in NAMES:
            await page.wait_for_timeout(LOOK_MS)  # nobody is said to lead by a look that missed the leader
    await page.get_by_label("Node", exact=True).select_option(leader)
    await press_by_keyboard(page, "Kill")
    await confirm(page, f"Kill {leader}?", "Kill it")
    await expect_state(page, leader, "stopped")
    seen = await read_leader(page)
    assert leader not in [*seen["crowned"], *seen["said"], *seen["listed"], seen["figure"]]
    await press_by_keyboard(page, "Restart")
    await expect_state(page, leader, "signing")


def moment_of(groups: tuple[tuple[str, ...], ...], **states: str) -> dict[str, Any]:
    """A moment of a quiet network whose groups hear nothing of each other; states by node (node_2="paused")."""
    group = {name: number for number, names in enumerate(groups) for name in names}
    cut = [(a, b) for a in group for b in group if group[a] != group[b]]
    nodes = [
        {
            "name": name,
            "state": states.get(name.replace("-", "_"), "signing"),
            "leader": "node-2",
            "round": 7,
            "epoch": 0,
        }
        for name in NAMES
    ]
    links = [{"from": source, "to": target, "state": "cut"} for source, target in cut]
    return {"at_ms": 9_000, "final_since_ms": 8_000, "stuck_since_ms": None, "nodes": nodes, "links": links}


async def test_no_quorum_is_told_of_groups_only_where_none_can_have_one(open_page: Page) -> None:
    async def title(moment: dict[str, Any]) -> str:
        said: dict[str, str] = await open_page.evaluate(_ASK_WORDS, ["verdict", moment, NETWORK])
        return said["title"]

    halves = moment_of((NAMES[:2], NAMES[2:]))
    assert await title(halves) == "No quorum"
    one_way = [link for link in halves["links"] if link["from"] in NAMES[:2]]
    assert await title(halves | {"links": one_way}) == "Links are cut", "one direction may be enough"
    assert await title(moment_of((NAMES[:3], NAMES[3:]))) == "Links are cut"
    assert await title(moment_of((NAMES[:3], NAMES[3:]), node_4="stopped")) == "It goes on"
    assert await title(moment_of((NAMES[:2], NAMES[2:]), node_4="paused")) == "No quorum"
    stuck = await open_page.evaluate(_ASK_WORDS, ["verdict", halves | {"stuck_since_ms": 4_000}, NETWORK])
    assert stuck["title"] == "Nothing becomes final"
    assert "no group has a quorum" in stuck["text"]


async def test_who_takes_part_is_counted_among_those_that_reach_each_other(open_page: Page) -> None:
    async def text(moment: dict[str, Any]) -> str:
        said: dict[str, str] = await open_page.evaluate(_ASK_WORDS, ["verdict", moment, NETWORK])
        return said["text"]

    apart = moment_of((NAMES[:3], NAMES[3:]))
    everybody = "4 of 4 producers take part; a quorum is 3."
    assert await text(apart) == ONE_APART
    assert await text(apart | {"links": [link for link in apart["links"] if link["from"] == "node-4"]}) == ONE_APART
    pair = [link for link in apart["links"] if {link["from"], link["to"]} == {"node-1", "node-4"}]
    assert await text(apart | {"links": pair}) == everybody, "each has the blocks of the other by way of the rest"
    assert (
        await text(moment_of((NAMES[:3], NAMES[3:]), node_4="paused")) == "3 of 4 producers take part; a quorum is 3."
    )
    assert await text(moment_of((NAMES,))) == everybody
    halves = moment_of((NAMES[:2], NAMES[2:]))
    one_way = [link for link in halves["links"] if link["from"] in NAMES[:2]]
    assert await text(halves | {"links": one_way}) == (
        "2 of 4 producers reach each other both ways; a quorum is 3. Perhaps nothing more becomes final."
    )


async def test_nobody_leads_while_the_leader_of_the_round_is_stopped(open_page: Page) -> None:
    for state, leader in (("signing", "node-2"), ("no answer", "node-2"), ("stopped", None)):
        said = await open_page.evaluate(_ASK_WORDS, ["leaderOf", moment_of((NAMES,), node_2=state)])
        assert (said["leader"], said["round"]) == (leader, 7)

"""What the explorer says where one could take it for something else: whose count it is, in which unit, what is wrong."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from playwright.async_api import Page, Route, expect

from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.ui.accessible import find_accessibility_faults
from tests.ui.explorer_page import enter
from tests.ui.watched_page import NARROW, ZOOMED


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def network(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[NetworkUnderTest]:
    """Four nodes."""
    async with running(NetworkUnderTest(tmp_path_factory.mktemp("explorer") / "network", nodes=4)) as made:
        yield made


async def test_settings_are_told_in_plain_words_with_their_units(page: Page, network: NetworkUnderTest) -> None:
    await enter(page, network, "governance")
    for words, value, name in (
        ("an empty block after", "30 s", "heartbeat_ms = 30000"),
        ("patience with a leader, at first", "500 ms", "base_timeout_ms = 500"),
        ("patience with a leader, at most", "8 s", "timeout_cap_ms = 8000"),
        ("seats, at most", "21", "max_producers = 21"),
    ):
        told = page.locator("dt", has_text=words).locator("+ dd")
        await expect(told).to_contain_text(re.compile(f"^{value}"))
        await expect(told).to_contain_text(name)
    await page.set_viewport_size({"width": ZOOMED[0], "height": ZOOMED[1]})
    assert await page.evaluate("document.documentElement.scrollWidth") <= ZOOMED[0]
    assert await find_accessibility_faults(page, by_keyboard=False) == []


async def test_a_chart_is_drawn_anew_for_a_window_of_another_width(page: Page, network: NetworkUnderTest) -> None:
    await enter(page, network, "producers")
    await expect(page.locator(".chart text", has_text="votes")).to_be_visible()
    await page.set_viewport_size({"width": NARROW[0], "height": NARROW[1]})
    await page.wait_for_function("() => document.querySelector('svg.chart').viewBox.baseVal.width < innerWidth")


async def test_times_say_in_which_zone_they_are(page: Page, network: NetworkUnderTest) -> None:
    await enter(page, network)
    await expect(page.locator("#word")).to_contain_text("times are in your own time zone, Europe/Berlin.")


async def test_an_address_that_is_no_transactions_is_told_so_in_plain_words(
    page: Page, network: NetworkUnderTest
) -> None:
    await enter(page, network, "tx/00")
    await expect(page.locator("main")).to_contain_text("This is no transaction's id: it has 64 hexadecimal digits")


async def test_what_this_node_gave_up_and_what_the_network_lost_are_told_apart(
    page: Page, network: NetworkUnderTest
) -> None:
    async def tell_of_three(route: Route) -> None:
        answer = await route.fetch()
        said = await answer.json()
        for header in said.get("headers", ()):
            header["missed_count"] = 0
        if "rounds" in said:
            said["rounds"]["timed_out_count"] = 3
        await route.fulfill(response=answer, json=said)

    await page.route(re.compile(r"/v1/explorer/(status|headers)\?"), tell_of_three)
    await enter(page, network)
    figure = page.locator(".card", has_text="Given up by this node")
    await expect(figure).to_contain_text("3 rounds")
    await expect(figure).to_contain_text("lost is a round only if a quorum gave it up")
    lost = page.locator(".card", has=page.get_by_role("heading", name="Rounds that the network lost"))
    await expect(lost).to_contain_text("By blocks 0 to")
    await expect(lost).to_contain_text("no round was lost")
    await expect(lost).to_contain_text("This node itself gave up 3 rounds since its start. Not each of them is lost")
    await page.unroute_all(behavior="ignoreErrors")

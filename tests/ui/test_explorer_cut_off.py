"""The explorer while its node is away, and when it is back: it says so, and goes on by itself as far as it can."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from itertools import pairwise

import aiohttp
import pytest
import pytest_asyncio
from playwright.async_api import Page, expect

from node.config import CONFIG_FILE
from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.ui.accessible import find_accessibility_faults
from tests.ui.explorer_page import enter, go
from tests.ui.watched_page import SERVER_ENDED, Watch

PRIVATE_NODE, PUBLIC_NODE = "node-1", "node-2"
TRIES_COUNT = 5
"""So often that a pause which doubles each time would have grown to eight seconds."""
PAUSE_MAX_MS = 1_500
TRY_MAX_S = 4.0
"""What a busy machine may take, beside the pause, to begin a try and to notice that nobody answers it."""
ANSWER_TIMEOUT_S = 60.0


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def network(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[NetworkUnderTest]:
    """Four nodes; the explorer of one is public."""
    made = NetworkUnderTest(tmp_path_factory.mktemp("explorer") / "network", nodes=4)
    path = made.cluster.config(PUBLIC_NODE).data_dir / CONFIG_FILE
    path.write_text(path.read_text() + "\n[explorer]\npublic = true\n")
    async with running(made):
        yield made


async def kill(network: NetworkUnderTest, name: str) -> None:
    await asyncio.to_thread(network.cluster.kill, name)


async def bring_back(network: NetworkUnderTest, name: str) -> None:
    """Start a node, and return at the moment when it answers."""
    network.cluster.start(name)
    deadline = time.monotonic() + ANSWER_TIMEOUT_S
    while time.monotonic() < deadline:
        try:
            async with network.http.get(network.url(name) + "/v1/status") as answer:
                await answer.read()
                return
        except (aiohttp.ClientError, TimeoutError):
            await asyncio.sleep(0.02)
    raise AssertionError(f"{name} did not answer")


_NOTE_PAUSES = """() => {
  const begin = window.setTimeout;
  window.pausesMs = [];
  window.setTimeout = (then, ms, ...rest) => { window.pausesMs.push(ms); return begin(then, ms, ...rest); };
}"""


async def pauses_between_tries(page: Page) -> tuple[list[int], float]:
    """Watch the page ask how its node is, again and again.

    Return the pauses that it made, ms, however late a busy machine ends them; and the longest time between two tries, s.
    """
    await page.evaluate(_NOTE_PAUSES)
    asked_s: list[float] = []
    while len(asked_s) < TRIES_COUNT:
        await page.wait_for_event("request", lambda request: "/v1/explorer/status?" in request.url)
        asked_s.append(time.monotonic())
    return await page.evaluate("pausesMs"), max(later - earlier for earlier, later in pairwise(asked_s))


async def test_a_view_that_could_not_be_shown_shows_itself_soon_after_its_node_is_back(
    page: Page, watch: Watch, network: NetworkUnderTest
) -> None:
    watch.expect(SERVER_ENDED)
    await page.goto(network.url(PUBLIC_NODE) + "/explorer/")
    await expect(page.locator("#state")).to_have_text("public explorer")
    await kill(network, PUBLIC_NODE)
    try:
        await go(page, "producers")
        await expect(page.locator("h1")).to_have_text("The node does not answer")
        await expect(page.locator("main")).to_contain_text("node-2: it is stopped, or cannot be reached")
        await expect(page.locator("main")).to_contain_text("asks again every 1.5 seconds")
        await expect(page.locator("#state")).to_have_text("not connected, asking every 1.5 s")
        assert await find_accessibility_faults(page) == []
        pauses_ms, longest_s = await pauses_between_tries(page)
        assert len(pauses_ms) >= TRIES_COUNT - 1
        assert max(pauses_ms) <= PAUSE_MAX_MS
        assert longest_s <= PAUSE_MAX_MS / 1000 + TRY_MAX_S
    finally:
        await bring_back(network, PUBLIC_NODE)
    await expect(page.locator("h1")).to_have_text("Producers")
    await expect(page.locator("main")).to_contain_text("What they did")
    await expect(page.locator("#state")).to_have_text("public explorer")


async def test_a_members_page_goes_on_by_itself_in_a_new_session_when_its_node_is_back(
    page: Page, watch: Watch, network: NetworkUnderTest
) -> None:
    watch.expect(f"{SERVER_ENDED}|status of 503")
    served = await enter(page, network)
    await kill(network, PRIVATE_NODE)
    try:
        await go(page, "members")
        await expect(page.locator("h1")).to_have_text("The node does not answer")
        await expect(page.locator("main")).to_contain_text("node-1: it is stopped, or cannot be reached")
        await expect(page.locator("main")).not_to_contain_text("if that has ended")
    finally:
        await bring_back(network, PRIVATE_NODE)
    await expect(page.locator("h1")).to_have_text("Members and organisations")
    await expect(page.locator("#state")).to_have_text("your session")
    await expect(page.locator("#ended")).to_be_hidden()
    await served.stop()
    await go(page, "custody")
    await expect(page.locator("h1")).to_have_text("The node does not answer")
    await expect(page.locator("main")).to_contain_text("if that has ended in its terminal, run it again")
    assert await find_accessibility_faults(page) == []


async def test_a_session_that_ended_is_told_at_the_top_with_the_next_step(
    page: Page, watch: Watch, network: NetworkUnderTest
) -> None:
    watch.expect("status of 401")
    served = await enter(page, network)
    served.end_sessions()
    await go(page, "members")
    ended = page.locator("#ended")
    await expect(ended).to_contain_text("its session has ended")
    await expect(ended).to_contain_text("blockrobot explore --node node-1")
    await expect(ended).to_be_in_viewport()
    await expect(page.locator("h1")).to_have_text("This page needs a session")
    assert await find_accessibility_faults(page) == []
    await go(page, "custody")
    await expect(page.locator("h1")).to_have_text("This page needs a session")
    await expect(page.locator("main")).not_to_contain_text("asks again")

"""The console of a network that grows and shrinks while it is recorded: each moment is shown with the nodes of its time."""

from __future__ import annotations

import asyncio
import re
import shutil
from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from tests.cluster.commands import agree, must
from tests.cluster.network_under_test import find_base_port, running
from tests.ui.accessible import find_accessibility_faults
from tests.ui.console_page import row_of
from tests.ui.console_under_test import ConsoleUnderTest
from tests.ui.watched_page import Pages

LONG_MS = 60_000
PLAYED_MS = 90_000
"""A run of a minute or two, four times as fast, on a busy machine."""
FOUR, FIVE = "4 of 4 producers take part; a quorum is 3.", "5 of 5 producers take part; a quorum is 4."
NEWCOMER = "node-5"
_COLLECT_VERDICTS = """() => {
  const seal = document.querySelector('.seal');
  window.verdicts = [];
  new MutationObserver(() => window.verdicts.push(seal.textContent))
    .observe(seal, {subtree: true, childList: true, characterData: true});
}"""


async def _expect_nodes(page: Page, count: int, verdict: str) -> None:
    """The drawing, the table, the strip of rounds and the verdict speak of so many nodes."""
    await expect(page.locator(".topology .node")).to_have_count(count, timeout=LONG_MS)
    await expect(page.locator("table.nodes tbody tr")).to_have_count(count)
    await expect(page.locator(".seal")).to_contain_text(verdict, timeout=LONG_MS)
    await expect(page.locator("table.rounds tbody tr")).to_have_count(count + 1)
    await expect(page.locator("table.rounds td.voted").first).to_be_visible()


async def _take_in(console: ConsoleUnderTest) -> None:
    added = await must(console.network, "node", "add", "--producer", "--base-port", str(find_base_port(1)))
    assert added["node"] == NEWCOMER
    console.network.took_in(NEWCOMER)


async def _let_go(console: ConsoleUnderTest) -> None:
    """Remove the node from the chain, and once it is out, from this machine too."""
    network = console.network
    await agree(network, "remove-node", NEWCOMER)
    await asyncio.to_thread(network.cluster.stop, NEWCOMER)
    folder = network.cluster.config(NEWCOMER).data_dir
    network.names.remove(NEWCOMER)
    del network.cluster.configs[NEWCOMER]
    await asyncio.to_thread(shutil.rmtree, folder)


async def _go_to(page: Page, text: str) -> None:
    await page.locator(".events li", has_text=text).first.get_by_role("button").click()


async def _expect_not_chosen(page: Page) -> None:
    """A node that is drawn and has left since changes nothing in what breaks the network of today."""
    chosen = page.get_by_label("Node", exact=True)
    await chosen.select_option("node-2")
    drawn = page.get_by_role("button", name=re.compile(f"^{NEWCOMER} of "))
    said = page.get_by_role("status").filter(has_text=f"{NEWCOMER} is not in the network now")
    await drawn.click()
    await expect(said).to_be_attached()
    await expect(chosen).to_have_value("node-2")
    await page.get_by_role("tab", name="Partition").click()
    await drawn.click()
    await expect(page.locator(".group-row")).to_have_count(4)
    await page.get_by_role("tab", name="A node").click()


@pytest.mark.timeout(300)
async def test_a_run_in_which_a_node_joins_and_leaves_shows_each_moment_with_the_nodes_of_its_time(
    page: Page, pages: Pages, tmp_path: Path
) -> None:
    async with running(ConsoleUnderTest(tmp_path)) as console:
        await console.open(page)
        await _expect_nodes(page, 4, FOUR)
        await page.get_by_role("slider").focus()
        await page.keyboard.press("Home")
        await _take_in(console)
        await expect(page.get_by_label("Node", exact=True).locator("option")).to_have_count(5, timeout=LONG_MS)
        await expect(page.locator(".topology .node")).to_have_count(4)
        await page.get_by_role("button", name="Back to now").click()
        await _expect_nodes(page, 5, FIVE)
        await row_of(page, NEWCOMER).get_by_role("button").focus()
        await _let_go(console)
        await _expect_nodes(page, 4, FOUR)
        await expect(row_of(page, "node-4").get_by_role("button")).to_be_focused()
        await _go_to(page, f"{NEWCOMER} is signing")
        await expect(page.locator(".topology .node")).to_have_count(5)
        await expect(page.locator("table.nodes tbody tr")).to_have_count(5)
        await _expect_not_chosen(page)
        await page.get_by_role("button", name="Back to now").click()
        await _expect_nodes(page, 4, FOUR)
        async with page.expect_download() as waiting:
            await page.get_by_role("button", name="Export the run").click()
        file = tmp_path / "run.html"
        await (await waiting.value).save_as(file)
        await page.goto("about:blank")
    replay = await pages.open()
    await replay.goto(file.as_uri())
    await _expect_nodes(replay, 4, FOUR)
    await replay.get_by_label("About").select_option(NEWCOMER)
    await _go_to(replay, f"The nodes are others now: node-1, node-2, node-3, node-4, {NEWCOMER}.")
    await replay.get_by_role("button", name="Next event").click()
    await expect(replay.locator(".topology .node")).to_have_count(5)
    await _go_to(replay, f"{NEWCOMER} is signing")
    await expect(replay.locator("table.nodes tr", has_text=NEWCOMER).locator(".badge")).to_have_text("signing")
    assert await find_accessibility_faults(replay, by_keyboard=False) == []
    await replay.get_by_role("slider").focus()
    await replay.keyboard.press("Home")
    await expect(replay.locator(".topology .node")).to_have_count(4)
    await expect(replay.locator("table.nodes tbody tr")).to_have_count(4)
    await replay.evaluate(_COLLECT_VERDICTS)
    await replay.get_by_label("Speed").select_option("4")
    await replay.get_by_role("button", name="Play").click()
    await expect(replay.get_by_role("button", name="Play")).to_be_visible(timeout=PLAYED_MS)
    await _expect_nodes(replay, 4, FOUR)
    assert any(FIVE in verdict for verdict in await replay.evaluate("() => window.verdicts"))

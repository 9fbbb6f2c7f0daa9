"""The console on a phone, or zoomed to 400 %: nothing makes the page scroll sideways, and each wide table scrolls alone."""

from __future__ import annotations

from pathlib import Path

from playwright.async_api import Page, expect

from network.faults.actions import Pause
from network.faults.control import FaultControl
from tests.ui.accessible import find_accessibility_faults
from tests.ui.console_page import LONG_MS, choose, expect_state, expect_told, row_of
from tests.ui.console_under_test import ConsoleUnderTest
from tests.ui.screenshots import shoot
from tests.ui.watched_page import ZOOMED, Pages

_OUTSIDE = """() => [...document.body.querySelectorAll('*')].filter((one) => {
  const box = one.getBoundingClientRect();
  return box.width > 0 && one.checkVisibility() && !one.closest('table, .scroll, svg, .visually-hidden, .skip-link')
    && (box.right > innerWidth + 1 || box.left < -1);
}).map((one) => `${one.localName}.${one.className}: ${one.textContent.slice(0, 60)}`)"""


async def faults_of(page: Page, name: str) -> list[str]:
    """What of the page, as it stands, cannot be read or used in a window as narrow as this."""
    await shoot(page, f"zoomed-console-{name}")
    found = await find_accessibility_faults(page, by_keyboard=False)
    outside: list[str] = await page.evaluate(_OUTSIDE)
    return [*found, *outside]


async def expect_newest_round_and_names_in_sight(page: Page) -> None:
    """What is looked for first needs no scrolling; whose row it is is seen beside the last column too."""
    region = page.get_by_role("region", name="All nodes")
    await region.evaluate("(place) => { place.scrollLeft = place.scrollWidth; }")
    scrolled = await region.evaluate("(place) => place.scrollLeft")
    assert scrolled > 0, "the table is wider than the window"
    frame, name = await region.bounding_box(), await row_of(page, "node-1").get_by_role("button").bounding_box()
    assert frame is not None
    assert name is not None
    assert frame["x"] <= name["x"] < frame["x"] + frame["width"]
    rounds = page.get_by_role("region", name="Rounds, oldest first")
    assert await rounds.evaluate("(place) => place.scrollWidth - place.clientWidth") <= 1, "the newest round is cut off"


async def break_much(console: ConsoleUnderTest, page: Page) -> None:
    """Let every column of the tables have long words. A node writes, and its disk refuses, while a quorum is at work."""
    control = FaultControl(console.network.cluster)
    for disk in ("journal", "ledger"):
        await control.carry_out(control.reader.disk("node-2", disk, is_full=True))
    await expect_state(page, "node-2", "fault")
    await control.carry_out(control.reader.skew("node-4", "+1h"))
    await control.carry_out(Pause("node-3"))


async def test_each_state_of_the_console_is_read_in_a_window_of_320_pixels(
    console: ConsoleUnderTest, open_page: Page, pages: Pages, tmp_path: Path
) -> None:
    page = open_page
    await page.set_viewport_size({"width": ZOOMED[0], "height": ZOOMED[1]})
    faults = {"well": await faults_of(page, "well")}
    await expect_newest_round_and_names_in_sight(page)
    await page.locator("summary").click()
    await break_much(console, page)
    await expect_state(page, "node-3", "paused")
    await expect_told(page, "On at node-4: clock +1h.")
    for tab in ("A node", "Partition", "A link", "A plan"):
        await page.get_by_role("tab", name=tab).click()
        if tab == "A plan":
            await page.get_by_role("button", name="Show the steps").click()
            await expect(page.locator("table.steps")).to_be_visible()
        faults[tab] = await faults_of(page, tab.replace(" ", "-"))
    await choose(page, "node-1")
    for button in ("Let it lie…", "Wrong clock…", "Fill a disk…"):
        await page.get_by_role("button", name=button, exact=True).click()
        faults[button] = await faults_of(page, button.removesuffix("…").replace(" ", "-"))
        await page.keyboard.press("Escape")
    async with page.expect_download() as waiting:
        await page.get_by_role("button", name="Export the run").click()
    file = tmp_path / "run.html"
    await (await waiting.value).save_as(file)
    await expect(page.locator("main > .said")).to_contain_text("Exported: ", timeout=LONG_MS)
    faults["exported"] = await faults_of(page, "exported")
    replay = await pages.open(ZOOMED)
    await replay.goto(file.as_uri())
    await replay.locator("summary").click()
    faults["replay"] = await faults_of(replay, "replay")
    assert {state: found for state, found in faults.items() if found} == {}

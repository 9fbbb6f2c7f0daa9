"""The cluster console as a lecturer uses it, on a real network that has work all the while."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from network.faults.actions import Heal, Pause, Resume
from network.faults.control import FaultControl
from tests.ui.accessible import find_accessibility_faults
from tests.ui.console_page import LONG_MS, expect_state, expect_told, row_of
from tests.ui.console_under_test import ConsoleUnderTest
from tests.ui.screenshots import shoot_all_ways
from tests.ui.watched_page import NARROW, WIDE, ZOOMED, Pages, Watch

PLAN = """seed = 3

[[step]]
at = "0s"
do = "pause"
node = "node-1"

[[step]]
at = "1s"
do = "heal"
"""


async def _final_height(page: Page) -> int:
    text = await page.locator(".figures div", has_text="final height").locator("dd").inner_text()
    return int(text.replace(",", ""))


async def _expect_growth(page: Page, by: int = 5) -> None:
    aim = await _final_height(page) + by
    await page.wait_for_function(
        "aim => Number(document.querySelector('.figures dd').textContent.replaceAll(',', '')) >= aim",
        arg=aim,
        timeout=LONG_MS,
    )


@pytest.mark.smoke
async def test_a_node_is_killed_with_the_button_and_the_chain_goes_on(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page, cluster = open_page, console.network.cluster
    await page.get_by_label("Node", exact=True).select_option("node-2")
    await page.get_by_role("button", name="Kill", exact=True).click()
    dialog = page.get_by_role("dialog", name="Kill node-2?")
    await dialog.get_by_role("button", name="Leave it").click()
    assert cluster.is_running("node-2")
    await page.get_by_role("button", name="Kill", exact=True).click()
    await dialog.get_by_role("button", name="Kill it").click()
    await expect(page.get_by_text("Done: kill node-2.").first).to_be_visible()
    assert not cluster.is_running("node-2")
    await expect_state(page, "node-2", "stopped")
    await expect(page.get_by_text("It goes on")).to_be_visible()
    await _expect_growth(page)
    await expect_told(page, "node-2 is stopped")
    await expect_told(page, "(leader node-2) was given up by node-1, node-3, node-4.")
    await expect(page.locator("table.rounds td.lost").first).to_be_visible()
    for name in ("Kill", "Pause", "Resume", "Wrong clock…", "Fill a disk…"):
        await expect(page.get_by_role("button", name=name, exact=True)).to_be_disabled()
    kill, restart = (page.get_by_role("button", name=name, exact=True) for name in ("Kill", "Restart"))
    await expect(kill).to_have_accessible_description("node-2 is stopped already.")
    await expect(page.locator(".why")).to_contain_text("Kill: node-2 is stopped already.")
    await kill.focus()
    await page.keyboard.press("Enter")
    await expect(page.get_by_role("dialog")).to_have_count(0)
    await expect(page.get_by_role("status").filter(has_text="node-2 is stopped already.")).to_be_attached()
    assert await find_accessibility_faults(page) == []
    await page.get_by_label("Node", exact=True).select_option("node-1")
    await expect(kill).to_be_enabled()
    await expect(restart).to_have_accessible_description(re.compile("^node-1 runs"))
    await page.get_by_label("Node", exact=True).select_option("node-2")
    await page.get_by_role("button", name="Restart", exact=True).click()
    await expect_state(page, "node-2", "signing")
    await expect_told(page, "Done: restart node-2.")
    await expect(page.get_by_text("All is well")).to_be_visible(timeout=LONG_MS)


async def test_what_a_paused_node_would_not_hear_is_not_offered_and_refused_elsewhere_in_words(
    open_page: Page, watch: Watch
) -> None:
    page = open_page
    await page.get_by_label("Node", exact=True).select_option("node-3")
    await expect(page.get_by_role("button", name="Resume", exact=True)).to_be_disabled()
    await page.get_by_role("button", name="Pause", exact=True).click()
    await expect(page.get_by_role("button", name="Pause", exact=True)).to_be_disabled()
    for name in ("Wrong clock…", "Right clock", "Fill a disk…", "Free a disk…", "Let it lie…"):
        await expect(page.get_by_role("button", name=name, exact=True)).to_be_disabled()
    for name in ("Kill", "Restart", "Resume", "Heal it"):
        await expect(page.get_by_role("button", name=name, exact=True)).to_be_enabled()
    watch.expect("status of 409")
    await page.get_by_role("tab", name="A link").click()
    await page.get_by_label("To", exact=True).select_option("node-3")
    await page.get_by_role("button", name="Make it sound").click()
    await expect(page.locator(".break .notice.bad")).to_contain_text("node-3 is paused.")
    await expect(page.locator(".break .notice.bad")).to_contain_text("FAULT_TARGET_ABSENT. See `blockrobot fault list`")


async def test_a_fault_is_told_in_a_word_and_its_reason_below_without_the_place_on_this_machine(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await page.get_by_label("Node", exact=True).select_option("node-3")
    await page.get_by_role("button", name="Fill a disk…").click()
    await page.get_by_role("dialog").get_by_role("button", name="Fill it").click()
    await expect_state(page, "node-3", "fault")
    reason = row_of(page, "node-3").locator(".reason")
    await expect(reason).to_contain_text("(the network's folder)/nodes/node-3/journal")
    await expect(page.locator("main")).to_contain_text("Times are in your own time zone, Europe/Berlin.")
    await page.get_by_role("button", name="Free a disk…").click()
    await page.get_by_role("dialog").get_by_role("button", name="Free it").click()
    await expect_state(page, "node-3", "signing")
    await expect(reason).to_have_count(0)


@pytest.mark.smoke
async def test_the_network_is_cut_in_two_by_clicks_and_healed(open_page: Page) -> None:
    page = open_page
    await page.get_by_role("tab", name="Partition").click()
    for name in ("node-3", "node-4"):
        await page.get_by_role("button", name=re.compile(f"^{name} of ")).click()
    group = page.get_by_role("group", name="node-4", exact=True)
    await expect(group.get_by_role("radio", name="B")).to_be_checked()
    await expect(page.get_by_role("button", name="Heal", exact=True)).to_have_count(0)
    await expect(page.get_by_role("button", name="Heal every fault")).to_be_visible()
    await page.get_by_role("button", name="Cut it").click()
    await expect_told(page, "Done: partition node-1, node-2 | node-3, node-4.")
    await expect(page.locator(".link.cut").first).to_be_visible(timeout=LONG_MS)
    await expect(page.get_by_text("Nothing becomes final", exact=True)).to_be_visible(timeout=LONG_MS)
    await expect_told(page, "Nothing became final for")
    await page.evaluate("() => scrollTo(0, 0)")
    await shoot_all_ways(page, "console")
    await page.get_by_role("button", name="Heal everything").click()
    await expect(page.get_by_text("All is well")).to_be_visible(timeout=LONG_MS)
    await expect_told(page, "Final again at height")
    await _expect_growth(page)


async def test_what_the_command_line_does_meanwhile_is_told_too(console: ConsoleUnderTest, open_page: Page) -> None:
    page, control = open_page, FaultControl(console.network.cluster)
    await control.carry_out(Pause("node-3"))
    await expect_state(page, "node-3", "paused")
    await expect_told(page, "node-3 is paused")
    await control.carry_out(Resume("node-3"))
    await control.carry_out(control.reader.skew("node-4", "+1h"))
    await expect_told(page, "On at node-4: clock +1h.")
    await expect(row_of(page, "node-4")).to_contain_text("+1 h 0 min")
    await control.carry_out(Heal())
    await expect_told(page, "Off at node-4: clock +1h.")
    await expect(page.get_by_text("All is well")).to_be_visible(timeout=LONG_MS)


async def test_links_disks_and_plans_are_forms_of_the_same_faults(open_page: Page, watch: Watch) -> None:
    page = open_page
    await page.get_by_role("tab", name="A link").click()
    await page.get_by_label("To", exact=True).select_option("node-4")
    await page.get_by_label("Delay, ms").fill("30")
    await page.get_by_role("button", name="Spoil it").click()
    await expect_told(page, "Done: link node-1 <-> node-4: 30 ms.")
    await expect(page.locator(".link.slow").first).to_be_visible(timeout=LONG_MS)
    await page.get_by_role("tab", name="A plan").click()
    watch.expect("status of 400")
    await page.get_by_label("Plan", exact=True).fill('[[step]]\nat = "0s"\ndo = "explode"\n')
    await page.get_by_role("button", name="Show the steps").click()
    await expect(page.locator(".break .notice.bad")).to_contain_text("line 3: do is one of kill")
    await page.get_by_label("Plan", exact=True).fill(PLAN)
    await page.get_by_role("button", name="Show the steps").click()
    await expect(page.locator("table.steps")).to_contain_text("Seed 3, 2 steps; nothing is done")
    await page.get_by_role("button", name="Carry it out").click()
    await page.get_by_role("dialog").get_by_role("button", name="Carry it out").click()
    await expect(page.locator("table.steps")).to_contain_text("Seed 3, 2 steps: done", timeout=LONG_MS)
    await expect_told(page, "s: heal everything.")
    await expect(page.get_by_text("All is well")).to_be_visible(timeout=LONG_MS)


async def test_the_live_console_is_scrolled_back_and_comes_back_to_now(open_page: Page) -> None:
    page = open_page
    await page.get_by_label("Node", exact=True).select_option("node-4")
    await page.get_by_role("button", name="Pause", exact=True).click()
    await expect_state(page, "node-4", "paused")
    await page.get_by_role("button", name="Resume", exact=True).click()
    await expect_state(page, "node-4", "signing")
    now = page.get_by_role("button", name="Back to now")
    await expect(now).to_be_disabled()
    told = page.locator(".events li", has_text="node-4 is paused").first
    await told.get_by_role("button").click()
    await expect_state(page, "node-4", "paused")
    await expect(page.locator(".replay")).to_contain_text("You look at the past")
    height = await _final_height(page)
    await page.wait_for_timeout(1_500)
    assert await _final_height(page) == height, "the past stands still"
    assert await find_accessibility_faults(page, by_keyboard=False) == []
    await now.click()
    await expect_state(page, "node-4", "signing")
    await _expect_growth(page)
    await page.get_by_role("slider").focus()
    await page.keyboard.press("Home")
    await expect(page.locator("output")).to_contain_text("0 ms of")
    await page.get_by_label("Speed").select_option("16")
    await page.get_by_role("button", name="Play").click()
    await expect(page.locator("output")).to_contain_text("now", timeout=LONG_MS)


async def test_the_time_line_is_filtered_by_kind_node_and_word(open_page: Page) -> None:
    page = open_page
    await page.get_by_label("Node", exact=True).select_option("node-4")
    await page.get_by_role("button", name="Wrong clock…").click()
    await page.get_by_role("dialog").get_by_role("button", name="Set it").click()
    await expect_told(page, "Done: skew node-4 by +1h.")
    await expect(page.get_by_role("button", name="Right clock")).to_be_enabled()
    await page.get_by_label("Containing").fill("skew")
    await expect(page.locator(".events li")).to_have_count(2)
    await page.get_by_label("About").select_option("node-1")
    await expect(page.locator(".events li")).to_have_count(0)
    await page.get_by_label("About").select_option("node-4")
    await page.get_by_label("asked here").uncheck()
    await expect(page.locator(".events li")).to_have_count(0)


async def test_a_run_is_exported_and_replays_from_a_file_of_its_own(
    open_page: Page, pages: Pages, tmp_path: Path
) -> None:
    page = open_page
    await page.get_by_label("Node", exact=True).select_option("node-4")
    await page.get_by_role("button", name="Pause", exact=True).click()
    await expect_state(page, "node-4", "paused")
    async with page.expect_download() as waiting:
        await page.get_by_role("button", name="Export the run").click()
    file = tmp_path / "run.html"
    await (await waiting.value).save_as(file)
    await page.get_by_role("button", name="Resume", exact=True).click()
    replay = await pages.open()
    requests: list[str] = []
    replay.on("request", lambda request: requests.append(request.url))
    await replay.goto(file.as_uri())
    await expect(replay.get_by_role("heading", name="A run of ward-seven")).to_be_visible()
    await expect_state(replay, "node-4", "paused")
    slider = replay.get_by_role("slider")
    await slider.focus()
    await replay.keyboard.press("Home")
    await expect(row_of(replay, "node-4").locator(".badge")).not_to_have_text("paused")
    first = await replay.locator("output").inner_text()
    await replay.get_by_role("button", name="Next event").click()
    assert await replay.locator("output").inner_text() != first
    await replay.locator(".events li", has_text="node-4 is paused").get_by_role("button").click()
    await expect_state(replay, "node-4", "paused")
    await replay.get_by_role("button", name="Play").click()
    await expect(replay.get_by_role("button", name="Play")).to_be_visible(timeout=LONG_MS)
    assert requests == [file.as_uri()]
    await replay.evaluate("() => scrollTo(0, 0)")
    await shoot_all_ways(replay, "console-replay")
    assert await find_accessibility_faults(replay) == []


async def test_it_is_worked_by_keyboard_and_read_aloud(open_page: Page) -> None:
    page = open_page
    assert await find_accessibility_faults(page) == []
    for scheme in ("dark", "light"):
        await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        for width, height in (WIDE, ZOOMED, NARROW):
            await page.set_viewport_size({"width": width, "height": height})
            assert await find_accessibility_faults(page, by_keyboard=False) == []
    for tab in ("A node", "Partition", "A link", "A plan"):
        await page.get_by_role("tab", name=tab).click()
        assert await find_accessibility_faults(page, by_keyboard=False) == []
    await page.get_by_role("tab", name="A plan").press("ArrowRight")
    await expect(page.get_by_role("tab", name="A node")).to_be_focused()
    await page.get_by_role("button", name=re.compile("^node-3 of ")).press("Enter")
    await expect(page.get_by_label("Node", exact=True)).to_have_value("node-3")
    await page.get_by_role("button", name="Let it lie").press("Enter")
    dialog = page.get_by_role("dialog", name="Let node-3 lie?")
    await expect(dialog.get_by_label("equivocate")).to_be_visible()
    assert await find_accessibility_faults(page) == []
    await page.keyboard.press("Escape")
    await expect(page.get_by_role("button", name="Let it lie")).to_be_focused()


async def test_the_link_opens_the_page_once_and_is_for_this_user_alone(
    console: ConsoleUnderTest, page: Page, watch: Watch
) -> None:
    await console.open(page)
    folder, _, name = console.said["open"].rpartition("/")
    assert "#" not in page.url
    assert name not in os.listdir(folder)  # noqa: PTH208
    assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700  # noqa: PTH116
    watch.expect("status of 401")
    watch.expect("status of 403")
    watch.expect("status of 404")
    await page.reload()
    await expect(page.get_by_role("heading", name="The console is not open here")).to_be_visible()
    await expect(page.get_by_text("press Enter for another link")).to_be_visible()

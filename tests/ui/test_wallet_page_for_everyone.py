"""The wallet's page by keyboard alone, for a screen reader, at any width, dark, in Portuguese; and with a full day."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest
from playwright.async_api import Page, Route, expect

from clients.wallet.page.page import ASSETS
from clients.wallet.presentation.translations import LANGUAGES, section
from tests.ui.accessible import find_accessibility_faults
from tests.ui.full_day import RECORDS_COUNT, VISITS_COUNT, measure_full_day, serve_full_day, weigh_all_views
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.wallet_page import SETTLED_MS, VIEWS, go, open_page, serve_wallet, watch_first_meeting
from tests.ui.watched_page import NARROW, WIDE, ZOOMED
from tests.ui.weights import PAGE_MAX_BYTES

TABS_MAX_COUNT = 60
STAFF_UID = "B0B"
LEGEND_FAULTS = """() => {
  const card = document.querySelector('.stage-frame').getBoundingClientRect();
  const words = [...document.querySelectorAll('.colour-legend text, .grey-legend span')];
  const boxes = words.map((one) => one.getBoundingClientRect());
  const faults = words.filter((one, place) => boxes[place].left < card.left - 1 || boxes[place].right > card.right + 1)
    .map((one) => `cut off: ${one.textContent}`);
  boxes.forEach((box, place) => {
    if (box.height < 12) faults.push(`too small: ${words[place].textContent}`);
    boxes.slice(place + 1).forEach((other, after) => {
      if (box.left < other.right && other.left < box.right && box.top < other.bottom && other.top < box.bottom) {
        faults.push(`${words[place].textContent} lies over ${words[place + 1 + after].textContent}`);
      }
    });
  });
  return faults;
}"""
FRAMES_HELD_MAX_COUNT = 48


async def _press_until(page: Page, name: str) -> None:
    """Press Tab until the focus is on what is called so."""
    for _ in range(TABS_MAX_COUNT):
        await page.keyboard.press("Tab")
        found = await page.evaluate(
            "() => document.activeElement.getAttribute('aria-label') || document.activeElement.textContent"
        )
        if re.search(name, found.strip()):
            return
    raise AssertionError(f"Tab does not lead to {name}")


async def test_by_keyboard_alone_she_comes_from_the_calendar_to_the_pictures_and_back(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await _press_until(page, "recording")
        focused = page.locator(":focus")
        assert await focused.get_attribute("aria-disabled") is None, "Tab leads to a day that holds something"
        start = await focused.get_attribute("data-day")
        await page.keyboard.press("ArrowLeft")
        await page.keyboard.press("ArrowRight")
        await page.keyboard.press("PageUp")
        assert await focused.get_attribute("data-day") != start
        await page.keyboard.press("PageDown")
        await page.evaluate("() => document.querySelector('.latest a').focus()")
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("heading", level=1)).to_be_focused(timeout=SETTLED_MS)
        await _press_until(page, "Watch the meeting")
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("button", name="Play")).to_be_focused(timeout=SETTLED_MS)
        await page.keyboard.press("Home")
        await page.keyboard.press("ArrowRight")
        await expect(page.locator(".where")).to_contain_text("Picture 2 of")
        await page.keyboard.press("k")
        await expect(page.get_by_role("button", name="Pause")).to_be_visible()
        assert int(await page.locator(".player").get_attribute("data-held") or 0) <= FRAMES_HELD_MAX_COUNT
        await _press_until(page, "Erase…")
        await page.keyboard.press("Enter")
        await _press_until(page, "Erase for good")
        await page.keyboard.press("Enter")
        await expect(page.locator("dialog input")).to_be_focused()
        await page.keyboard.press("Escape")
        await expect(page.get_by_role("button", name="Erase for good")).to_be_focused()


async def test_by_keyboard_alone_she_takes_along_what_she_has_and_saves_the_file(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await _press_until(page, "^Take along$")
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("heading", level=1)).to_be_focused(timeout=SETTLED_MS)
        await _press_until(page, "^See what")
        await page.keyboard.press("Enter")
        await expect(page.locator("#main h2:focus")).to_be_visible(timeout=SETTLED_MS)
        await page.keyboard.press("Tab")
        await page.keyboard.press("Enter")
        await expect(page.locator("dialog input")).to_be_focused()
        await page.keyboard.type(recorded_network.passphrase_file.read_text().strip())
        await page.keyboard.press("Enter")
        await expect(page.locator("#main pre")).to_be_visible(timeout=SETTLED_MS)
        await expect(page.locator("#main h2:focus")).to_be_visible()
        async with page.expect_download() as saved:
            await page.keyboard.press("Tab")
            await page.keyboard.press("Enter")
        assert (await saved.value).suggested_filename.endswith(".zip")
        await page.set_viewport_size({"width": ZOOMED[0], "height": ZOOMED[1]})
        assert await find_accessibility_faults(page) == []


async def test_by_keyboard_alone_she_shares_a_meeting_up_to_the_question_and_says_no(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with recorded_network.wallet("nurse") as nurse:
        await nurse.register(recorded_network.issue_card(STAFF_UID, "staff"), [])
        handle = nurse.store.content.handle.hex()
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await page.evaluate("() => document.querySelector('.latest a').focus()")
        await page.keyboard.press("Enter")
        await expect(page.locator("input[data-visit]").first).to_be_visible(timeout=SETTLED_MS)
        while not await page.evaluate("() => document.activeElement.matches('input[data-visit]')"):
            await page.keyboard.press("Tab")
        await page.keyboard.press("Space")
        await _press_until(page, "^Share…$")
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("heading", level=1)).to_be_focused(timeout=SETTLED_MS)
        while not await page.evaluate("() => document.activeElement.id === 'share-with'"):
            await page.keyboard.press("Tab")
        await page.keyboard.type(handle)
        await _press_until(page, "^See what that means$")
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("heading", name="What that means")).to_be_focused(timeout=SETTLED_MS)
        await _press_until(page, "^Share$")
        await page.keyboard.press("Enter")
        await expect(page.locator("dialog input")).to_be_focused()
        await page.keyboard.press("Escape")
        await expect(page.get_by_role("button", name="Share", exact=True)).to_be_focused()


async def test_nothing_stands_in_the_way_of_anybody_on_any_view(recorded_network: RecordedNetwork, page: Page) -> None:
    faults: dict[str, list[str]] = {}

    async def judge(name: str) -> None:
        for scheme in ("dark", "light"):
            await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
            for width, height in (ZOOMED, NARROW, WIDE):
                await page.set_viewport_size({"width": width, "height": height})
                by_keyboard = (scheme, width) == ("light", WIDE[0])
                found = await find_accessibility_faults(page, by_keyboard=by_keyboard)
                if found:
                    faults[f"{name} {scheme} {width}"] = found

    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        for view in VIEWS:
            await go(page, view)
            await judge(view or "calendar")
        await watch_first_meeting(page)
        await judge("meeting")
        await page.get_by_role("link", name="←").click()
        await page.locator("input[data-visit]").first.check()
        await judge("day")
        await page.get_by_role("button", name="Share…").click()
        await judge("share")
        await page.go_back()
        await page.locator("input[data-visit]").first.check()
        await page.get_by_role("button", name="Erase…").click()
        await expect(page.get_by_role("button", name="Erase for good")).to_be_visible()
        await judge("erase")
        await page.get_by_role("button", name="Erase for good").click()
        await judge("question")
    assert faults == {}


@pytest.mark.parametrize("language", LANGUAGES)
async def test_the_legend_of_distances_is_whole_and_legible_on_a_phone_and_zoomed_in(
    recorded_network: RecordedNetwork, page: Page, language: str
) -> None:
    async with serve_wallet(recorded_network, language=language) as served:
        await open_page(page, served)
        await watch_first_meeting(page)
        await expect(page.locator(".grey-legend")).to_be_visible(timeout=SETTLED_MS)
        for width, height in (ZOOMED, NARROW, WIDE):
            await page.set_viewport_size({"width": width, "height": height})
            assert await page.evaluate(LEGEND_FAULTS) == [], width


async def test_it_speaks_portuguese_when_the_wallet_does_and_changes_on_a_wish(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with serve_wallet(recorded_network, language="pt") as served:
        await open_page(page, served)
        await expect(page.get_by_role("heading", level=1)).to_have_text("Gravações de si")
        assert await page.evaluate("() => document.documentElement.lang") == "pt"
        await go(page, "consent")
        await expect(page.get_by_role("heading", level=1)).to_have_text("O seu consentimento")
        await page.get_by_label("Idioma").select_option("en")
        await expect(page.get_by_role("heading", level=1)).to_have_text("Your consent")
        assert await page.evaluate("() => document.documentElement.lang") == "en"


async def test_a_day_of_2000_records_is_there_whole_and_the_page_is_light(
    recorded_network: RecordedNetwork, page: Page, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with serve_full_day(recorded_network, tmp_path / "page") as file:
        await page.goto(file.as_uri())
        await expect(page.locator("table.calendar .day.has").first).to_be_visible(timeout=SETTLED_MS)
        await expect(page.locator(".lead")).to_contain_text("recordings of you")
        figures = await weigh_all_views(page) | await measure_full_day(page)
        counts = await page.locator("section.card h2 .quiet").all_inner_texts()
        assert (
            sum(int(re.findall(r"(\d[\d,]*) recording", text)[0].replace(",", "")) for text in counts) == RECORDS_COUNT
        )
        assert await page.locator(".visit-row").count() >= VISITS_COUNT
        assert await page.locator(".record-row").count() < RECORDS_COUNT / 10, "rows are made as they come into view"
        await page.goto("about:blank")
    with capsys.disabled():
        sys.stdout.write(json.dumps({"name": "wallet_page", "ok": True, "figures": figures}) + "\n")
    assert figures["plain_bytes"] <= PAGE_MAX_BYTES
    assert figures["all_views_sent_bytes"] <= PAGE_MAX_BYTES
    assert figures["all_views_sent_bytes"] < figures["all_views_plain_bytes"] / 2, "what is sent is packed"


async def test_an_empty_history_says_so_and_what_will_happen(recorded_network: RecordedNetwork, page: Page) -> None:
    async def empty(route: Route) -> None:
        answer = await route.fetch()
        await route.fulfill(response=answer, json=await answer.json() | {"days": [], "visits": []})

    async with serve_wallet(recorded_network) as served:
        await page.route("**/api/days*", empty)
        served.pages.append(page)
        await page.goto(served.file.as_uri())
        await expect(page.locator("#main")).to_contain_text("Nothing was recorded of you.", timeout=SETTLED_MS)
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await page.unroute_all(behavior="wait")


@pytest.mark.smoke
@pytest.mark.parametrize("language", LANGUAGES)
def test_every_text_that_the_page_asks_for_is_in_the_catalogue(language: str) -> None:
    texts = section("page", language)
    asked = set()
    for path in ASSETS.glob("*.js"):
        asked |= set(re.findall(r'\bt\(\s*"([^"$]+)"', path.read_text(encoding="utf-8")))
    assert len(asked) > 200
    assert sorted(asked - set(texts)) == []


@pytest.mark.smoke
def test_no_file_of_the_page_has_inline_code_or_asks_anybody_else() -> None:
    for path in ASSETS.iterdir():
        text = path.read_text(encoding="utf-8")
        for forbidden in (
            "innerHTML",
            "style=",
            "eval(",
            "onclick=",
            "localStorage",
            "sessionStorage",
            "document.cookie",
        ):
            assert forbidden not in text, (path.name, forbidden)
        addresses = re.findall(r"https?://[^\s\"']+", text)
        assert [address for address in addresses if "www.w3.org" not in address] == [], path.name

"""What the wallet's page writes into the audit trail: one look is one entry, and nothing that it does by itself is any."""

from __future__ import annotations

import asyncio
from urllib.parse import urlsplit

from playwright.async_api import Page, Request, Route, expect

from clients.wallet.ledger.visit_audit import audit_all
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.wallet_page import SETTLED_MS, go, open_page, serve_wallet, watch_first_meeting
from tests.ui.watched_page import Watch

_BY_HER = ("access_requested", "verdict", "granted", "erasure_requested")


async def entries_by_her(network: RecordedNetwork) -> list[str]:
    """The kinds of entries that her wallet signed, in order."""
    async with network.wallet() as ann:
        return [entry.kind for entry in await audit_all(ann) if entry.kind in _BY_HER]


async def test_a_change_of_language_the_back_button_and_news_ask_for_nothing_again(
    recorded_network: RecordedNetwork, page: Page, watch: Watch
) -> None:
    watch.expect("ERR_INTERNET_DISCONNECTED")
    posted: list[str] = []

    def note(request: Request) -> None:
        if request.method == "POST":
            posted.append(urlsplit(request.url).path)

    before = await entries_by_her(recorded_network)
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await watch_first_meeting(page)
        player = page.locator(".player")
        await player.get_by_role("button", name="Pause").or_(player.get_by_role("button", name="Play")).first.wait_for()
        if await player.get_by_role("button", name="Pause").count():
            await player.get_by_role("button", name="Pause").click()
        await player.get_by_role("slider").fill("2")
        await expect(player).to_have_attribute("data-place", "2")
        assert await entries_by_her(recorded_network) == [*before, "access_requested"]

        page.on("request", note)
        await page.locator("#bar select").select_option("pt")
        await expect(page.locator(".seal")).to_contain_text("Tal como o robô")
        await expect(page.locator("#bar select")).to_be_focused()
        await expect(player).to_have_attribute("data-place", "2")
        await expect(player.locator(".where")).to_contain_text("Imagem 3 de")
        await page.locator("#bar select").select_option("en")
        await expect(page.locator(".seal")).to_contain_text("As the robot took it")
        await recorded_network.record()
        await expect(page.locator("#news")).to_contain_text("came in", timeout=SETTLED_MS)
        await expect(player).to_be_visible()
        await page.context.set_offline(True)
        await page.wait_for_timeout(300)
        await page.context.set_offline(False)
        await go(page, "story")
        await page.go_back()
        await expect(page.get_by_role("button", name="Watch")).to_be_visible(timeout=SETTLED_MS)
        await page.go_back()
        await page.go_forward()
        await expect(page.get_by_role("button", name="Watch")).to_be_visible(timeout=SETTLED_MS)
        assert await player.count() == 0
        assert posted == [], "the page sends by itself nothing that could be signed"
        assert await entries_by_her(recorded_network) == [*before, "access_requested"]


async def test_what_is_typed_stays_in_another_language(recorded_network: RecordedNetwork, page: Page) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await page.locator(".latest a").first.click()
        await page.locator("input[data-visit]").first.check()
        await page.locator("#bar select").select_option("pt")
        await expect(page.locator("input[data-visit]").first).to_be_checked()
        await page.locator(".actions button").first.click()
        await page.locator("#share-with").fill("somebody")
        await page.locator("#share-span").select_option("date")
        await page.locator("#bar select").select_option("en")
        await expect(page.locator("#share-with")).to_have_value("somebody")
        await expect(page.locator("#share-date")).to_be_visible()


async def test_what_is_typed_while_the_language_changes_stays(recorded_network: RecordedNetwork, page: Page) -> None:
    """The new words wait for the custodians' network: until they are there, the old page is typed into."""
    asked, may_answer = asyncio.Event(), asyncio.Event()

    async def hold(route: Route) -> None:
        asked.set()
        await may_answer.wait()
        await route.continue_()

    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await page.locator(".latest a").first.click()
        await page.locator("input[data-visit]").first.check()
        await page.locator(".actions button").first.click()
        await expect(page.locator("#share-with")).to_be_visible()
        await page.route("**/api/shares*", hold)
        await page.locator("#bar select").select_option("pt")
        await asked.wait()
        await page.locator("#share-with").fill("somebody")
        may_answer.set()
        await expect(page.get_by_label("Com quem?")).to_have_value("somebody")

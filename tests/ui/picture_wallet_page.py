"""Makes docs/pictures/page/wallet-*.png: every view of the wallet's page over a real network.

Must never retouch a picture. Run it from the root of the repository, where the tests run:
.venv/bin/python -m tests.ui.picture_wallet_page
"""

from __future__ import annotations

import asyncio
import shutil
import sys
import tempfile
from pathlib import Path

from playwright.async_api import Browser, Page, async_playwright, expect

from network.demo.tampering import flip_stored_byte
from tests.ui.chromium import open_chromium
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.screenshots import shoot_for_docs
from tests.ui.wallet_page import SETTLED_MS, confirm_with, go, open_page, serve_wallet, watch_first_meeting
from tests.ui.watched_page import Pages, Watch

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "page"
PLACE = Path(tempfile.gettempdir()) / "ward"
STAFF_UID = "D0C"
NEW_UID = "BEA"


async def shoot(page: Page, name: str) -> None:
    """Take a view of the wallet's page all ways."""
    await shoot_for_docs(page, FOLDER, f"wallet-{name}")


async def _views(network: RecordedNetwork, page: Page) -> None:
    async with serve_wallet(network) as served:
        await open_page(page, served)
        await shoot(page, "calendar")
        await page.locator(".latest a").first.click()
        await page.locator(".visit-row").first.wait_for()
        await shoot(page, "day")
        await watch_first_meeting(page)
        middle = int(await page.get_by_role("slider").get_attribute("max") or 0) // 2
        await page.get_by_role("slider").fill(str(middle))
        await shoot(page, "meeting")
        await _change_one(network)
        await go(page, f"record/{network.records[-2].record_id.hex()}")
        await page.get_by_role("button", name="Watch").click()
        await expect(page.locator(".seal[data-seal=bad]")).to_be_visible(timeout=SETTLED_MS)
        await shoot(page, "changed")
        await page.get_by_role("button", name="Write this finding").click()
        await expect(page.locator(".seal")).to_contain_text("stands in block", timeout=SETTLED_MS)
        await _share(network, page)
        for view in ("consent", "export", "story", "inbox"):
            await go(page, view)
            await shoot(page, view)
        await _erase(network, page)


async def _register(network: RecordedNetwork, page: Page) -> None:
    async with network.wallet("bea"):
        code = network.issue_card(NEW_UID, "subject")
    async with serve_wallet(network, profile="bea") as served:
        served.pages.append(page)
        await page.goto(served.file.as_uri())
        await page.get_by_label("Code on your card").fill(code, timeout=SETTLED_MS)
        await page.get_by_role("button", name="See what you are told").click()
        await page.get_by_role("button", name="Register", exact=True).wait_for()
        await page.get_by_label("Code on your card").fill("")
        await shoot(page, "register")


async def _change_one(network: RecordedNetwork) -> None:
    for node in network.genesis.custodians:
        config = network.network.cluster.config(node.name)
        await asyncio.to_thread(flip_stored_byte, config, network.records[-2].record_id, 0)


async def _choose_first(page: Page) -> None:
    await go(page, "")
    await page.locator(".latest a").first.click()
    await page.locator("input[data-visit]").first.check()


async def _share(network: RecordedNetwork, page: Page) -> None:
    async with network.wallet("doctor") as doctor:
        await doctor.register(network.issue_card(STAFF_UID, "staff"), [])
        handle = doctor.store.content.handle.hex()
    await _choose_first(page)
    await page.get_by_role("button", name="Share…").click()
    await page.get_by_label("With whom?").fill(handle)
    await page.get_by_label("What you call them").fill("Dr Weber")
    await page.get_by_label("What for?").select_option("demo")
    await page.get_by_role("button", name="See what that means").click()
    await page.get_by_role("heading", name="What that means").wait_for()
    await shoot(page, "share")
    await page.get_by_role("button", name="Share", exact=True).click()
    await confirm_with(page, network.passphrase)
    await expect(page.locator(".notice.good")).to_be_visible(timeout=SETTLED_MS)
    await go(page, "sharing")
    await expect(page.locator("section.card", has_text="Dr Weber")).to_be_visible(timeout=SETTLED_MS)
    await shoot(page, "sharing")


async def _erase(network: RecordedNetwork, page: Page) -> None:
    await _choose_first(page)
    await page.get_by_role("button", name="Erase…").click()
    await page.get_by_role("heading", name="What remains").wait_for()
    await shoot(page, "erase")
    await page.get_by_role("button", name="Erase for good").click()
    await confirm_with(page, network.passphrase)
    await page.get_by_role("heading", name="Erased everywhere").wait_for(timeout=SETTLED_MS)
    await shoot(page, "receipts")
    await go(page, "erasing")
    await page.get_by_role("heading", level=1).wait_for()
    await shoot(page, "erasing")
    await page.get_by_role("button", name="Lock").click()
    await page.get_by_role("heading", name="The wallet is locked").wait_for()
    await shoot(page, "locked")


async def make(browser: Browser, folder: Path) -> None:
    """Make all pictures."""
    pages = Pages(browser, Watch())
    network = RecordedNetwork(folder)
    try:
        await network.start()
        await network.record()
        await _views(network, await pages.open())
        await _register(network, await pages.open())
    finally:
        await pages.close()
        await network.close()


async def main() -> int:
    """Make the pictures."""
    async with async_playwright() as playwright, open_chromium(playwright) as browser:
        await make(browser, PLACE)
    return 0


if __name__ == "__main__":
    PLACE.mkdir()  # it is in the pictures, so it is always the same
    try:
        sys.exit(asyncio.run(main()))
    finally:
        shutil.rmtree(PLACE)

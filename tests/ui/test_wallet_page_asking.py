"""The question for the passphrase: it stays until it is answered, and cannot be asked or answered twice at once."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from playwright.async_api import Page, Route, expect

from tests.ui.accessible import find_accessibility_faults
from tests.ui.shown_page import SOON_MS, show_ward
from tests.ui.watched_page import Watch
from tests.unit.clients.wallet.page.conftest import PASSPHRASE
from tests.world.sharing import SharedWard


@pytest.mark.parametrize("by", ["keyboard", "mouse"])
async def test_while_a_passphrase_is_checked_the_question_stays_and_takes_nothing_more(
    tmp_path: Path, page: Page, watch: Watch, by: str
) -> None:
    watch.expect("status of 403")
    ward = SharedWard(tmp_path)
    ward.record_visit(1)
    goes_on, asked = asyncio.Event(), 0

    async def hold(route: Route) -> None:
        nonlocal asked
        asked += 1
        await goes_on.wait()
        await route.continue_()

    async with show_ward(ward, page) as shown:
        await page.route("**/api/exports", hold)
        await shown.go("export")
        await page.get_by_role("button", name="See what goes along").click()
        await page.get_by_role("button", name="Make the file").click(timeout=SOON_MS)
        dialog, field = page.locator("dialog"), page.locator("dialog input[type=password]")
        await field.fill("not it")
        if by == "keyboard":
            await page.keyboard.press("Enter")
        else:
            await dialog.get_by_role("button", name="Make the file").click()
        await expect(dialog.get_by_role("status")).to_have_text("Your passphrase is being checked.")
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        for key in ("Enter", "Space", "Escape", "Escape"):
            await page.keyboard.press(key)
        await dialog.get_by_role("button", name="Cancel").click(force=True)
        await expect(dialog).to_have_count(1)
        await expect(dialog).to_be_visible()
        assert asked == 1
        goes_on.set()
        await expect(dialog.get_by_role("alert")).to_contain_text("not the passphrase")
        await expect(dialog.get_by_role("status")).to_have_text("")
        await expect(field).to_have_value("")
        await expect(field).to_be_focused()
        await page.keyboard.type(PASSPHRASE)
        await page.keyboard.press("Enter")
        await expect(dialog).to_have_count(0, timeout=SOON_MS)
        await expect(page.get_by_role("button", name="Save blockrobot-")).to_be_visible(timeout=SOON_MS)
        await page.unroute_all(behavior="wait")


async def test_a_question_that_is_left_does_nothing(tmp_path: Path, page: Page) -> None:
    ward = SharedWard(tmp_path)
    ward.record_visit(1)
    posted: list[str] = []
    page.on("request", lambda request: posted.append(request.url) if request.method == "POST" else None)
    async with show_ward(ward, page) as shown:
        await shown.go("export")
        await page.get_by_role("button", name="See what goes along").click()
        make = page.get_by_role("button", name="Make the file")
        await make.click(timeout=SOON_MS)
        await page.keyboard.press("Escape")
        await expect(page.locator("dialog")).to_have_count(0)
        await expect(make).to_be_focused()
        assert not [url for url in posted if url.endswith("/api/exports")]

"""Times in our pages: 24 hours and the zone, whatever the reader's language; and the played bundle shows the same."""

from __future__ import annotations

import pytest
from playwright.async_api import expect

from clients.bundle.texts import player_page
from node.explorer.page import EXPLORER_ASSETS
from tests.ui.page_scripts import open_scripts
from tests.ui.test_taken_along import erasure, visit
from tests.ui.watched_page import Pages

MIDNIGHT_MS, SUMMER_MS = 1_801_436_730_000, 1_814_382_300_000  # 00:05:30 in winter and 21:05:00 in summer, in Berlin
_SHOW = """async ([ms, locale]) => {
  const { formatTime, formatClock } = await import('./shared/format.js');
  return [formatTime(ms, locale ?? undefined), formatClock(ms, locale ?? undefined)];
}"""


@pytest.mark.parametrize("language", ["en-US", "en-GB", "pt-PT"])
async def test_hours_are_counted_to_24_and_the_offset_is_said(pages: Pages, language: str) -> None:
    page = await pages.open(locale=language)
    await open_scripts(page, EXPLORER_ASSETS)
    for given in (language, None):
        moment, clock = await page.evaluate(_SHOW, [MIDNIGHT_MS, given])
        assert clock == "00:05:30"
        assert moment.endswith(", 00:05:30 UTC+01:00")
        moment, clock = await page.evaluate(_SHOW, [SUMMER_MS, given])
        assert moment.endswith(f", {clock} UTC+02:00")
        assert clock == "21:05:00"


async def test_the_page_of_a_bundle_shows_moments_as_the_others_do(pages: Pages) -> None:
    page = await pages.open(locale="en-US")
    await open_scripts(page, EXPLORER_ASSETS)
    wanted, _ = await page.evaluate(_SHOW, [1_700_000_000_000, "en-GB"])
    assert wanted == "14 Nov 2023, 23:13:20 UTC+01:00"
    page = await pages.open(locale="en-US")
    await page.set_content(player_page([visit()], [erasure()], {}).decode())
    await expect(page.locator("#place")).to_have_text(f"Picture 1 of 2, {wanted}")

"""Where pages put the focus: never so that what is to be seen is scrolled away."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from clients.wallet.page.page import ASSETS as WALLET_ASSETS
from network.console.live import CONSOLE_ASSETS
from node.explorer.page import EXPLORER_ASSETS
from pages.serving import PAGES_ASSETS
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.wallet_page import SETTLED_MS, go, open_page, serve_wallet
from tests.ui.watched_page import Pages

_RAW_FOCUS = re.compile(r"(?<!player)\.focus\(")
_TOPS = """() => ['.seal h2', 'canvas.stage'].map((name) => document.querySelector(name).getBoundingClientRect().top)"""


@pytest.mark.smoke
@pytest.mark.parametrize(
    "folder",
    [WALLET_ASSETS, CONSOLE_ASSETS, EXPLORER_ASSETS, PAGES_ASSETS],
    ids=["wallet", "console", "explorer", "shared"],
)
def test_every_script_gives_the_focus_by_the_one_function_that_does_not_jump(folder: Path) -> None:
    scripts = sorted(folder.glob("*.js"))
    assert scripts
    found = {path.name: len(_RAW_FOCUS.findall(path.read_text(encoding="utf-8"))) for path in scripts}
    assert {name: count for name, count in found.items() if count} == ({"dom.js": 1} if folder == PAGES_ASSETS else {})


@pytest.mark.parametrize("size", [(1280, 720), (390, 844)], ids=["wide", "narrow"])
async def test_a_recording_that_opens_shows_its_seal_and_its_picture(
    recorded_network: RecordedNetwork, pages: Pages, size: tuple[int, int]
) -> None:
    page: Page = await pages.open(size)
    record = next(entry for entry in recorded_network.records if entry.metadata.sensor == "depth")
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await go(page, f"record/{record.record_id.hex()}")
        await page.get_by_role("button", name="Watch").click()
        await expect(page.locator(".player")).to_be_visible(timeout=SETTLED_MS)
        await expect(page.locator(".player .controls button").first).to_be_focused()
        seal, stage = await page.evaluate(_TOPS)
        assert 0 <= seal < size[1]
        assert seal < stage < size[1]

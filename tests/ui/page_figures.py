"""What the wallet's page, the explorer and the console weigh, and how soon they are seen, over a real network; as JSON.

Must never count pictures, or answers about data, as weight. Run it from the root of the repository, where the tests run:
.venv/bin/python -m tests.ui.page_figures
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from playwright.async_api import Browser, Page, async_playwright, expect

from tests.cluster.network_under_test import running
from tests.ui.chromium import open_chromium
from tests.ui.console_under_test import ConsoleUnderTest
from tests.ui.explorer_page import enter
from tests.ui.full_day import measure_full_day, serve_full_day, weigh_all_views
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.wallet_page import SETTLED_MS
from tests.ui.watched_page import Pages, Watch
from tests.ui.weights import weigh


async def _wallet(network: RecordedNetwork, page: Page, folder: Path) -> dict[str, float]:
    async with serve_full_day(network, folder) as file:
        await page.goto(file.as_uri())
        await expect(page.locator("table.calendar .day.has").first).to_be_visible(timeout=SETTLED_MS)
        await expect(page.locator(".lead")).to_contain_text("recordings of you")
        figures = await weigh_all_views(page) | await measure_full_day(page)
        await page.goto("about:blank")
    return figures


async def _explorer(network: RecordedNetwork, page: Page) -> dict[str, float]:
    await enter(page, network.network)
    return await weigh(page)


async def _console(page: Page, folder: Path) -> dict[str, float]:
    async with running(ConsoleUnderTest(folder)) as console:
        await console.open(page)
        await expect(page.get_by_text("All is well")).to_be_visible(timeout=SETTLED_MS)
        return await weigh(page)


async def measure(browser: Browser, folder: Path) -> dict[str, Any]:
    """Return the figures of the three pages: bytes and milliseconds."""
    pages = Pages(browser, Watch())
    network = RecordedNetwork(folder / "recorded")
    try:
        await network.start()
        wallet = await _wallet(network, await pages.open(), folder / "page")
        explorer = await _explorer(network, await pages.open())
        await network.close()
        console = await _console(await pages.open(), folder / "console")
    finally:
        await pages.close()
        await network.close()
    return {"wallet": wallet, "explorer": explorer, "console": console}


async def main() -> int:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as folder:
        async with async_playwright() as playwright, open_chromium(playwright) as browser:
            figures = await measure(browser, Path(folder))
            conditions = {"chromium": browser.version, "cores": os.cpu_count(), "load": os.getloadavg()[0]}
    text = json.dumps({"name": "pages", "ok": True, "figures": figures, "conditions": conditions}, indent=2)
    sys.stdout.write(f"{text}\n")
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))

"""A browser, watched pages and a real network for the stories of this folder.

All asynchronous tests here share one event loop with the browser. A fixture of a test file's own says so too:
`@pytest_asyncio.fixture(loop_scope="session")`.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio
from playwright.async_api import Browser, Page, async_playwright, expect

from tests.cluster.network_under_test import running
from tests.ui.chromium import open_chromium
from tests.ui.console_page import open_healed
from tests.ui.console_under_test import ConsoleUnderTest
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.watched_page import TIMEOUT_MS, Pages, Watch

HERE = Path(__file__).parent


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What opens a page needs the system's Chromium; all of this folder runs on the browser's event loop."""
    for item in items:
        if item.path.is_relative_to(HERE):
            if "browser" in getattr(item, "fixturenames", ()):
                item.add_marker(pytest.mark.system_packages)
            if item.get_closest_marker("asyncio") is not None:
                item.add_marker(pytest.mark.asyncio(loop_scope="session"), append=False)


@pytest_asyncio.fixture(scope="session", loop_scope="session")
async def browser() -> AsyncIterator[Browser]:
    """The system's Chromium, started once. What is expected may take as long as what is done: machines are slow."""
    expect.set_options(timeout=TIMEOUT_MS)
    async with async_playwright() as playwright, open_chromium(playwright) as started:
        yield started


@pytest.fixture
def watch() -> Watch:
    """What the browser complained of in this test: `watch.expect(pattern)` for what the story brings about."""
    return Watch()


@pytest_asyncio.fixture(loop_scope="session")
async def pages(browser: Browser, watch: Watch) -> AsyncIterator[Pages]:
    """Opens pages of any size, colour scheme and locale; afterwards nobody may have complained."""
    opened = Pages(browser, watch)
    yield opened
    await opened.close()
    assert watch.unexpected() == []


@pytest_asyncio.fixture(loop_scope="session")
async def page(pages: Pages) -> Page:
    """One empty page, wide and light, in a browser context of its own."""
    return await pages.open()


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def recorded_network(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RecordedNetwork]:
    """Four real nodes and one recorded person, once for each file of tests."""
    async with running(RecordedNetwork(tmp_path_factory.mktemp("recorded"))) as made:
        yield made


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def console(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[ConsoleUnderTest]:
    """A network that always has work, once for each file of tests, and the console's command beside it."""
    async with running(ConsoleUnderTest(tmp_path_factory.mktemp("console"))) as made:
        yield made


@pytest_asyncio.fixture(loop_scope="session")
async def open_page(console: ConsoleUnderTest, page: Page) -> Page:
    """The console's page, of a network on which nothing is wrong (any more)."""
    await open_healed(console, page)
    return page

"""The explorer of a real node, opened as the command does."""

from __future__ import annotations

from contextlib import AsyncExitStack

from playwright.async_api import Page, expect

from network.cli.cluster.explore_commands import explorer_page, open_explorer
from network.cli.contract.contract_signers import get_signers
from pages.local_page import LocalPage
from tests.cluster.network_under_test import NetworkUnderTest
from tests.ui.watched_page import move_to


async def enter(page: Page, network: NetworkUnderTest, place: str = "live") -> LocalPage:
    """Open the explorer of the first node as the command does, in a session of the hospital's admin.

    Return what serves it, until the browser's context is closed.
    """
    access = await open_explorer(get_signers(network.folder, None, None, None), "node-1")
    stack = AsyncExitStack()
    served = await stack.enter_async_context(explorer_page(access, network.folder / "links"))
    page.context.once("close", lambda _: stack.aclose())
    await page.goto((await served.start()).redirect_file.as_uri(), wait_until="commit")
    await expect(page.locator("#state")).to_have_text("your session")
    await go(page, place)
    return served


async def go(page: Page, place: str) -> None:
    """Go to a page by its address, and wait until it is shown."""
    await move_to(page, place)
    await expect(page.locator("main:not([aria-busy]) h1")).to_be_visible()

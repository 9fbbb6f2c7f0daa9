"""The explorer of a real node, opened as the command does."""

from __future__ import annotations

from playwright.async_api import Page, expect

from network.cli.cluster.explore_commands import open_explorer
from network.cli.contract.contract_signers import get_signers
from tests.cluster.network_under_test import NetworkUnderTest
from tests.ui.watched_page import move_to


async def enter(page: Page, network: NetworkUnderTest, place: str = "live") -> None:
    """Open the explorer of the first node as the command does, in a session of the hospital's admin."""
    entrance = await open_explorer(get_signers(network.folder, None, None, None), "node-1")
    await page.goto(entrance.target)
    await expect(page.locator("#state")).to_contain_text("session until")
    await go(page, place)


async def go(page: Page, place: str) -> None:
    """Go to a page by its address, and wait until it is shown."""
    await move_to(page, place)
    await expect(page.locator("main:not([aria-busy]) h1")).to_be_visible()

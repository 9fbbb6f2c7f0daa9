"""A person's page in a browser, and behind it real contracts and proofs in this process: no network is started."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from playwright.async_api import Page, expect

from tests.ui.watched_page import TIMEOUT_MS, move_to
from tests.world.served import ServedWard, serve_ward
from tests.world.sharing import SharedWard

SOON_MS = TIMEOUT_MS
COMMAND = "blockrobot wallet --profile ann --wallet-dir '/srv/my wallets' serve"


@dataclass
class Shown(ServedWard):
    """A person's page in a browser, and what stands behind it."""

    page: Page

    async def record(self) -> None:
        """Have the robot meet her once more, and the session read it."""
        self.ward.record_visit()
        await self.read()

    async def go(self, place: str) -> None:
        """Go to a view, as a link to it does, and wait until it stands."""
        await move_to(self.page, place)
        await expect(self.page.locator("#main:not([aria-busy]) h1")).to_be_focused(timeout=SOON_MS)

    async def watch(self, record_id: bytes) -> None:
        """Go to a record and open it; wait for the player and the seal."""
        await self.go(f"record/{record_id.hex()}")
        await self.page.get_by_role("button", name="Watch", exact=True).click()
        await expect(self.page.locator(".player")).to_be_visible(timeout=SOON_MS)
        await expect(self.page.locator(".seal")).to_be_visible()


@asynccontextmanager
async def show_ward(ward: SharedWard, page: Page) -> AsyncIterator[Shown]:
    """Serve the page of a ward's patient, and open it; what was recorded before is on it."""
    async with serve_ward(ward, command=COMMAND) as served:
        try:
            await page.goto(served.file.as_uri())
            await expect(page.locator(".lead")).to_contain_text("recording", timeout=SOON_MS)
            yield Shown(ward, served.session, served.served, served.file, page)
        finally:
            await page.goto("about:blank")  # who still listens when the page ends complains

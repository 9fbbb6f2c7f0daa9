"""A person's page in a browser, and behind it real contracts and proofs in this process: no network is started."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from playwright.async_api import Page, expect

from clients.wallet.page.page import make_page
from clients.wallet.page.session import PageSession
from pages.local_page import LocalPage
from tests.ui.watched_page import TIMEOUT_MS, move_to
from tests.unit.clients.wallet.page.conftest import dress
from tests.unit.clients.wallet.shared_ward import SharedWard

SOON_MS = TIMEOUT_MS
COMMAND = "blockrobot wallet --profile ann --wallet-dir '/srv/my wallets' serve"


@dataclass
class Shown:
    """A person's page in a browser, and what stands behind it."""

    ward: SharedWard
    session: PageSession
    served: LocalPage
    page: Page

    async def read(self) -> None:
        """Have the session read the chain once."""
        async with self.session.lock:
            await self.session.read()

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
    dress(ward)
    session = PageSession(
        ward.wallet,
        "ann",
        ward.folder / ".ann.page",
        now_ms=lambda: ward.chain.time_ms,
        read_every_s=3_600.0,
        command=COMMAND,
    )
    async with session:
        served = make_page(session)
        where = await served.start()
        shown = Shown(ward, session, served, page)
        await shown.read()
        try:
            await page.goto(where.redirect_file.as_uri())
            await expect(page.locator(".lead")).to_contain_text("recording", timeout=SOON_MS)
            yield shown
        finally:
            await page.goto("about:blank")  # who still listens when the page ends complains
            await served.stop()

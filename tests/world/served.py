"""The page of a ward's patient, served on this machine; behind it real contracts and proofs, with no wire in between."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from clients.wallet.page.page import make_page, monotonic_ms
from clients.wallet.page.session import PageSession
from pages.local_page import LocalPage
from tests.world.sharing import SharedWard


@dataclass
class ServedWard:
    """A ward, the session behind its patient's page, and the page with the file that opens it, once."""

    ward: SharedWard
    session: PageSession
    served: LocalPage
    file: Path

    async def read(self) -> None:
        """Have the session read the chain once."""
        async with self.session.lock:
            await self.session.read()


@asynccontextmanager
async def serve_ward(
    ward: SharedWard, *, command: str = "blockrobot wallet serve", now_ms: Callable[[], int] = monotonic_ms
) -> AsyncIterator[ServedWard]:
    """Serve the page, with what was recorded before on it; `now_ms` is the clock of its links."""
    folder = ward.folder / ".ann.page"
    session = PageSession(
        ward.wallet, "ann", folder, now_ms=lambda: ward.chain.time_ms, read_every_s=3_600.0, command=command
    )
    async with session:
        page = make_page(session, now_ms=now_ms)
        shown = ServedWard(ward, session, page, (await page.start()).redirect_file)
        await shown.read()
        try:
            yield shown
        finally:
            await page.stop()

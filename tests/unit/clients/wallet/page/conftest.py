"""A person's page over real HTTP on this machine; behind it real contracts and proofs, with no wire in between."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from clients.wallet.page.page import make_page
from clients.wallet.page.session import PageSession
from consensus.errors import BlockRobotError
from pages.local_page import LocalPage
from tests.unit.clients.wallet.conftest import typed_for
from tests.unit.clients.wallet.shared_ward import SharedWard
from tests.wallet_page_client import WalletPage

PASSPHRASE = "tea"


@dataclass
class Desk:
    """A ward, the session behind a page, the page itself, and who looks at it."""

    ward: SharedWard
    session: PageSession
    served: LocalPage
    page: WalletPage

    async def read(self) -> None:
        """Have the session read the chain once."""
        async with self.session.lock:
            await self.session.read()

    async def open_anew(self) -> WalletPage:
        """Another page of the same wallet, opened by a new link."""
        return await WalletPage(await self.served.new_link()).__aenter__()


def dress(ward: SharedWard) -> None:
    """Give the short wire what a page tells of a network."""
    ward.wire.troubles = dict[str, BlockRobotError]()  # type: ignore[attr-defined]


@pytest.fixture
def ward(tmp_path: Path) -> SharedWard:
    ward = SharedWard(tmp_path)
    dress(ward)
    return ward


@pytest.fixture
async def desk(ward: SharedWard, tmp_path: Path) -> AsyncIterator[Desk]:
    session = PageSession(
        ward.wallet, "ann", tmp_path / ".ann.page", now_ms=lambda: ward.chain.time_ms, read_every_s=3_600.0
    )
    with typed_for("ann"):
        async with session:
            served = make_page(session)
            where = await served.start()
            async with WalletPage(where.redirect_file) as page:
                desk = Desk(ward, session, served, page)
                await desk.read()
                yield desk
            await served.stop()

"""A person's page over real HTTP on this machine."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass

import pytest

from tests.wallet_page_client import WalletPage
from tests.world.dicts import typed_for
from tests.world.served import ServedWard, serve_ward
from tests.world.sharing import SharedWard

PASSPHRASE = "tea"


@dataclass
class PageHarness(ServedWard):
    """A served ward, and who looks at its page."""

    page: WalletPage


@pytest.fixture
async def desk(ward: SharedWard) -> AsyncIterator[PageHarness]:
    with typed_for("ann"):
        async with serve_ward(ward) as served, WalletPage(served.file) as page:
            yield PageHarness(served.ward, served.session, served.served, served.file, page)

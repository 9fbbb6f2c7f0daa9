"""The wallet's page put together: its files, its routes, its one session. Must never listen beyond this machine."""

from __future__ import annotations

from pathlib import Path

from clients.wallet.page import (
    clip_routes,
    consent_routes,
    erasing_routes,
    export_routes,
    inbox_routes,
    reading_routes,
    sharing_routes,
)
from clients.wallet.page.session import PageSession
from pages.local_page import LocalPage
from pages.serving import Assets

ASSETS = Path(__file__).parent / "assets"
TITLE = "Your wallet"
_PARTS = (
    reading_routes,
    clip_routes,
    consent_routes,
    sharing_routes,
    erasing_routes,
    export_routes,
    inbox_routes,
)


def make_page(session: PageSession) -> LocalPage:
    """Return the page of an open wallet, not yet listening."""
    routes = [each for part in _PARTS for each in part.routes(session)]
    return LocalPage(Assets(ASSETS), routes, redirect_folder=session.folder, title=TITLE)


def page_folder(wallet_file: Path) -> Path:
    """Return the folder of a wallet's page: beside the wallet, so that two wallets have two."""
    return wallet_file.with_name(f".{wallet_file.stem}.page")

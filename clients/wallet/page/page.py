"""The wallet's page: files, routes, session."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from clients.wallet.page.routes import (
    clip_routes,
    consent_routes,
    erasure_routes,
    export_routes,
    inbox_routes,
    reading_routes,
    registration_routes,
    sharing_routes,
)
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.translations import describe_error, language_in_use, text
from pages.local_page import LocalPage
from pages.serving import Assets

ASSETS = Path(__file__).parent / "assets"
_PARTS = (
    reading_routes,
    registration_routes,
    clip_routes,
    consent_routes,
    sharing_routes,
    erasure_routes,
    export_routes,
    inbox_routes,
)


def monotonic_ms() -> int:
    return time.monotonic_ns() // 1_000_000


def make_page(session: PageSession, *, now_ms: Callable[[], int] = monotonic_ms) -> LocalPage:
    """Unstarted; `now_ms` is the link-expiry clock."""
    routes = [each for part in _PARTS for each in part.routes(session)]
    return LocalPage(
        Assets(ASSETS),
        routes,
        redirect_folder=session.folder,
        title=text("page.link.title"),
        now_ms=now_ms,
        language=language_in_use(),
        link_note=text("page.link.once"),
        name_note=text("page.link.name"),
        describe=describe_error,
        command=session.command,
        allow_camera=True,
    )


def page_folder(wallet_file: Path) -> Path:
    """The page's folder lies next to its wallet."""
    return wallet_file.with_name(f".{wallet_file.stem}.page")

"""The system's Chromium, as the tests of this folder and the makers of pictures start it."""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from playwright.async_api import Browser, Playwright

NAMES = ("chromium", "chromium-browser")
FLAGS = [
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def find_chromium() -> str:
    """Return where the system's Chromium is."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    assert found, "There is no Chromium: `make test` installs it, `make test SYSTEM_PACKAGES=none` leaves these out."
    return found


@asynccontextmanager
async def open_chromium(playwright: Playwright) -> AsyncIterator[Browser]:
    """Start the browser, without a window."""
    # The pages are our own, and root (in a container) has no other way to start it.
    browser = await playwright.chromium.launch(
        executable_path=find_chromium(), headless=True, chromium_sandbox=False, args=FLAGS
    )
    try:
        yield browser
    finally:
        await browser.close()

"""`blockrobot wallet serve` as its person has it: the command as a process, its file in a browser, the page's views."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from playwright.async_api import Page, expect

from tests.ui.recorded_network import PROFILE, RecordedNetwork
from tests.ui.watched_page import move_to

SETTLED_MS = 30_000
END_S = 15.0
VIEWS = ("", "story", "consent", "sharing", "erasing", "export", "inbox")


class ServedWallet:
    """The running command. `file` opens its page, once."""

    def __init__(self, process: asyncio.subprocess.Process, file: Path) -> None:
        self.process = process
        self.file = file
        self.pages: list[Page] = []

    async def end(self) -> None:
        """End the command as Ctrl-C does, and wait until it has ended."""
        if self.process.returncode is None:
            self.process.send_signal(signal.SIGINT)
        async with asyncio.timeout(END_S):
            await self.process.communicate()


@asynccontextmanager
async def serve_wallet(
    network: RecordedNetwork, language: str = "en", profile: str = PROFILE
) -> AsyncIterator[ServedWallet]:
    """Run the command for the network's person, or another profile, until the end of the block."""
    environment = os.environ | {
        "BLOCKROBOT_PASSPHRASE_FILE": str(network.passphrase_file),
        "BLOCKROBOT_HOME": str(network.folder / "home"),
        "BLOCKROBOT_LANGUAGE": language,
    }
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "network.cli.main", *network.arguments_of(profile), "serve", "--no-browser", "--json",
        env=environment, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    told = b""
    while not told.rstrip().endswith(b"}"):
        line = await process.stdout.readline()
        assert line, (await process.communicate())[1].decode()
        told += line
    served = ServedWallet(process, Path(json.loads(told)["redirect_file"]))
    try:
        yield served
        for page in served.pages:
            await page.goto("about:blank")  # who still listens when the command ends complains
    finally:
        await served.end()


async def open_page(page: Page, served: ServedWallet) -> None:
    """Open the page by its file, and wait until the wallet has read the ledger and shows its person's days."""
    served.pages.append(page)
    await page.goto(served.file.as_uri())
    await expect(page.locator("table.calendar .day.has").first).to_be_visible(timeout=SETTLED_MS)


async def go(page: Page, place: str) -> None:
    """Go to a view, as a link to it does, and wait until it stands."""
    await move_to(page, place)
    await expect(page.locator("#main:not([aria-busy]) h1")).to_be_visible(timeout=SETTLED_MS)


async def watch_first_meeting(page: Page) -> None:
    """From the calendar to the newest day, and there watch its first meeting; wait for the player and the seal."""
    await go(page, "")
    await page.locator(".latest a").first.click()
    await page.locator(".visit-row a.button").first.click()
    await expect(page.locator(".player")).to_be_visible(timeout=SETTLED_MS)
    await expect(page.locator(".seal")).to_be_visible()


async def confirm_with(page: Page, passphrase: str) -> None:
    """Answer the question for the passphrase by keyboard."""
    await page.locator("dialog input[type=password]").fill(passphrase)
    await page.keyboard.press("Enter")

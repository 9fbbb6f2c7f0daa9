"""Serves one network's console, or another local page, until a signal stops it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from network.cluster import Cluster
from network.console.live import CONSOLE_ASSETS, LiveConsole
from network.console.routes import console_routes
from pages.local_page import LocalPage, Opened
from pages.serving import Assets

TITLE = "BlockRobot: cluster console"


async def serve_console(
    cluster: Cluster, *, redirect_folder: Path, opened: Callable[[Opened], None], is_interactive: bool = False
) -> None:
    """As `show_until_stopped`."""
    console = LiveConsole(cluster)
    page = LocalPage(Assets(CONSOLE_ASSETS), console_routes(console), redirect_folder=redirect_folder, title=TITLE)
    watching = asyncio.create_task(console.run(), name="console")
    try:
        await show_until_stopped(page, opened, is_interactive=is_interactive)
    finally:
        await console.close()
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await page.stop()


async def show_until_stopped(page: LocalPage, opened: Callable[[Opened], None], *, is_interactive: bool) -> None:
    """Until SIGINT or SIGTERM; the caller stops the page. `opened` receives the address and each new one-time link. With
    `is_interactive`, Enter makes a new link.
    """
    loop, stop, again = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    opened(await page.start())
    with _enter_key(again.set) if is_interactive else contextlib.nullcontext():
        await _until_stopped(page, opened, stop, again)


async def _until_stopped(
    page: LocalPage, opened: Callable[[Opened], None], stop: asyncio.Event, again: asyncio.Event
) -> None:
    stopping = asyncio.create_task(stop.wait())
    try:
        while not stop.is_set():
            asked = asyncio.create_task(again.wait())
            await asyncio.wait({stopping, asked}, return_when=asyncio.FIRST_COMPLETED)
            asked.cancel()
            if again.is_set() and not stop.is_set():
                again.clear()
                opened(Opened(url=page.url, redirect_file=await page.new_link()))
    finally:
        stopping.cancel()


@contextlib.contextmanager
def _enter_key(pressed: Callable[[], None]) -> Iterator[None]:
    if not sys.stdin.isatty():
        yield
        return
    loop, keyboard = asyncio.get_running_loop(), sys.stdin.fileno()

    def read() -> None:
        if os.read(keyboard, 1024):
            pressed()
        else:
            loop.remove_reader(keyboard)  # the terminal is gone

    loop.add_reader(keyboard, read)
    try:
        yield
    finally:
        loop.remove_reader(keyboard)

"""What opens a page in the browser, at a terminal: each file works once, Enter makes another, Ctrl-C ends it in order."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

from tests.cluster.network_under_test import find_base_port
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.typed import Typed, at_terminal, plain, type_line
from tests.wallet_page_client import WalletPage

NODES_COUNT = 4
ANY_FILE = r"(file://)?(/[^\s\x1b]+\.html)"


def file_named(typed: Typed) -> Path:
    """Wait until the command names a file for the browser; return it."""
    typed.expect(ANY_FILE)
    path = str(typed.match[2])
    return Path(unquote(urlsplit(path).path) if typed.match[1] else path)


def html_files(folder: Path) -> list[Path]:
    return list(folder.rglob("*.html"))


async def require_used_up(page: WalletPage) -> None:
    """See that a link, used or replaced, opens nothing."""
    try:
        assert await page.refused("POST", "/session", {"token": page.token}) == "PAGE_LINK_INVALID"
    finally:
        await page.http.close()


async def follow_links(typed: Typed, route: str) -> None:
    """Open the first link, let Enter make another, and one after it; see what each opens, and that it does so once."""
    first = await asyncio.to_thread(file_named, typed)
    assert first.stat().st_mode & 0o777 == 0o600
    used = WalletPage(first)
    async with WalletPage(first) as page:
        await page.get(route)
        assert not first.exists(), "a link that was used is gone"
        await require_used_up(used)

        typed.sendline("")
        second = await asyncio.to_thread(file_named, typed)
        replaced = WalletPage(second)
        typed.sendline("")
        third = await asyncio.to_thread(file_named, typed)
        assert third not in {first, second}
        assert not second.exists(), "a link that was replaced is gone"
        await require_used_up(replaced)
        async with WalletPage(third) as again:
            await again.get(route)
            await page.get(route)


async def test_up_shows_the_console_makes_links_by_enter_and_leaves_the_network_running(tmp_path: Path) -> None:
    folder = tmp_path / "my ward"
    line = f"exec blockrobot up --dir '{folder.name}' --base-port {find_base_port(NODES_COUNT)} --console --no-browser"
    try:
        typed = type_line(tmp_path, line, folder=tmp_path)
        await asyncio.to_thread(typed.expect, "Open this file in your browser:")
        assert "notice is not published" not in plain(str(typed.before))
        await follow_links(typed, "/api/now")
        await asyncio.to_thread(typed.expect, "Ctrl-C: end the console; the network goes on")
        typed.sendintr()
        assert await asyncio.to_thread(typed.ended) == 0, typed.rest()
        told = plain(typed.rest())
        assert "Traceback" not in told
        assert html_files(tmp_path) == []
        (step,) = re.findall(r"The console has ended; the network goes on\. See (blockrobot status.*)\.$", told)
        status = type_line(tmp_path, step, folder=tmp_path)
        assert await asyncio.to_thread(status.ended) == 0, status.rest()
        assert plain(status.rest()).count("ready") == NODES_COUNT
    finally:
        down = type_line(tmp_path, f"blockrobot down --dir '{folder.name}'", folder=tmp_path)
        await asyncio.to_thread(down.ended)
    assert "Stopped: node-1, node-2, node-3, node-4." in plain(down.rest())


async def test_a_wallet_s_page_gets_a_new_link_by_enter_and_ctrl_c_locks_the_keys(tmp_path: Path) -> None:
    network = RecordedNetwork(tmp_path)
    try:
        await network.start_unregistered()
        typed = at_terminal(tmp_path, "--profile", network.profile, "serve", "--no-browser")
        await asyncio.to_thread(typed.expect, "Passphrase: ")
        typed.sendline(network.passphrase)
        await asyncio.to_thread(typed.expect, "it works once, for two minutes:")
        await follow_links(typed, "/api/texts")
        typed.sendintr()
        await asyncio.to_thread(typed.expect, "The page is closed. Your keys are locked again.")
        assert await asyncio.to_thread(typed.ended) == 0, typed.rest()
        assert "Traceback" not in typed.rest()
        assert html_files(tmp_path) == []
    finally:
        await network.close()

"""The explorer's files: complete, small, without inline code or anything from elsewhere, and given with strict headers."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from node.api import create_api
from node.explorer.page import own_files, shared_files
from tests.unit.node.api.small_network import SmallLedger, SmallNode

PAGE_MAX_BYTES = 150 * 1024
_IMPORT = re.compile(r'(?:from|import)\s*\(?\s*"\./([^"]+)"')
_LINK = re.compile(r'(?:href|src)="\./([^"]+)"')


def text_of(name: str) -> str:
    files = shared_files() if name.startswith("shared/") else own_files()
    return files.get(name.removeprefix("shared/")).content.decode()


def needed_files() -> set[str]:
    """All that the page loads, followed from its HTML."""
    found: set[str] = set()
    waiting = {"index.html"}
    while waiting:
        name = waiting.pop()
        found.add(name)
        pattern = _LINK if name.endswith(".html") else _IMPORT
        folder = "shared/" if name.startswith("shared/") else ""
        waiting |= {folder + other for other in pattern.findall(text_of(name))} - found
    return found


@pytest.fixture
async def client() -> AsyncIterator[TestClient[web.Request, web.Application]]:
    node = SmallNode.around(await SmallLedger().start())
    async with TestClient(TestServer(create_api(node.services))) as client:
        yield client


def test_the_page_is_small_and_every_file_of_it_is_used_and_there() -> None:
    assert {name for name in needed_files() if not name.startswith("shared/")} == set(own_files().names())
    sizes = {name: len(text_of(name).encode()) for name in needed_files()}
    assert sum(sizes.values()) <= PAGE_MAX_BYTES, sizes


@pytest.mark.parametrize("name", own_files().names())
def test_no_file_holds_inline_code_or_names_another_host(name: str) -> None:
    text = text_of(name).replace("http://www.w3.org/2000/svg", "")
    assert "http://" not in text
    assert "https://" not in text
    assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|\beval\(|new Function", text)
    assert not re.search(r"localStorage|sessionStorage|document\.cookie|indexedDB", text)
    if name.endswith(".html"):
        assert not re.search(r"<script(?![^>]*\bsrc=)|\son\w+=|\sstyle=|<style", text)


async def test_every_file_of_the_page_is_served_to_anybody_with_strict_headers(
    client: TestClient[web.Request, web.Application],
) -> None:
    for name in ["", *sorted(needed_files())]:
        answer = await client.get(f"/explorer/{name}")
        assert answer.status == 200, name
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert "Set-Cookie" not in answer.headers


async def test_a_browser_gets_no_second_copy_and_the_address_without_a_slash_leads_to_the_page(
    client: TestClient[web.Request, web.Application],
) -> None:
    first = await client.get("/explorer/explorer.js")
    again = await client.get("/explorer/explorer.js", headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status, await again.read()) == (304, b"")
    other = await client.get("/explorer/explorer.js", headers={"If-None-Match": '"other"'})
    assert other.status == 200
    answer = await client.get("/explorer", allow_redirects=False)
    assert (answer.status, answer.headers["Location"]) == (308, "explorer/")
    followed = await client.get("/explorer")
    assert "BlockRobot explorer" in await followed.text()


@pytest.mark.parametrize(
    "name", ["page.py", "__init__.py", "..%2Fpage.py", "shared/..%2Fserving.py", "nothing.js", "shared/"]
)
async def test_what_is_no_file_of_the_page_is_unknown(
    name: str, client: TestClient[web.Request, web.Application]
) -> None:
    answer = await client.get(f"/explorer/{name}")
    assert (answer.status, (await answer.json())["code"]) == (404, "ROUTE_UNKNOWN")

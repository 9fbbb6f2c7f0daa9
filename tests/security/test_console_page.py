"""The cluster console breaks a network on purpose: whoever has not opened it gets nothing from it and breaks nothing."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from network.cluster import Cluster
from network.console.live import CONSOLE_ASSETS, LiveConsole
from network.console.routes import console_routes
from network.provisioning.network_layout import create_network
from pages.local_page import SESSION_HEADER, LocalPage
from pages.serving import Assets
from tests.cluster.network_under_test import find_base_port

pytestmark = pytest.mark.smoke

BODIES: dict[str, Any] = {
    "/api/faults": {"do": "restart", "node": "node-1"},
    "/api/plans": {"text": '[[step]]\nat = "0s"\ndo = "restart"\nnode = "node-1"\n'},
    "/api/plans/check": {"text": '[[step]]\nat = "0s"\ndo = "heal"\n'},
}


@dataclass
class _Console:
    """A console of a network that does not run, and what its one person holds."""

    live: LiveConsole
    page: LocalPage
    session: str

    @property
    def routes(self) -> list[tuple[str, str]]:
        return [(route.method, route.path) for route in console_routes(self.live)]

    def url(self, path: str) -> str:
        return self.page.url.rstrip("/") + path

    def is_untouched(self) -> bool:
        """Tell whether nobody has started, asked or planned anything."""
        asked = [event for event in self.live.recorder.events_after(0) if event["kind"] == "asked"]
        is_running = any(self.live.cluster.is_running(name) for name in self.live.cluster.names)
        return not asked and not is_running and self.live.now(0).plan is None


@pytest.fixture
async def console(tmp_path: Path) -> AsyncIterator[_Console]:
    folder = tmp_path / "network"
    await asyncio.to_thread(
        create_network, folder, nodes=1, organisations=1, base_port=find_base_port(1), store="sqlite", faults=True
    )
    live = LiveConsole(Cluster(folder))
    page = LocalPage(Assets(CONSOLE_ASSETS), console_routes(live), redirect_folder=tmp_path / "links", title="Console")
    opened = await page.start()
    token = re.search(r"#([\w-]+)", opened.redirect_file.read_text())
    assert token is not None
    async with (
        aiohttp.ClientSession() as http,
        http.post(page.url + "session", json={"token": token[1]}, headers={"Origin": page.url.rstrip("/")}) as response,
    ):
        session = (await response.json())["session"]
    yield _Console(live, page, session)
    await live.close()
    await page.stop()


async def _try(console: _Console, headers: dict[str, str]) -> dict[str, tuple[int, str]]:
    """Ask every route with these headers; return its status and code."""
    answers = {}
    async with aiohttp.ClientSession() as http:
        for method, path in console.routes:
            body = BODIES.get(path, {}) if method == "POST" else None
            async with http.request(method, console.url(path), json=body, headers=headers) as response:
                answer = await response.json(content_type=None)
                answers[path] = (response.status, str(answer.get("code", "")))
                assert response.headers["Cache-Control"] == "no-store"
                assert "'unsafe" not in response.headers["Content-Security-Policy"]
    return answers


async def test_no_route_answers_who_shows_no_session(console: _Console) -> None:
    own = {"Origin": console.page.url.rstrip("/")}
    guesses: list[dict[str, str]] = [
        {},
        {SESSION_HEADER: ""},
        {SESSION_HEADER: console.session[:-1]},
        {SESSION_HEADER: console.session.swapcase()},
        {"Authorization": f"Bearer {console.session}"},
        {"Cookie": f"session={console.session}; {SESSION_HEADER}={console.session}"},
    ]
    for shown in guesses:
        answers = await _try(console, {**own, **shown})
        assert set(answers.values()) == {(401, "PAGE_SESSION_REQUIRED")}
    assert console.is_untouched()


async def test_no_other_page_of_the_browser_is_answered_whatever_it_shows(console: _Console) -> None:
    shown, port = {SESSION_HEADER: console.session}, console.page.url.split(":")[2].strip("/")
    origins = (
        "null",
        "https://evil.example",
        f"http://localhost:{port}",
        f"http://127.0.0.1:{port}",
        f"https://127.0.0.1:{port}",
        "http://127.0.0.1",
    )
    for origin in origins:
        answers = await _try(console, {**shown, "Origin": origin})
        assert set(answers.values()) == {(403, "PAGE_ORIGIN_REFUSED")}
    assert console.is_untouched()


async def test_no_other_name_of_this_machine_is_answered(console: _Console) -> None:
    """A name that was rebound to 127.0.0.1 is another host, whatever it resolves to."""
    shown = {SESSION_HEADER: console.session, "Origin": console.page.url.rstrip("/")}
    port = console.page.url.split(":")[2].strip("/")
    names = (f"{name}:{port}" for name in ("localhost", "127.0.0.1", "evil.example", "[::1]", "127.0.0.1."))
    for host in ("127.0.0.1", *names):
        answers = await _try(console, {**shown, "Host": host})
        assert set(answers.values()) == {(403, "PAGE_ORIGIN_REFUSED")}
    assert console.is_untouched()


async def test_what_changes_something_needs_the_origin_even_with_a_session(console: _Console) -> None:
    answers = await _try(console, {SESSION_HEADER: console.session})
    posts = {path for method, path in console.routes if method == "POST"}
    assert {answers[path] for path in posts} == {(403, "PAGE_ORIGIN_REFUSED")}
    assert console.is_untouched()


async def test_who_opened_it_is_answered_and_refused_in_the_command_lines_words(console: _Console) -> None:
    headers = {SESSION_HEADER: console.session, "Origin": console.page.url.rstrip("/")}
    async with aiohttp.ClientSession(headers=headers) as http:
        async with http.get(console.url("/api/choices")) as response:
            assert response.status == 200
        async with http.post(console.url("/api/faults"), json={"do": "kill", "node": "node-1"}) as response:
            problem = await response.json(content_type=None)
            assert (response.status, problem["code"]) == (409, "CLUSTER_NOT_RUNNING")
            assert "`blockrobot up`" in problem["next_step"]
        for fields, code in (({"do": "kill", "node": "../x"}, "FAULT_UNKNOWN"), ({}, "FAULT_UNKNOWN")):
            async with http.post(console.url("/api/faults"), json=fields) as response:
                assert (await response.json(content_type=None))["code"] == code
        for plan in ("", "seed = 1\n[[step]]", 7, None):
            async with http.post(console.url("/api/plans"), json={"text": plan}) as response:
                answer = await response.json(content_type=None)
                assert answer["code"] in {"FAULT_PLAN_INVALID", "REQUEST_INVALID", "CLUSTER_NOT_RUNNING"}
        for query in ("after=-1", "after=x", "after=" + "9" * 16, "after=0&events=1e3", "after=²"):
            async with http.get(console.url(f"/api/now?{query}")) as response:
                assert (await response.json(content_type=None))["code"] == "REQUEST_INVALID"
        async with http.post(console.url("/api/faults"), data=b"[1]") as response:
            assert (await response.json(content_type=None))["code"] == "REQUEST_INVALID"
    assert console.is_untouched()


async def test_an_export_is_no_page_of_the_consoles_own_origin(console: _Console) -> None:
    headers = {SESSION_HEADER: console.session, "Origin": console.page.url.rstrip("/")}
    async with (
        aiohttp.ClientSession(headers=headers) as http,
        http.post(console.url("/api/export"), json={}) as response,
    ):
        text = await response.text()
        assert response.headers["Content-Type"] == "application/octet-stream"
        assert response.headers["Content-Disposition"].startswith("attachment; ")
    assert console.session not in text
    secrets = [path for path in console.live.cluster.folder.rglob("*") if path.suffix in {".key", ".token"}]
    assert secrets
    assert not [path for path in secrets if path.read_bytes().hex() in text or str(path.parent) in text]

"""Who wants into the wallet's page: other users of the machine, other pages, other names for this machine, other times.

And what the page never gives away, to nobody: words, passphrase, private keys.
"""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from pages.local_page import LINK_LIFETIME_MS
from tests.wallet_page_client import SESSION_HEADER, WalletPage, read_link
from tests.world.served import ServedWard, serve_ward
from tests.world.sharing import WEEK_MS, SharedWard

pytestmark = pytest.mark.smoke

PASSPHRASE = "tea"


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.now_ms = 0

    def __call__(self) -> int:
        return self.now_ms


@dataclass
class GuardHarness(ServedWard):
    """A recorded person's page, and the clock of its links."""

    clock: Clock

    @property
    def url(self) -> str:
        return self.served.url.rstrip("/")

    def routes(self) -> list[tuple[str, str]]:
        """Every route below /api, with something for each place."""
        found = []
        for route in self.served.app.router.routes():
            resource = route.resource
            assert resource is not None
            if resource.canonical.startswith("/api/") and route.method != "HEAD":
                found.append((route.method, resource.canonical.replace("{", "").replace("}", "")))
        return found


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[GuardHarness]:
    ward = SharedWard(tmp_path)
    ward.record_visit()
    clock = Clock()
    async with serve_ward(ward, now_ms=clock) as served:
        yield GuardHarness(ward, served.session, served.served, served.file, clock)


async def _answer(method: str, url: str, headers: dict[str, str], body: Any = None) -> tuple[int, str, Any]:
    """Return status, code and headers."""
    async with aiohttp.ClientSession() as http, http.request(method, url, headers=headers, json=body) as answer:
        told = await answer.json(content_type=None) if "json" in answer.content_type else {}
        return answer.status, told.get("code", ""), answer.headers


async def test_only_this_user_can_read_what_opens_the_page(house: GuardHarness) -> None:
    file = await house.served.new_link()
    assert file.stat().st_mode & 0o777 == 0o600
    assert file.parent.stat().st_mode & 0o777 == 0o700
    assert file.parent.is_relative_to(house.session.folder)


async def test_what_opens_the_page_works_once_and_not_for_long(house: GuardHarness) -> None:
    file = await house.served.new_link()
    origin, token = read_link(file)
    async with WalletPage(file):
        pass
    assert not file.exists()
    again = await _answer("POST", f"{origin}/session", {"Origin": origin}, {"token": token})
    assert again[:2] == (401, "PAGE_LINK_INVALID")
    origin, token = read_link(await house.served.new_link())
    house.clock.now_ms += LINK_LIFETIME_MS + 1
    late = await _answer("POST", f"{origin}/session", {"Origin": origin}, {"token": token})
    assert late[:2] == (401, "PAGE_LINK_INVALID")


async def test_no_route_answers_without_the_session(house: GuardHarness) -> None:
    routes = house.routes()
    assert len(routes) > 35
    origin = {"Origin": house.url}
    for method, path in routes:
        for headers in (origin, origin | {SESSION_HEADER: "guess"}, origin | {"Cookie": f"{SESSION_HEADER}=guess"}):
            status, code, _ = await _answer(method, f"{house.url}{path}?session=guess", headers, {})
            assert (status, code) == (401, "PAGE_SESSION_REQUIRED"), (method, path)


async def test_a_page_that_rebinds_its_name_to_this_machine_gets_nothing(house: GuardHarness) -> None:
    port = house.url.rsplit(":", 1)[1]
    async with WalletPage(await house.served.new_link()) as page:
        for host in (
            "evil.example",
            f"evil.example:{port}",
            f"localhost:{port}",
            f"127.0.0.1.evil.example:{port}",
            "127.0.0.1",
            f"127.0.0.1:{port}",
        ):
            headers = page.headers | {"Host": host}
            for path in ("/", "/api/overview", "/api/records"):
                assert (await _answer("GET", house.url + path, headers))[:2] == (403, "PAGE_ORIGIN_REFUSED")


async def test_another_page_in_the_same_browser_gets_nothing(house: GuardHarness) -> None:
    async with WalletPage(await house.served.new_link()) as page:
        port = house.url.rsplit(":", 1)[1]
        near = [f"http://{name}:{port}" for name in ("localhost", "127.0.0.1")]
        for origin in ("https://evil.example", "null", *near, f"{house.url}1"):
            headers = page.headers | {"Origin": origin}
            for method, path in (("GET", "/api/overview"), ("POST", "/api/end"), ("OPTIONS", "/api/overview")):
                status, code, given = await _answer(method, house.url + path, headers)
                assert (status, code) == (403, "PAGE_ORIGIN_REFUSED")
                assert not [name for name in given if name.lower().startswith("access-control-")]
        without = {SESSION_HEADER: page.headers[SESSION_HEADER]}
        assert (await _answer("POST", f"{house.url}/api/end", without))[:2] == (403, "PAGE_ORIGIN_REFUSED")
    assert not house.session.ended.is_set()


async def test_no_answer_is_kept_and_nothing_foreign_runs_in_the_page(house: GuardHarness) -> None:
    async with WalletPage(await house.served.new_link()) as page:
        for path in ("/api/overview", "/api/records", "/api/nothing", "/api/clips/x", "/"):
            _, _, headers = await _answer("GET", house.url + path, page.headers)
            assert headers["Cache-Control"] == "no-store", path
            assert "default-src 'none'" in headers["Content-Security-Policy"]
            assert "unsafe" not in headers["Content-Security-Policy"]
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"
            assert "Set-Cookie" not in headers


async def test_a_session_ends_with_the_page(house: GuardHarness) -> None:
    async with WalletPage(await house.served.new_link()) as page:
        house.served.end_sessions()
        assert await page.refused("GET", "/api/overview") == "PAGE_SESSION_REQUIRED"


async def test_nothing_secret_is_in_any_answer_or_log_line(
    house: GuardHarness, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    told: list[str] = []
    doctor = house.ward.come_in("doctor", "staff")
    async with WalletPage(await house.served.new_link()) as page:
        (visit,) = house.session.snapshot.visits
        ids = [entry.record_id.hex() for entry in visit.report.records]
        wish = {"records": ids[:1], "with": doctor.store.content.handle.hex(), "purpose": "care"}
        wish |= {"until_ms": house.ward.chain.time_ms + WEEK_MS, "passphrase": PASSPHRASE}
        for path, body in (
            ("/api/clips", {"records": ids}),
            ("/api/shares", wish),
            ("/api/shares", wish | {"passphrase": "a secret that was mistyped"}),
            ("/api/exports", {"now": True, "passphrase": PASSPHRASE}),
        ):
            status, answer = await page.ask("POST", path, body)
            told.append(str(answer))
            if status == 202:
                told.append(str(await page.follow(answer)))
        for method, path in house.routes():
            if method == "GET":
                told.append(str((await page.ask("GET", path))[1]))
        told += [str(await page.get(f"/api/records/{record}")) for record in ids]
    wallet, keys = house.ward.wallet, house.ward.wallet.keys
    words = wallet.store.content.words
    private = [keys.identity.secret, keys.spend.secret, keys.view.secret, keys.sealing]
    private.append(wallet.owner_key(visit.report.visit).secret)
    everything = "\n".join([*told, caplog.text])
    assert "verified" in everything
    for secret in ("a secret that was mistyped", f"'{PASSPHRASE}'", words, " ".join(words.split()[:3])):
        assert secret not in everything
    for key in private:
        assert key.hex() not in everything
        assert str(key) not in everything

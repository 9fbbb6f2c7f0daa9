"""A page for one person on this machine: its link works once, and nobody else gets anything from it."""

from __future__ import annotations

import asyncio
import base64
import io
import ipaddress
import json
import logging
import re
import stat
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import aiohttp
import pytest
from aiohttp import web

from consensus.errors import BlockRobotError
from pages import local_page
from pages.local_page import (
    FORMER_LINKS_MAX_COUNT,
    LINK_LIFETIME_MS,
    REQUEST_MAX_BYTES,
    SESSION_HEADER,
    SESSIONS_MAX_COUNT,
    LocalPage,
    LocalRoute,
    draw_loopback_address,
    read_object,
    write_redirect,
)
from pages.serving import Assets
from tests.resetting import send_and_reset

COMMAND = "my-page --profile ann"


class Clock:
    def __init__(self) -> None:
        self.ms = 1_000

    def __call__(self) -> int:
        return self.ms


async def hello(_request: web.Request) -> web.Response:
    return web.json_response({"hello": "you"})


async def refuse(_request: web.Request) -> web.Response:
    raise BlockRobotError("PURPOSE_UNKNOWN", "No such purpose.")


async def stumble(_request: web.Request) -> web.Response:
    raise RuntimeError("the secret is 4711")


async def echo(request: web.Request) -> web.Response:
    return web.json_response(await read_object(request))


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
async def page(tmp_path: Path, clock: Clock) -> AsyncIterator[LocalPage]:
    folder = tmp_path / "assets"
    folder.mkdir()
    (folder / "index.html").write_text("<!doctype html><title>mine</title>")
    routes = [
        LocalRoute("GET", "/api/hello", hello),
        LocalRoute("GET", "/api/refuse", refuse),
        LocalRoute("GET", "/api/stumble", stumble),
        LocalRoute("POST", "/api/echo", echo),
    ]
    page = LocalPage(
        Assets(folder),
        routes,
        redirect_folder=tmp_path / "links",
        title="My page",
        idle_minutes=5,
        now_ms=clock,
        command=COMMAND,
    )
    async with page:
        yield page


@pytest.fixture
async def browser() -> AsyncIterator[aiohttp.ClientSession]:
    async with aiohttp.ClientSession() as session:
        yield session


def token_of(path: Path) -> str:
    found = re.search(r"#([\w-]+)\"", path.read_text())
    assert found
    return found.group(1)


async def exchange(browser: aiohttp.ClientSession, page: LocalPage, token: Any, **headers: str) -> tuple[int, Any]:
    own = {"Origin": page.url.rstrip("/"), **headers}
    async with browser.post(f"{page.url}session", json={"token": token}, headers=own) as answer:
        return answer.status, await answer.json()


async def open_page(browser: aiohttp.ClientSession, page: LocalPage) -> dict[str, str]:
    status, answer = await exchange(browser, page, token_of(await page.new_link()))
    assert status == 200
    return {SESSION_HEADER: answer["session"]}


async def test_the_link_opens_the_page_once(page: LocalPage, browser: aiohttp.ClientSession) -> None:
    link = await page.new_link()
    token = token_of(link)
    status, answer = await exchange(browser, page, token)
    assert status == 200
    assert not link.exists()
    async with browser.get(f"{page.url}api/hello", headers={SESSION_HEADER: answer["session"]}) as said:
        assert await said.json() == {"hello": "you"}
    status, answer = await exchange(browser, page, token)
    assert (status, answer["code"]) == (401, "PAGE_LINK_INVALID")


async def test_who_has_a_link_of_this_page_used_old_or_replaced_is_told_the_command_and_nobody_else(
    page: LocalPage, browser: aiohttp.ClientSession, clock: Clock
) -> None:
    replaced, used = token_of(await page.new_link()), token_of(await page.new_link())
    assert (await exchange(browser, page, used))[0] == 200
    late = token_of(await page.new_link())
    clock.ms += LINK_LIFETIME_MS + 1
    for token in (used, replaced, late):
        status, answer = await exchange(browser, page, token)
        assert (status, answer["code"], answer["command"]) == (401, "PAGE_LINK_INVALID", COMMAND)
    for token in ("", "x" * 43, None, used[:-1], [used]):
        status, answer = await exchange(browser, page, token)
        assert (status, answer["code"]) == (401, "PAGE_LINK_INVALID")
        assert COMMAND not in str(answer)


async def test_of_links_that_open_nothing_any_more_only_the_newest_are_known(
    page: LocalPage, browser: aiohttp.ClientSession
) -> None:
    first = token_of(await page.new_link())
    second = token_of(await page.new_link())
    for _ in range(FORMER_LINKS_MAX_COUNT):
        await page.new_link()
    assert "command" not in (await exchange(browser, page, first))[1]
    assert "command" in (await exchange(browser, page, second))[1]


async def test_only_the_owner_of_the_files_can_read_the_link(page: LocalPage) -> None:
    link = await page.new_link()
    assert stat.S_IMODE(link.stat().st_mode) == 0o600
    assert stat.S_IMODE(link.parent.stat().st_mode) == 0o700


def test_no_word_in_the_file_of_a_link_is_html(tmp_path: Path) -> None:
    said = write_redirect(tmp_path, 'http://127.0.0.1/#"><b>', "<b>mine", note="<i>once").read_text()
    assert said.count("&lt;b&gt;") == 4
    assert said.count("&lt;i&gt;") == 1
    assert not re.search(r"<[bi]>", said)


async def test_a_new_link_ends_the_former(page: LocalPage, browser: aiohttp.ClientSession) -> None:
    former = await page.new_link()
    token = token_of(former)
    await page.new_link()
    assert not former.exists()
    assert (await exchange(browser, page, token))[0] == 401


async def test_a_link_that_nobody_used_expires(page: LocalPage, browser: aiohttp.ClientSession, clock: Clock) -> None:
    token = token_of(await page.new_link())
    clock.ms += LINK_LIFETIME_MS + 1
    assert (await exchange(browser, page, token))[1]["code"] == "PAGE_LINK_INVALID"


async def test_another_user_who_guesses_takes_the_link_from_nobody(
    page: LocalPage, browser: aiohttp.ClientSession
) -> None:
    """Everybody on the machine reaches the port. Some wrong words ended the link once: the person could never get in."""
    link = await page.new_link()
    token = token_of(link)
    assert len(base64.urlsafe_b64decode(token + "=")) == 32
    near = [token[:-1], token + "A", token.swapcase(), token[::-1], "", "é" * 43]
    for guess in [*near, *(f"guess {number}" for number in range(100)), None, 7, [token], {"token": token}]:
        assert (await exchange(browser, page, guess))[1]["code"] == "PAGE_LINK_INVALID"
    assert link.exists()
    assert (await exchange(browser, page, token))[0] == 200


@pytest.mark.parametrize("token", [None, 7, ["a"], "", "ü"])
async def test_what_is_no_token_is_refused(page: LocalPage, browser: aiohttp.ClientSession, token: Any) -> None:
    assert (await exchange(browser, page, token))[1]["code"] == "PAGE_LINK_INVALID"


@pytest.mark.parametrize("session", [None, "", "guess", "ü"])
async def test_no_answer_without_a_session(
    page: LocalPage, browser: aiohttp.ClientSession, session: str | None
) -> None:
    headers = {} if session is None else {SESSION_HEADER: session}
    async with browser.get(f"{page.url}api/hello", headers=headers) as said:
        assert (said.status, (await said.json())["code"]) == (401, "PAGE_SESSION_REQUIRED")


async def test_an_idle_session_ends(page: LocalPage, browser: aiohttp.ClientSession, clock: Clock) -> None:
    headers = await open_page(browser, page)
    clock.ms += 5 * 60_000
    async with browser.get(f"{page.url}api/hello", headers=headers) as said:
        assert said.status == 200
    clock.ms += 5 * 60_000 + 1
    async with browser.get(f"{page.url}api/hello", headers=headers) as said:
        assert said.status == 401


async def test_of_too_many_sessions_the_one_used_longest_ago_ends(
    page: LocalPage, browser: aiohttp.ClientSession, clock: Clock
) -> None:
    sessions = []
    for _ in range(SESSIONS_MAX_COUNT + 1):
        clock.ms += 1
        sessions.append(await open_page(browser, page))
    answers = []
    for headers in (sessions[0], sessions[1], sessions[-1]):
        async with browser.get(f"{page.url}api/hello", headers=headers) as said:
            answers.append(said.status)
    assert answers == [401, 200, 200]


async def test_another_name_for_this_machine_is_refused(page: LocalPage, browser: aiohttp.ClientSession) -> None:
    """DNS rebinding: a name of the attacker's that resolves to 127.0.0.1 reaches the port, but not under our Host."""
    headers = await open_page(browser, page)
    port = page.url.rsplit(":", 1)[1].rstrip("/")
    for host in (f"attacker.example:{port}", "127.0.0.1", f"127.0.0.1:{port}", f"localhost:{port}", ""):
        async with browser.get(f"{page.url}api/hello", headers={**headers, "Host": host}) as said:
            assert said.status in {400, 403}


async def test_no_two_runs_share_an_origin_or_have_one_that_others_may_have_had(
    page: LocalPage, tmp_path: Path
) -> None:
    """A service worker outlives the port that it was registered on: at 127.0.0.1 it would answer for the page."""
    async with LocalPage(Assets(), (), redirect_folder=tmp_path, title="x") as other:
        addresses = [ipaddress.ip_address(urlsplit(each.url).hostname or "") for each in (page, other)]
    assert addresses[0] != addresses[1]
    drawn = {ipaddress.ip_address(draw_loopback_address()) for _ in range(1_000)} | set(addresses)
    assert len(drawn) > 900
    assert all(each.is_loopback for each in drawn)
    assert not [each for each in drawn if each in ipaddress.ip_network("127.0.0.0/24")]


async def test_where_127_0_0_1_is_all_there_is_each_run_has_a_name_of_its_own(
    tmp_path: Path, browser: aiohttp.ClientSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local_page, "draw_loopback_address", lambda: "192.0.2.1")  # nobody can listen there
    hosts = []
    for _ in range(2):
        async with LocalPage(
            Assets(), [LocalRoute("GET", "/api/hello", hello)], redirect_folder=tmp_path, title="x"
        ) as page:
            where = urlsplit(page.url)
            hosts.append(where.hostname or "")
            reached = f"http://127.0.0.1:{where.port}/api/hello"
            codes = []
            for host in (where.netloc, f"127.0.0.1:{where.port}", f"localhost:{where.port}", f"x.{where.netloc}"):
                async with browser.get(reached, headers={"Host": host}) as said:
                    codes.append((await said.json())["code"])
            assert codes == ["PAGE_SESSION_REQUIRED", *["PAGE_ORIGIN_REFUSED"] * 3]
            assert local_page.NAME_NOTE in (await page.new_link()).read_text()
    assert hosts[0] != hosts[1]
    assert all(re.fullmatch(r"[0-9a-f]{32}\.localhost", host) for host in hosts)


async def test_another_page_is_refused(page: LocalPage, browser: aiohttp.ClientSession) -> None:
    headers = await open_page(browser, page)
    token = token_of(await page.new_link())
    for origin in ("https://attacker.example", "null", f"{page.url}x", "http://127.0.0.1:1"):
        assert (await exchange(browser, page, token, Origin=origin))[1]["code"] == "PAGE_ORIGIN_REFUSED"
        async with browser.get(f"{page.url}api/hello", headers={**headers, "Origin": origin}) as said:
            assert said.status == 403
            assert "Access-Control-Allow-Origin" not in said.headers
    async with browser.post(f"{page.url}api/echo", json={}, headers=headers) as said:
        assert said.status == 403


async def test_nothing_of_it_is_kept_by_a_browser(page: LocalPage, browser: aiohttp.ClientSession) -> None:
    for path in ("", "shared/design.css", "api/hello", "nothing"):
        async with browser.get(f"{page.url}{path}") as said:
            assert said.headers["Cache-Control"] == "no-store"
            assert "default-src 'none'" in said.headers["Content-Security-Policy"]
            assert "worker-src 'none'" in said.headers["Content-Security-Policy"]
            assert "Service-Worker-Allowed" not in said.headers
            assert "Set-Cookie" not in said.headers


async def test_a_refusal_is_told_with_its_code_and_next_step(page: LocalPage, browser: aiohttp.ClientSession) -> None:
    headers = await open_page(browser, page)
    async with browser.get(f"{page.url}api/refuse", headers=headers) as said:
        problem = await said.json(content_type="application/problem+json")
    assert (said.status, problem["code"], problem["detail"]) == (400, "PURPOSE_UNKNOWN", "No such purpose.")
    assert problem["next_step"]


async def test_an_unforeseen_fault_is_told_and_logged_without_its_words(
    page: LocalPage, browser: aiohttp.ClientSession, caplog: pytest.LogCaptureFixture
) -> None:
    headers = await open_page(browser, page)
    with caplog.at_level(logging.DEBUG):
        async with browser.get(f"{page.url}api/stumble", headers=headers) as said:
            answer = await said.text()
    assert said.status == 500
    assert "4711" not in answer
    assert "RuntimeError" in caplog.text
    assert headers[SESSION_HEADER] not in caplog.text
    assert "4711" not in caplog.text


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"[]", 400),
        (b"{", 400),
        (b"[" * 100_000, 400),
        (bytes(REQUEST_MAX_BYTES), 400),
        (bytes(REQUEST_MAX_BYTES + 1), 413),
    ],
)
async def test_a_body_that_is_no_object_is_refused(
    page: LocalPage, browser: aiohttp.ClientSession, body: bytes, code: int
) -> None:
    headers = {**await open_page(browser, page), "Origin": page.url.rstrip("/"), "Content-Type": "application/json"}
    async with browser.post(f"{page.url}api/echo", data=io.BytesIO(body), headers=headers) as said:
        assert said.status == code


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (b"POST /session HTTP/1.1\r\n", b'{"token": "\\ud800"}'),
        (b"POST /session HTTP/1.1\r\n", b'{"token": 1, "\\udfff": 2}'),
        (b"POST /session HTTP/1.1\r\n", b'{"token": "\xff"}'),
        (b"POST /session HTTP/1.1\r\nContent-Type: application/json; charset=none\r\n", b'{"token": "x"}'),
        (b"POST /api/echo HTTP/1.1\r\nX-BlockRobot-Session: \xff\r\n", b"{}"),
        (b"GET /api/hello HTTP/1.1\r\nX-BlockRobot-Session: \xed\xa0\x80\r\n", b""),
        (b"GET /%ff%ed%a0%80 HTTP/1.1\r\n", b""),
        (b"GET /?x=%ed%a0%80 HTTP/1.1\r\nX-Other: \x80\r\n", b""),
    ],
)
async def test_half_a_character_is_refused_with_a_code(page: LocalPage, head: bytes, body: bytes) -> None:
    host = page.url.removeprefix("http://").strip("/").encode()
    where = urlsplit(page.url)
    reader, writer = await asyncio.open_connection(where.hostname, where.port)
    lines = b"Host: %b\r\nOrigin: http://%b\r\nConnection: close\r\nContent-Length: %d\r\n\r\n" % (
        host,
        host,
        len(body),
    )
    writer.write(head + lines + body)
    answer = await reader.read()
    writer.close()
    assert 400 <= int(answer.split()[1]) < 500, answer
    assert json.loads(answer.partition(b"\r\n\r\n")[2])["code"] in {"REQUEST_INVALID", "ROUTE_UNKNOWN"}


async def test_a_client_that_resets_its_connection_writes_no_line(
    page: LocalPage, caplog: pytest.LogCaptureFixture
) -> None:
    host = page.url.removeprefix("http://").strip("/")
    head = f"POST /session HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
    await send_and_reset(urlsplit(page.url).port, head.encode(), urlsplit(page.url).hostname or "")
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.INFO] == []


async def test_who_is_done_leaves_nothing(page: LocalPage, browser: aiohttp.ClientSession) -> None:
    link = await page.new_link()
    await page.stop()
    assert not link.exists()
    with pytest.raises(aiohttp.ClientConnectionError):
        await browser.get(page.url)


def test_a_route_that_no_session_guards_cannot_be_made(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="/open"):
        LocalPage(Assets(), [LocalRoute("GET", "/open", hello)], redirect_folder=tmp_path, title="x")

"""A page for one person on this machine: wallet page, cluster console, explorer.

Loopback only, at an origin that nothing had before: a service worker outlives the server that registered it. Requires
exact Host (DNS rebinding), Origin, and a one-time secret from a 0600 file.
"""

from __future__ import annotations

import asyncio
import hmac
import html
import json
import logging
import os
import secrets
import socket
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any

from aiohttp import web

from consensus.errors import BlockRobotError
from pages.listening import awaiting_body, open_listener, serve, share_of_descriptors
from pages.serving import PAGES_ASSETS, SECURITY_HEADERS, Assets, is_client_gone

LOOPBACK = "127.0.0.1"
SESSION_HEADER = "X-BlockRobot-Session"
TOKEN_BYTES = 32
LINK_LIFETIME_MS = 120_000
SESSIONS_MAX_COUNT = 8
FORMER_LINKS_MAX_COUNT = 64
REQUEST_MAX_BYTES = 1 << 20
CONNECTIONS_MAX_COUNT = 64
"""Any user of the machine can connect; a browser opens a few."""
BODY_TIMEOUT_MS = 30_000
STOP_MS = 1_000
_DESCRIPTORS_PART = 4
PROBLEM_TYPE = "application/problem+json"

_log = logging.getLogger("pages.local")
_SAFE_METHODS = frozenset({"GET", "HEAD"})
LINK_NOTE = "This link works once."
NAME_NOTE = (
    "If the browser cannot find the page: Safari knows no address below localhost. Open this in Firefox or Chrome."
)
NAME_READ_S = 8  # so long the link waits, for that sentence to be read
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
Describe = Callable[[BlockRobotError], tuple[str, str]]
"""What happened and the next step, in the language of who opens the page."""


def describe_plainly(error: BlockRobotError) -> tuple[str, str]:
    """Return what happened and the next step from the catalogue."""
    return error.detail, error.next_step


@dataclass(frozen=True, slots=True)
class LocalRoute:
    """A local page's route; the path begins with `/api/`, and a session is required."""

    method: str
    path: str
    handler: Handler


@dataclass(frozen=True, slots=True)
class Opened:
    """Where a local page is; the file opens it once."""

    url: str
    redirect_file: Path


class LocalPage:
    """A local page for the user who started it; `start`/`stop` or `async with`.

    `idle_minutes` without request end sessions (0: never). `now_ms` is monotonic. `command` reopens the page, shown
    only to link holders.
    """

    def __init__(
        self,
        assets: Assets,
        routes: Iterable[LocalRoute],
        *,
        redirect_folder: Path,
        title: str,
        idle_minutes: int = 0,
        now_ms: Callable[[], int] = lambda: time.monotonic_ns() // 1_000_000,
        language: str = "en",
        link_note: str = LINK_NOTE,
        name_note: str = NAME_NOTE,
        describe: Describe = describe_plainly,
        command: str = "",
        allow_camera: bool = False,
    ) -> None:
        self._assets = assets
        self._shared = Assets(PAGES_ASSETS)
        self._folder = redirect_folder
        self._title = title
        self._language = language
        self._link_note = link_note
        self._name_note = name_note
        self._describe = describe
        self._command = command
        self._idle_ms = idle_minutes * 60_000
        self._now_ms = now_ms
        self._sessions: dict[str, int] = {}
        self._link: _Link | None = None
        self._former: deque[str] = deque(maxlen=FORMER_LINKS_MAX_COUNT)
        self._stack = AsyncExitStack()
        self._origin = ""
        self._headers = {**LOCAL_HEADERS, **(_CAMERA_HEADER if allow_camera else {})}
        self.app = web.Application(client_max_size=REQUEST_MAX_BYTES, middlewares=[self._guard])
        self.app.router.add_get("/", self._index)
        self.app.router.add_post("/session", self._exchange)
        self.app.router.add_get("/shared/{name:.+}", self._shared_file)
        for route in routes:
            if not route.path.startswith("/api/"):
                raise ValueError(f"{route.path} does not begin with /api/")
            self.app.router.add_route(route.method, route.path, route.handler)
        self.app.router.add_get("/{name:.+}", self._file)

    async def __aenter__(self) -> LocalPage:
        await self.start()
        return self

    async def __aexit__(self, *exception: object) -> None:
        await self.stop()

    @property
    def url(self) -> str:
        return f"{self._origin}/"

    async def start(self) -> Opened:
        """Listen, and write the first link. Raises OSError."""
        listener, host = _listen_at_fresh_origin(draw_loopback_address())
        max_count = share_of_descriptors(CONNECTIONS_MAX_COUNT, _DESCRIPTORS_PART)
        await self._stack.enter_async_context(serve(self.app, listener, max_count, STOP_MS))
        self._origin = f"http://{host}:{listener.getsockname()[1]}"
        return Opened(url=self.url, redirect_file=await self.new_link())

    async def stop(self) -> None:
        self._sessions.clear()
        await self._drop_link()
        await self._stack.aclose()

    async def new_link(self) -> Path:
        """Write a new redirect file, invalidating the former; return its path."""
        await self._drop_link()
        token = secrets.token_urlsafe(TOKEN_BYTES)
        target = f"{self._origin}/#{token}"
        is_named = ".localhost:" in self._origin
        path = await asyncio.to_thread(
            write_redirect,
            self._folder,
            target,
            self._title,
            language=self._language,
            note=f"{self._link_note} {self._name_note}" if is_named else self._link_note,
            wait_s=NAME_READ_S if is_named else 0,
        )
        self._link = _Link(token, path, self._now_ms() + LINK_LIFETIME_MS)
        return path

    def end_sessions(self) -> None:
        self._sessions.clear()

    async def _drop_link(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            self._former.append(link.token)
            await asyncio.to_thread(link.path.unlink, missing_ok=True)

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            _require_unicode(request)
            self._require_own_page(request)
            if request.path.startswith("/api/"):
                self._require_session(request)
            response = await handler(request)
        except BlockRobotError as error:
            response = problem_response(error, self._describe)
        except web.HTTPException as error:
            code = {404: "ROUTE_UNKNOWN", 405: "METHOD_NOT_ALLOWED", 413: "REQUEST_TOO_LARGE"}.get(error.status)
            response = problem_response(BlockRobotError(code or "REQUEST_INVALID"), self._describe)
        except Exception as error:  # noqa: BLE001 - whatever fails, the page gets words and the log gets the rest
            if is_client_gone(request, error):
                _log.debug("client gone in %s", request.match_info.route.resource)
                return web.Response()
            _log.error("unexpected fault in %s: %s", request.match_info.route.resource, type(error).__name__)
            response = problem_response(BlockRobotError("INTERNAL"), self._describe)
        if not response.prepared:
            response.headers.update(self._headers)
        return response

    def _require_own_page(self, request: web.Request) -> None:
        if request.headers.get("Host", "") != self._origin.removeprefix("http://"):
            raise BlockRobotError("PAGE_ORIGIN_REFUSED", "The request names another host than this page's own address.")
        origin = request.headers.get("Origin")
        if origin != self._origin and (origin is not None or request.method not in _SAFE_METHODS):
            raise BlockRobotError("PAGE_ORIGIN_REFUSED")

    def _require_session(self, request: web.Request) -> None:
        now = self._now_ms()
        given = request.headers.get(SESSION_HEADER, "")
        for session, last_ms in list(self._sessions.items()):
            if self._idle_ms and now - last_ms > self._idle_ms:
                del self._sessions[session]
            elif hmac.compare_digest(session.encode(), given.encode()):
                self._sessions[session] = now
                return
        raise BlockRobotError("PAGE_SESSION_REQUIRED")

    async def _exchange(self, request: web.Request) -> web.Response:
        body = await read_object(request)
        given = body.get("token")
        if not isinstance(given, str):
            raise BlockRobotError("PAGE_LINK_INVALID")
        link = self._link
        # Wrong ones cost the link nothing: of 256 bits nobody guesses any part, and any user of the machine can try.
        if link is None or not _is_same(link.token, given) or self._now_ms() > link.ends_ms:
            known = [*self._former, link.token] if link is not None else self._former
            was_ours = any(_is_same(token, given) for token in known)
            raise BlockRobotError("PAGE_LINK_INVALID", **({"command": self._command} if was_ours else {}))
        await self._drop_link()
        session = secrets.token_urlsafe(TOKEN_BYTES)
        if len(self._sessions) >= SESSIONS_MAX_COUNT:
            self._sessions.pop(min(self._sessions, key=lambda known: self._sessions[known]))
        self._sessions[session] = self._now_ms()
        return web.json_response({"session": session})

    async def _index(self, request: web.Request) -> web.Response:
        return self._assets.response("index.html", request.headers)

    async def _shared_file(self, request: web.Request) -> web.Response:
        return self._shared.response(request.match_info["name"], request.headers)

    async def _file(self, request: web.Request) -> web.Response:
        return self._assets.response(request.match_info["name"], request.headers)


LOCAL_HEADERS = {**SECURITY_HEADERS, "Cache-Control": "no-store"}
_CAMERA_HEADER = {
    "Permissions-Policy": SECURITY_HEADERS["Permissions-Policy"].replace("camera=()", "camera=(self)"),
}


def draw_loopback_address() -> str:
    """Return one of the 2^24 addresses of 127.0.0.0/8, but none of the blocks 127.0.0 and 127.255.255."""
    return str(IPv4Address("127.0.1.0") + secrets.randbelow((1 << 24) - 512))


def _listen_at_fresh_origin(address: str) -> tuple[socket.socket, str]:
    """Return a listener and its host name. Raises OSError.

    Linux has all of 127.0.0.0/8, macOS 127.0.0.1 alone; Firefox and Chrome resolve every name below localhost themselves,
    Safari does not. Both make secure contexts (W3C Secure Contexts, 3.1), so the camera works.
    """
    try:
        return open_listener(address, 0), address
    except OSError:
        return open_listener(LOOPBACK, 0), f"{secrets.token_hex(16)}.localhost"


def _require_unicode(request: web.Request) -> None:
    """Raise REQUEST_INVALID for surrogates in the request's head."""
    for text in (request.path, request.query_string, *request.headers.values()):
        _require_whole(text)


def _require_whole(text: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError:
        raise BlockRobotError("REQUEST_INVALID", "The request holds half of a character.") from None


def _is_same(token: str, given: str) -> bool:
    return hmac.compare_digest(token.encode(), given.encode())


@dataclass(slots=True)
class _Link:
    token: str
    path: Path
    ends_ms: int


def problem_response(error: BlockRobotError, describe: Describe = describe_plainly) -> web.Response:
    """Return a problem document (RFC 9457) with code and next step."""
    detail, next_step = describe(error)
    document = {
        "type": f"urn:blockrobot:error:{error.code}",
        "title": error.entry.meaning,
        "status": error.entry.status,
        "code": error.code,
        "detail": detail,
        "next_step": next_step,
        "retryable": error.entry.retryable,
    }
    if error.context.get("command"):
        document["command"] = error.context["command"]
    return web.Response(status=error.entry.status, body=json.dumps(document).encode(), content_type=PROBLEM_TYPE)


async def read_object(request: web.Request) -> dict[str, Any]:
    """Return a request's JSON object.

    Raises REQUEST_INVALID, REQUEST_TOO_LARGE, REQUEST_TIMEOUT.
    """
    try:
        with awaiting_body(request):
            async with asyncio.timeout(BODY_TIMEOUT_MS / 1000):
                body = await request.json()
        _require_whole(json.dumps(body, ensure_ascii=False))
    except TimeoutError:
        raise BlockRobotError("REQUEST_TIMEOUT") from None
    except (ValueError, LookupError, RecursionError):
        raise BlockRobotError("REQUEST_INVALID", "The request's body is no JSON.") from None
    if not isinstance(body, dict):
        raise BlockRobotError("REQUEST_INVALID", "The request's body is no JSON object.")
    return body


def write_redirect(
    folder: Path, target: str, title: str, *, language: str = "en", note: str = LINK_NOTE, wait_s: int = 0
) -> Path:
    """Write the redirect file to `target`, readable only by its owner; return its path."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    path = folder / f"open-{secrets.token_hex(8)}.html"
    address, words, note_text = html.escape(target, quote=True), html.escape(title), html.escape(note)
    text = (
        f'<!doctype html><html lang="{language}"><meta charset="utf-8"><title>{words}</title>'
        f'<meta name="referrer" content="no-referrer"><meta http-equiv="refresh" content="{wait_s}; url={address}">'
        f'<p><a href="{address}">{words}</a>. {note_text}</p></html>\n'
    )
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text)
    return path

"""Pages that are watched: what a browser complains of, and every request that leaves this machine, is a fault."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal
from urllib.parse import urlsplit

from playwright.async_api import Browser, BrowserContext, ConsoleMessage, Page, Request

WIDE = (1280, 900)
NARROW = (390, 844)
ZOOMED = (320, 640)
"""1280 pixels at 400 % (WCAG 2.2, 1.4.10)."""
OWN_HOST = re.compile(r"127\.[0-9.]+|([0-9a-f]+\.)?localhost")
OWN_SCHEMES = {"about", "blob", "data", "file"}
TIMEOUT_MS = 15_000
SERVER_ENDED = "ERR_(CONNECTION|EMPTY_RESPONSE|SOCKET|INCOMPLETE|CONTENT_LENGTH)"
"""What the browser complains of where a server ends: by the moment at which it does, each of these."""

# A page's own complaints about its policy come as console errors too; this catches those of a policy in report mode.
_WATCH_POLICY = """
document.addEventListener('securitypolicyviolation', (event) => {
  console.error(`securitypolicyviolation: ${event.violatedDirective} ${event.blockedURI}`);
});
"""


_MOVE = """(place) => new Promise((moved) => {
  if (location.hash === place) { moved(); return; }
  addEventListener('hashchange', moved, {once: true});
  location.hash = place;
})"""


async def move_to(page: Page, place: str) -> None:
    """Go to a place of the page, as a link to it does; return once the page knows of it, and is shown or busy.

    An address that has changed is told to the page a moment later: until then the view before it looks finished.
    """
    await page.evaluate(_MOVE, f"#/{place}")


@dataclass
class Watch:
    """What was complained of in a test's pages. A story says beforehand what it brings about itself: `expect`."""

    faults: list[str] = field(default_factory=list)
    _expected: list[re.Pattern[str]] = field(default_factory=list)

    def expect(self, pattern: str) -> None:
        """Take complaints that match for expected: `watch.expect("status of 403")` where a refusal is the story."""
        self._expected.append(re.compile(pattern))

    def unexpected(self) -> list[str]:
        """Return what nobody expected."""
        return [fault for fault in self.faults if not any(pattern.search(fault) for pattern in self._expected)]

    def follow(self, page: Page) -> None:
        """Listen to a page."""
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.faults.append(f"page error: {error}"))
        page.on("crash", lambda _: self.faults.append("the page crashed"))

    def on_request(self, request: Request) -> None:
        """Take notice of a request that leaves this machine."""
        where = urlsplit(request.url)
        if where.scheme not in OWN_SCHEMES and not OWN_HOST.fullmatch(where.hostname or ""):
            self.faults.append(f"request to {request.url}")

    def _on_console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            place = message.location.get("url", "") if message.location else ""
            self.faults.append(f"console error: {message.text} ({place})")


class Pages:
    """Opens watched pages, each in a browser context of its own, and closes them all."""

    def __init__(self, browser: Browser, watch: Watch) -> None:
        self._browser = browser
        self._watch = watch
        self._contexts: list[BrowserContext] = []

    async def open(
        self,
        size: tuple[int, int] = WIDE,
        *,
        color_scheme: Literal["light", "dark"] = "light",
        locale: str = "en-GB",
        has_touch: bool = False,
    ) -> Page:
        """Return an empty page. `size` is width and height in CSS pixels, as in `WIDE` and `NARROW`."""
        context = await self._browser.new_context(
            viewport={"width": size[0], "height": size[1]},
            color_scheme=color_scheme,
            locale=locale,
            has_touch=has_touch,
            timezone_id="Europe/Berlin",
            reduced_motion="reduce",
        )
        self._contexts.append(context)
        context.set_default_timeout(TIMEOUT_MS)
        await context.add_init_script(_WATCH_POLICY)
        context.on("request", self._watch.on_request)
        context.on("page", self._watch.follow)
        return await context.new_page()

    async def close(self) -> None:
        """Close every context."""
        for context in self._contexts:
            await context.close()

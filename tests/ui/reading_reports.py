"""Opens a report in Chromium as its reader does: light and dark, wide and narrow, and on paper with every picture."""

from __future__ import annotations

import base64
import re
import zlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import cv2
import numpy as np
from playwright.async_api import Page, async_playwright

from tests.ui.accessible import find_accessibility_faults
from tests.ui.chromium import open_chromium
from tests.ui.screenshots import FOLDER, shoot_all_ways
from tests.ui.watched_page import NARROW, WIDE, ZOOMED, Pages, Watch

A4_PX = (690, 1000)
"""A4 without its margins, in CSS pixels."""
_PICTURE_IN_PAGE = re.compile(r'<img [^>]*src="data:image/png;base64,([^"]+)"')
_PICTURE_IN_PDF = re.compile(rb"/Subtype\s*/Image\b[^<>]*?/Filter\s*/FlateDecode[^<>]*?/Length (\d+)>>\s*stream\r?\n")
_BROKEN = "() => [...document.images].filter((one) => !one.complete || !one.naturalWidth).map((one) => one.alt)"
_CUT_OFF = """() => [...document.querySelectorAll('table, svg, img, figure')].filter((one) =>
  one.getBoundingClientRect().right > innerWidth + 1).map((one) => one.outerHTML.slice(0, 80))"""
_PAPER = "() => getComputedStyle(document.documentElement).backgroundColor"


@asynccontextmanager
async def watched_page() -> AsyncIterator[Page]:
    """A page in a browser of its own, for tests outside this folder; afterwards nobody may have complained."""
    watch = Watch()
    async with async_playwright() as playwright, open_chromium(playwright) as browser:
        pages = Pages(browser, watch)
        yield await pages.open()
        await pages.close()
    assert watch.unexpected() == []


async def look_all_ways(page: Page, report: Path, name: str) -> None:
    """Open a report light and dark, wide and narrow, and let the judge walk through it each time."""
    await page.goto(report.as_uri())
    for scheme in ("light", "dark"):
        await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        assert await find_accessibility_faults(page) == []
        for width, height in (ZOOMED, NARROW):
            await page.set_viewport_size({"width": width, "height": height})
            assert await find_accessibility_faults(page, by_keyboard=scheme == "light") == []
        await page.set_viewport_size({"width": WIDE[0], "height": WIDE[1]})
    assert await page.evaluate(_BROKEN) == [], "every picture can be seen"
    await shoot_all_ways(page, name)


async def print_on_a4(page: Page, report: Path, name: str) -> int:
    """Print a report from a dark screen; nothing may be cut off, no picture be missing. Returns the count of sheets."""
    await page.emulate_media(color_scheme="dark")
    await page.goto(report.as_uri())
    FOLDER.mkdir(parents=True, exist_ok=True)
    printed = await page.pdf(path=FOLDER / f"{name}.pdf", format="A4", prefer_css_page_size=True)
    assert printed.startswith(b"%PDF")
    assert pictures_in(report) <= pictures_on(printed), "every picture is on paper, each pixel of it"
    await page.emulate_media(media="print", color_scheme="light")
    await page.set_viewport_size({"width": A4_PX[0], "height": A4_PX[1]})
    assert await page.evaluate(_CUT_OFF) == []
    assert await page.locator("nav").is_hidden(), "contents are no use on paper"
    assert await page.evaluate(_PAPER) == "rgb(255, 255, 255)"
    return len(re.findall(rb"/Type\s*/Page\b", printed))


def pictures_in(report: Path) -> set[bytes]:
    """Return the pixels of every picture in a report, three bytes each."""
    encoded = _PICTURE_IN_PAGE.findall(report.read_text(encoding="utf-8"))
    return {_pixels(base64.b64decode(data)) for data in encoded}


def _pixels(png: bytes) -> bytes:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB).tobytes()


def pictures_on(printed: bytes) -> set[bytes]:
    """Return the pixels of every picture in what Chromium printed."""
    found = _PICTURE_IN_PDF.finditer(printed)
    return {zlib.decompress(printed[one.end() : one.end() + int(one[1])]) for one in found}

"""Pictures of pages, kept in build/screenshots/ for people to look at."""

from __future__ import annotations

from pathlib import Path

from playwright.async_api import Page

from tests.ui.watched_page import NARROW, WIDE

FOLDER = Path(__file__).resolve().parents[2] / "build" / "screenshots"


async def shoot(page: Page, name: str, *, full_page: bool = True) -> Path:
    """Take a picture of a page as it is; return where it lies."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / f"{name}.png"
    await page.screenshot(path=path, full_page=full_page, animations="disabled", scale="css")
    return path


async def shoot_all_ways(page: Page, name: str) -> list[Path]:
    """Take a page light and dark, wide and narrow: NAME-light-wide.png and so on. Leaves it light and wide."""
    taken = []
    for scheme in ("dark", "light"):
        await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        for width_name, (width, height) in (("narrow", NARROW), ("wide", WIDE)):
            await page.set_viewport_size({"width": width, "height": height})
            taken.append(await shoot(page, f"{name}-{scheme}-{width_name}"))
    return taken

"""Pictures of pages, kept in build/screenshots/ for people to look at, or made small for the documentation."""

from __future__ import annotations

from pathlib import Path

from PIL import Image
from playwright.async_api import Page

from tests.ui.watched_page import NARROW, WIDE

FOLDER = Path(__file__).resolve().parents[2] / "build" / "screenshots"
COLOURS_COUNT = 256
HEIGHT_MAX_PX = 1_240


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


async def shoot_for_docs(page: Page, folder: Path, name: str, height_max_px: int = HEIGHT_MAX_PX) -> None:
    """Take a page all four ways as small files, FOLDER/NAME-light-wide.png and so on, in a folder that is there."""
    for scheme in ("dark", "light"):
        await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        for width_name, (width, height) in (("narrow", NARROW), ("wide", WIDE)):
            await page.set_viewport_size({"width": width, "height": height})
            path = folder / f"{name}-{scheme}-{width_name}.png"
            tall = min(height_max_px, await page.evaluate("() => document.documentElement.scrollHeight"))
            clip = {"x": 0, "y": 0, "width": width, "height": max(height, tall)}
            await page.screenshot(path=path, full_page=True, clip=clip, animations="disabled", scale="css")
            with Image.open(path) as taken:
                taken.convert("RGB").quantize(COLOURS_COUNT, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
                    path, optimize=True
                )

"""A page's own scripts in an empty page, without the program that serves them: what a script decides by itself."""

from __future__ import annotations

from pathlib import Path

from playwright.async_api import Page, Route

from pages.serving import PAGES_ASSETS

ORIGIN = "http://localhost"
_SHARED = "shared/"


async def open_scripts(page: Page, folder: Path) -> None:
    """Open an empty page beside the modules of `folder`; `import('./name.js')` there finds them and the shared ones."""

    async def serve(route: Route) -> None:
        name = route.request.url.removeprefix(f"{ORIGIN}/page/")
        if not name:
            await route.fulfill(content_type="text/html", body='<!doctype html><html lang="en"><title>Scripts</title>')
            return
        is_shared = name.startswith(_SHARED)
        path = PAGES_ASSETS / name.removeprefix(_SHARED) if is_shared else folder / name
        await route.fulfill(content_type="text/javascript", body=path.read_text(encoding="utf-8"))

    await page.route(f"{ORIGIN}/page/**", serve)
    await page.goto(f"{ORIGIN}/page/")

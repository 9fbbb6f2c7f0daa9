r"""Makes docs/pictures/report/NAME-*.png of reports that real runs left. Must never retouch a picture.

Run it from the root of the repository, after `make demo` and `blockrobot experiment run all --out results`:
.venv/bin/python -m tests.ui.picture_reports demo=blockrobot-demo/report.html \
    experiment=results/experiment-1/report.html experiments=results/report.html
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from playwright.async_api import async_playwright

from tests.ui.chromium import open_chromium
from tests.ui.screenshots import HEIGHT_MAX_PX, shoot_for_docs
from tests.ui.watched_page import Pages, Watch

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "report"


async def take_from_disk(named: dict[str, Path], folder: Path, height_max_px: int = HEIGHT_MAX_PX) -> None:
    """Open each file as a reader does, from disk, and take its picture all ways: FOLDER/NAME-light-wide.png and so on."""
    async with async_playwright() as playwright, open_chromium(playwright) as browser:
        pages = Pages(browser, Watch())
        for name, report in named.items():
            page = await pages.open()
            await page.goto(report.as_uri())
            await shoot_for_docs(page, folder, name, height_max_px)
        await pages.close()


if __name__ == "__main__":
    if not sys.argv[1:]:
        sys.exit("Name reports: demo=FILE experiment=FILE experiments=FILE")
    FOLDER.mkdir(parents=True, exist_ok=True)
    named = {name: Path(path).resolve() for name, _, path in (word.partition("=") for word in sys.argv[1:])}
    asyncio.run(take_from_disk(named, FOLDER))

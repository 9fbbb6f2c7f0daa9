"""Makes docs/pictures/report/NAME-*.png of reports that real runs left. Must never retouch a picture.

Run it from the root of the repository, after `make demo` and `blockrobot experiment run 1 --out results`:
.venv/bin/python -m tests.ui.picture_reports demo=blockrobot-demo/report.html experiment=results/experiment-1/report.html
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from playwright.async_api import async_playwright

from tests.ui.chromium import open_chromium
from tests.ui.screenshots import shoot_for_docs
from tests.ui.watched_page import Pages, Watch

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "report"


async def main(named: dict[str, Path]) -> int:
    """Take a picture of each report all ways."""
    async with async_playwright() as playwright, open_chromium(playwright) as browser:
        pages = Pages(browser, Watch())
        for name, report in named.items():
            page = await pages.open()
            await page.goto(report.as_uri())
            await shoot_for_docs(page, FOLDER, name)
        await pages.close()
    return 0


if __name__ == "__main__":
    if not sys.argv[1:]:
        sys.exit("Name reports: demo=FILE experiment=FILE")
    FOLDER.mkdir(parents=True, exist_ok=True)
    named = {name: Path(path).resolve() for name, _, path in (word.partition("=") for word in sys.argv[1:])}
    sys.exit(asyncio.run(main(named)))

"""Pictures of pages are there in all four ways, and the gallery shows each of them."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures"
WAYS = ("light-wide", "dark-wide", "light-narrow", "dark-narrow")
PAGES = ("page", "explorer", "console", "report")


def test_the_gallery_shows_every_picture_of_a_page_and_each_page_in_all_four_ways() -> None:
    there = {path.relative_to(FOLDER).as_posix() for page in PAGES for path in (FOLDER / page).glob("*.png")}
    views = {re.sub(f"({'|'.join(WAYS)}).png$", "", name) for name in there}
    assert {folder for folder, _, _ in (view.partition("/") for view in views)} == set(PAGES)
    assert there == {f"{view}{way}.png" for view in views for way in WAYS}
    shown = re.findall(r"\]\(([^)]+\.png)\)", (FOLDER / "README.md").read_text(encoding="utf-8"))
    assert sorted(shown) == sorted(there)

"""A guardian's sheet as she sees it before she prints it, and on paper: one page, whatever her name and her language."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest
from playwright.async_api import Page

from clients.wallet.presentation.guardian_sheets import build_sheet, read_written, write_sheets
from clients.wallet.presentation.translations import choose_language
from clients.wallet.recovery.slip39_shares import split_mnemonic, tokenize_words
from clients.wallet.store.keystore import GuardianSet
from tests.ui.accessible import find_accessibility_faults
from tests.ui.watched_page import NARROW

WORDS = " ".join(["abandon"] * 23 + ["art"])
LONGEST = "Wilhelmine-Charlotte von und zu Guttenbe"
_PDF_PAGE = re.compile(rb"/Type\s*/Page\b(?!s)")


def sheet_of(folder: Path, name: str, language: str, count: int) -> tuple[Path, str]:
    names = [*(f"Guardian {number}" for number in range(1, count)), name]
    made = GuardianSet(1_800_000_000_000, count // 2 + 1, names, 4711, 0)
    shares = split_mnemonic(WORDS, made.threshold, count)
    with click.Context(click.Command("wallet")) as context:
        choose_language(context, language)
        return write_sheets(folder, made, shares)[-1], shares[-1]


@pytest.mark.parametrize("language", ["en", "pt"])
async def test_a_sheet_is_readable_by_everybody_and_fits_on_one_page(page: Page, tmp_path: Path, language: str) -> None:
    file, share = sheet_of(tmp_path, LONGEST, language, 16)
    await page.goto(file.as_uri())
    assert await page.get_by_role("heading", level=1).inner_text() in {
        f"Guardian's words for {LONGEST}",
        f"Palavras de guardião de {LONGEST}",
    }
    shown = await page.locator("#words li").all_inner_texts()
    assert shown == share.split()
    for scheme in ("light", "dark"):
        await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        assert await find_accessibility_faults(page) == []
    await page.set_viewport_size({"width": NARROW[0], "height": NARROW[1]})
    assert await find_accessibility_faults(page) == []
    paper = await page.pdf(prefer_css_page_size=True)
    assert len(_PDF_PAGE.findall(paper)) == 1


async def test_what_is_copied_out_of_a_sheet_in_the_browser_is_read_again(page: Page, tmp_path: Path) -> None:
    file, share = sheet_of(tmp_path, "Zoé <script>alert(1)</script>", "en", 2)
    await page.goto(file.as_uri())
    assert await page.locator("script").count() == 0
    copied = await page.locator("#words").inner_text()
    assert tokenize_words(copied) == share.split()
    assert tokenize_words(read_written(file)) == share.split()


def test_a_sheet_says_all_that_a_guardian_has_to_know() -> None:
    made = GuardianSet(1_800_000_000_000, 2, ["Ann", "Ben", "Cleo"], 4711, 0)
    page = build_sheet(made, 1, split_mnemonic(WORDS, 2, 3)[1])
    for part in (
        "Set 04711, sheet 2 of 3, made on 2027-01-15",
        "Any 2 of them together",
        "This sheet alone opens nothing",
    ):
        assert part in page
    for part in ("Never photograph it", "Never type the words into a web page", "wallet guardians check"):
        assert part in page

"""The seal in a browser: never green while a check failed, and in the reader's language what is wrong and why."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from tests.miscounting_robot import committing_otherwise, miscounting
from tests.ui.accessible import find_accessibility_faults
from tests.ui.shown_page import SOON_MS, show_ward
from tests.world.sharing import SharedWard


async def test_a_robot_that_counted_others_than_it_committed_to_gets_no_green_seal(
    tmp_path: Path, page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward = SharedWard(tmp_path)
    miscounting(monkeypatch, 5)
    _, (record_id,) = ward.record_visit(1)
    async with show_ward(ward, page) as shown:
        await shown.watch(record_id)
        seal = page.locator(".seal")
        await expect(seal).to_have_attribute("data-seal", "bad")
        await expect(seal.locator("h2")).to_have_text("Not what the robot says it took")
        await expect(seal).to_contain_text("The robot counted 5 here, and put 2 into the ledger.")
        await expect(seal).to_contain_text("2 pictures or sounds are as the robot took them.")
        await expect(seal.locator("li.failed")).to_have_text(
            "Wrong: The robot's own count is 5, and it put 2 into the ledger"
        )
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await seal.get_by_role("button", name="Write this finding").click()
        await expect(seal).to_contain_text("This finding stands in block", timeout=SOON_MS)
        await page.get_by_label("Language").select_option("pt")
        await expect(page.locator(".seal h2")).to_have_text("Não é o que o robô diz ter feito", timeout=SOON_MS)
        await expect(page.locator(".seal li.failed")).to_contain_text("A contagem do próprio robô é 5")


async def test_of_several_recordings_with_other_counts_each_has_its_own_figures_and_no_sum_is_told(
    tmp_path: Path, page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward = SharedWard(tmp_path)
    miscounting(monkeypatch, 5)
    visit, ids = ward.record_visit(2)
    async with show_ward(ward, page) as shown:
        await shown.go(f"visit/{visit.owner.hex()}")
        await page.get_by_role("button", name="Watch", exact=True).click()
        seal = page.locator(".seal[data-seal=bad]")
        await expect(seal).to_contain_text(
            "In 2 recordings the robot counted another number than it put into the ledger.", timeout=SOON_MS
        )
        told = seal.locator(".seal-words > ul.sentences > li")
        assert await told.count() == len(ids)
        for place in range(len(ids)):
            await expect(told.nth(place)).to_contain_text("The robot's own count is 5, and it put 2 into the ledger.")


async def test_a_robot_that_committed_to_another_picture_is_named_and_nobody_who_keeps_it(
    tmp_path: Path, page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward = SharedWard(tmp_path)
    committing_otherwise(monkeypatch, 1)
    _, (record_id,) = ward.record_visit(1)
    async with show_ward(ward, page) as shown:
        await shown.watch(record_id)
        seal = page.locator(".seal")
        await expect(seal.locator("h2")).to_have_text("Not what the robot says it took")
        await expect(seal).to_contain_text("The robot sealed 1 picture or sound wrongly")
        await expect(seal).not_to_contain_text("where it is kept")
        await expect(seal).to_contain_text("1 other is as the robot took it.")
        await expect(seal.locator("li.failed")).to_have_text("Wrong: Not what the robot committed to: 2")
        assert await find_accessibility_faults(page, by_keyboard=False) == []


async def test_a_recording_that_cannot_be_checked_says_so_in_the_seals_place_with_why_and_what_next(
    tmp_path: Path, page: Page
) -> None:
    ward = SharedWard(tmp_path)
    _, (record_id,) = ward.record_visit(1)
    ward.custody.refusals[record_id] = "STORE_UNAVAILABLE"
    async with show_ward(ward, page) as shown:
        await page.get_by_label("Language").select_option("pt")
        await expect(page.locator("h1")).to_contain_text("Gravações")
        await shown.go(f"record/{record_id.hex()}")
        await page.get_by_role("button", name="Ver", exact=True).click()
        seal = page.locator(".seal")
        await expect(seal).to_have_attribute("data-seal", "unchecked", timeout=SOON_MS)
        await expect(seal.locator("h2")).to_have_text("Não foi possível verificar agora")
        await expect(seal.locator("p").first).not_to_be_empty()
        assert await page.locator(".player").count() == 0
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        del ward.custody.refusals[record_id]
        await page.get_by_role("button", name="Tentar de novo").click()
        await expect(seal).to_have_attribute("data-seal", "good", timeout=SOON_MS)

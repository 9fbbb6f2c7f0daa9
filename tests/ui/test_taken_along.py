"""The page that plays a bundle's pictures: what was erased stands in its place, with who confirmed it."""

from __future__ import annotations

from playwright.async_api import Page, expect

from clients.bundle import documents as doc
from clients.bundle.texts import player_page

CUSTODIANS = ["02" + "ab" * 32, "03" + "cd" * 32]


def visit() -> doc.VisitDocument:
    """A visit with a picture, one that was erased, and a record that was."""
    frames = [
        doc.FrameDocument(0, "picture", 1_700_000_000_000, 0, "png16", "", ["pictures/one.png"]),
        doc.FrameDocument(1, "erased", 0, 0, "", "", []),
    ]
    shared = ("00" * 33, 0, 0, 5, "00", "00", True, "depth", 0, 0, 2, 0, 4, 3, {}, [1], "")
    part = doc.RecordDocument("aa" * 16, 1, "active", *shared, frames)
    whole = doc.RecordDocument("bb" * 16, 2, "erased", *shared, [])
    return doc.VisitDocument(1, "02" * 33, "00" * 33, "demo", 0, "closed", 2, 0, True, 1, 9, [part, whole])


def erasure() -> doc.ErasureDocument:
    """Asked for, and confirmed by one of two; its words try to end the script."""
    receipt = doc.ErasureReceiptDocument(CUSTODIANS[0], 1, "</script><b>remains</b>", 0, "", 1_700_000_100_000)
    return doc.ErasureDocument(
        "cc" * 32, "02" * 33, ["aa" * 16], [1], "</script>", 1_700_000_050_000, CUSTODIANS, [receipt]
    )


async def test_what_was_erased_is_shown_as_erased_with_its_receipts(page: Page) -> None:
    names = {CUSTODIANS[0]: "node-1 of </script><b>%visits</b>"}
    await page.set_content(player_page([visit()], [erasure()], names).decode())
    assert await page.locator("b").count() == 0
    await expect(page.locator("#visit")).to_have_text("1 (2 pictures, 1 erased record)")
    await expect(page.locator("#place")).to_contain_text("Picture 1 of 2, ")
    await expect(page.locator("#picture")).to_have_attribute("src", "pictures/one.png")
    await expect(page.locator("#scale")).to_be_visible()
    await page.locator("#slide").fill("1")
    await expect(page.locator("#picture")).to_be_hidden()
    await expect(page.locator("#scale")).to_be_hidden()
    await expect(page.locator("#place")).to_have_text("Picture 2 of 2")
    await expect(page.locator("#gone")).to_have_text("Picture 2 of record aaaaaaaaaaaa was erased.")
    await page.locator("#slide").fill("2")
    await expect(page.locator("#gone")).to_have_text("Record bbbbbbbbbbbb was erased.")
    await expect(page.locator("#place")).to_have_text("Erased record 1 of 1")
    told = page.locator("#erasures")
    await expect(told).to_contain_text("to erase picture 2 of the record aaaaaaaaaaaa")
    await expect(told).to_contain_text("node-1 of </script><b>%visits</b> confirmed on")
    await expect(told).to_contain_text("the key of 1 picture is destroyed.")
    await expect(told).to_contain_text(f"Custodian {CUSTODIANS[1][:12]} had not confirmed.")

"""The wallet's page as its person uses it, in a real browser over a real network: pictures, seals, words, receipts."""

from __future__ import annotations

import asyncio
import re
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from consensus.records.metadata import NOTICE_SENSOR
from network.demo.tampering import flip_stored_byte
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME
from tests.ui.accessible import find_accessibility_faults
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.wallet_page import SETTLED_MS, confirm_with, go, open_page, serve_wallet, watch_first_meeting
from tests.ui.watched_page import SERVER_ENDED, Pages, Watch
from tests.walking_alone import UID

STAFF_UID = "D0C"


@asynccontextmanager
async def other_leaves(folders: list[Path], record_id: bytes) -> AsyncIterator[None]:
    """Have custodians' stores hold another first leaf of a record until the end of the block."""

    def turn() -> None:
        for folder in folders:
            with sqlite3.connect(folder / DATABASE_FILE_NAME, timeout=10) as database:
                select = "SELECT commitment_leaves FROM clips WHERE record_id = ?"
                (leaves,) = database.execute(select, (record_id,)).fetchone()
                update = "UPDATE clips SET commitment_leaves = ? WHERE record_id = ?"
                database.execute(update, (bytes([leaves[0] ^ 1]) + leaves[1:], record_id))
            database.close()

    await asyncio.to_thread(turn)
    try:
        yield
    finally:
        await asyncio.to_thread(turn)


@pytest.mark.smoke
async def test_she_opens_it_by_the_file_watches_what_was_recorded_and_sees_a_green_seal(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        assert "#" not in page.url
        assert not served.file.exists(), "what opens the page works once"
        await watch_first_meeting(page)
        seal = page.locator(".seal")
        await expect(seal).to_have_attribute("data-seal", "good")
        await expect(seal).to_contain_text("As the robot took it")
        await expect(seal).to_contain_text("Checked against block")

        player = page.locator(".player")
        # The seal may stand before the first picture is drawn: in colours, which are many.
        await page.wait_for_function(
            """() => { const stage = document.querySelector('canvas.stage');
            const data = stage.getContext('2d').getImageData(0, 0, stage.width, stage.height).data;
            return new Set(new Uint32Array(data.buffer)).size > 20; }"""
        )
        await expect(player.locator("svg.colour-legend")).to_contain_text("8 m")
        grey = player.locator(".grey-legend")
        await expect(grey).to_have_text("not measured")
        before = int(await player.get_attribute("data-place") or 0)
        await player.get_by_role("button", name="Play").click()
        await page.wait_for_function(f"() => Number(document.querySelector('.player').dataset.place) > {before} + 3")
        await player.get_by_role("button", name="Pause").click()
        await player.get_by_role("slider").fill("0")
        await expect(player.locator(".where")).to_contain_text("Picture 1 of")
        await player.get_by_label("Without the room").check()
        await expect(grey).to_have_text("not measured, or not you")
        await player.get_by_role("button", name="One picture on").click()
        await expect(player.locator(".where")).to_contain_text("Picture 2 of")

        await page.get_by_role("button", name="Write this finding").click()
        await expect(page.locator(".seal")).to_contain_text("This finding stands in block", timeout=SETTLED_MS)
        await go(page, "story")
        await expect(page.locator(".story").first).to_contain_text(
            "You checked 6 recordings: they are as the robot took them."
        )
        await expect(page.locator(".story").last).to_contain_text("A robot met you and began to record")
        assert await find_accessibility_faults(page, by_keyboard=False) == []


async def test_a_recording_that_comes_in_shows_by_itself_and_is_told_to_who_listens(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        count = page.locator("table.calendar .day[aria-current=date] .count")
        before = int(await count.inner_text())
        await recorded_network.record()
        await expect(page.locator("#news")).to_contain_text("came in", timeout=SETTLED_MS)
        await expect(page.locator("[role=status][aria-live=polite]")).to_contain_text("came in")
        await expect(count).not_to_have_text(str(before), timeout=SETTLED_MS)
        await page.get_by_role("link", name="Show it").click()
        await expect(page.locator("h1")).to_contain_text("Recording of")


async def test_bytes_that_were_changed_at_their_keepers_give_a_red_seal_that_says_what_is_wrong(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    record = next(entry for entry in reversed(recorded_network.records) if entry.metadata.sensor == "depth")
    for node in recorded_network.genesis.custodians:
        await asyncio.to_thread(
            flip_stored_byte, recorded_network.network.cluster.config(node.name), record.record_id, 0
        )
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await go(page, f"record/{record.record_id.hex()}")
        await expect(page.locator(".seal")).to_contain_text("Not checked yet")
        await page.get_by_role("button", name="Watch").click()
        seal = page.locator(".seal[data-seal=bad]")
        await expect(seal).to_be_visible(timeout=SETTLED_MS)
        await expect(seal).to_contain_text("Not as the robot took it")
        await expect(seal).to_contain_text("1 picture or sound was changed or damaged")
        await expect(seal).to_contain_text("What was sent is not what the ledger names: 1")
        await page.get_by_role("slider").fill("0")
        await expect(page.locator(".stage-words")).to_contain_text("This picture did not pass every check")
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await page.get_by_role("button", name="Write this finding").click()
        await expect(page.locator(".seal")).to_contain_text("This finding stands in block", timeout=SETTLED_MS)
        await go(page, "inbox")
        await expect(page.locator(".notice.bad")).to_contain_text(
            "1 recording is not as the robot took it", timeout=SETTLED_MS
        )
        assert await find_accessibility_faults(page, by_keyboard=False) == []


async def test_what_no_keeper_hands_out_whole_has_no_seal_but_is_said_to_be_unchecked_and_why(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    """Leaves that lead to no root of the chain: neither green nor red, and it stays until she tries again."""
    record = next(entry for entry in recorded_network.records if entry.metadata.sensor == "depth")
    folders = [
        recorded_network.network.cluster.config(node.name).custody_dir for node in recorded_network.genesis.custodians
    ]
    async with other_leaves(folders, record.record_id), serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await go(page, f"record/{record.record_id.hex()}")
        await page.get_by_role("button", name="Watch").click()
        seal = page.locator(".seal[data-seal=unchecked]")
        await expect(seal).to_contain_text("Could not be checked now", timeout=SETTLED_MS)
        await expect(page.locator(".story").first).to_contain_text("You asked to look at 1 recording.")
        await expect(seal).to_be_visible()
        assert await page.locator(".player").count() == 0
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await page.get_by_role("button", name="Try again").click()
        await expect(seal).to_be_visible(timeout=SETTLED_MS)


@pytest.mark.smoke
async def test_she_shares_with_a_doctor_after_she_was_told_what_that_means_and_ends_it(
    recorded_network: RecordedNetwork, page: Page, watch: Watch
) -> None:
    async with recorded_network.wallet("doctor") as doctor:
        await doctor.register(recorded_network.issue_card(STAFF_UID, "staff"), [])
        handle = doctor.store.content.handle.hex()
    watch.expect("status of 403")
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await page.locator(".latest a").first.click()
        await page.locator("input[data-visit]").first.check()
        await page.get_by_role("button", name="Share…").click()
        await page.get_by_label("With whom?").fill(handle)
        await page.get_by_label("What you call them").fill("Dr Weber")
        await page.get_by_label("What for?").select_option("demo")
        await page.get_by_role("button", name="See what that means").click()
        await expect(page.get_by_role("heading", name="What that means")).to_be_focused()
        await expect(page.locator("#main")).to_contain_text("member of the staff")
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await page.get_by_role("button", name="Share", exact=True).click()
        await confirm_with(page, "coffee")
        await expect(page.locator("dialog [role=alert]")).to_contain_text("not the passphrase")
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await confirm_with(page, recorded_network.passphrase)
        await expect(page.locator(".notice.good")).to_contain_text("shared", timeout=SETTLED_MS)
        await expect(page.locator(".notice.good")).to_be_focused()
        await go(page, "sharing")
        card = page.locator("section.card", has_text="Dr Weber")
        await expect(card).to_contain_text("Nobody has looked.", timeout=SETTLED_MS)
        await card.get_by_role("button", name="End it").click()
        await page.locator("dialog").get_by_role("button", name="End it").click()
        await expect(page.locator("#main")).to_contain_text("This share is ended.", timeout=SETTLED_MS)
        await expect(card).to_contain_text("ended by you", timeout=SETTLED_MS)
        assert await find_accessibility_faults(page, by_keyboard=False) == []


async def test_consent_shows_the_notice_first_and_a_no_is_one_press(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await go(page, "consent")
        there = len([entry for entry in recorded_network.records if entry.metadata.sensor != NOTICE_SENSOR])
        await expect(page.locator(".earlier")).to_contain_text(f"{there} recording")
        await expect(page.locator(".earlier")).to_contain_text("from before")
        await expect(page.locator("#main")).not_to_contain_text("no robot records you.")
        await expect(page.get_by_text("By depth the robot tells people apart.")).to_have_count(1)
        yes = page.get_by_role("button", name="Yes: Microphone, Care and treatment")
        no = page.get_by_role("button", name="No: Microphone, Care and treatment")
        await expect(yes).to_be_disabled()
        await expect(no).to_be_enabled()
        await expect(page.locator(".notice-words")).to_contain_text("Demonstration Hospital")
        await page.get_by_role("button", name="I have read it").click()
        await yes.click()
        await expect(page.locator("#main")).to_contain_text("You said yes. It holds from block", timeout=SETTLED_MS)
        await expect(yes).to_have_attribute("aria-pressed", "true")
        await expect(yes).to_be_focused()

        microphone = page.get_by_role("group", name="Microphone, Care and treatment")
        await expect(microphone).to_have_accessible_description(
            re.compile("the other sensors keep nothing of you unless")
        )
        await expect(microphone).to_contain_text("Nothing is kept by this")
        await page.get_by_role("button", name="Yes: Depth camera (distances, no colours), Care and treatment").click()
        await expect(microphone).not_to_contain_text("Nothing is kept by this", timeout=SETTLED_MS)
        await no.click()
        await expect(page.locator("#main")).to_contain_text("You took it back. It holds from block", timeout=SETTLED_MS)
        await expect(no).to_have_attribute("aria-pressed", "true")
        assert await find_accessibility_faults(page, by_keyboard=False) == []


@pytest.mark.smoke
async def test_she_erases_a_meeting_and_sees_every_keepers_receipt(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await page.locator(".latest a").first.click()
        await page.locator("input[data-visit]").first.check()
        await page.get_by_role("button", name="Erase…").click()
        await expect(page.get_by_role("heading", name="What remains")).to_be_visible()
        await page.get_by_role("button", name="Erase for good").click()
        await confirm_with(page, recorded_network.passphrase)
        await expect(page.get_by_role("heading", name="Erased everywhere")).to_be_visible(timeout=SETTLED_MS)
        await expect(page.locator(".receipts li.good")).to_have_count(len(recorded_network.genesis.custodians))
        await go(page, "erasing")
        await expect(page.locator("#main")).to_contain_text("erased everywhere", timeout=SETTLED_MS)
        await expect(page.locator(".receipts").first).to_contain_text("confirmed at")
        assert await find_accessibility_faults(page, by_keyboard=False) == []


async def test_when_the_command_ends_nothing_of_hers_is_left_on_the_screen(
    recorded_network: RecordedNetwork, page: Page, watch: Watch
) -> None:
    watch.expect(SERVER_ENDED)
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await served.end()
        await expect(page.get_by_role("heading", level=1)).to_have_text(
            "The wallet behind this page has ended", timeout=SETTLED_MS
        )
        await expect(page.locator("main code")).to_have_text(re.compile(r"^blockrobot wallet --profile ann .* serve$"))
        assert await page.locator(".day, .latest").count() == 0
        assert await find_accessibility_faults(page, by_keyboard=False) == []


async def test_locking_ends_the_command_and_a_second_browser_cannot_use_the_file(
    recorded_network: RecordedNetwork, pages: Pages, watch: Watch
) -> None:
    watch.expect(f"status of 40[0-9]|{SERVER_ENDED}")
    first, second = await pages.open(), await pages.open()
    async with serve_wallet(recorded_network) as served:
        words = served.file.read_text(encoding="utf-8")
        await open_page(first, served)
        copy = served.file.with_name("copied.html")
        copy.write_text(words, encoding="utf-8")
        await second.goto(copy.as_uri())
        await expect(second.locator(".notice.bad")).to_be_visible()
        assert await second.locator(".day").count() == 0
        assert await find_accessibility_faults(second, by_keyboard=False) == []
        await first.get_by_role("button", name="Lock").click()
        await expect(first.get_by_role("heading", level=1)).to_have_text("The wallet is locked")
        await asyncio.wait_for(served.process.wait(), 15)
        assert served.process.returncode == 0
    assert UID not in words

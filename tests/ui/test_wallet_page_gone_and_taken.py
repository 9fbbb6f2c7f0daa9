"""One picture erased out of the player, and everything taken along: both to their end, over a real network."""

from __future__ import annotations

import asyncio
import json
import re
import shlex
import sys
from pathlib import Path
from typing import Any

from playwright.async_api import Page, expect

from tests.ui.accessible import find_accessibility_faults
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.wallet_page import SETTLED_MS, confirm_with, go, open_page, serve_wallet

PLACE = 1
"""Which picture of the recording is erased: not the first, at which the player begins."""
ERASED = "This picture is erased."


async def watch(page: Page, record: str) -> None:
    """Open a recording, and wait for its first picture and the seal."""
    await go(page, f"record/{record}")
    await page.get_by_role("button", name="Watch", exact=True).click()
    await expect(page.locator(".player")).to_have_attribute("data-place", "0", timeout=SETTLED_MS)
    await expect(page.locator(".seal")).to_have_attribute("data-seal", "good")


async def seek(page: Page, place: int) -> None:
    """Move the slider to a picture, and wait until it stands there."""
    await page.get_by_role("slider").fill(str(place))
    await expect(page.locator(".player")).to_have_attribute("data-place", str(place))


async def test_she_erases_one_picture_out_of_the_player_and_the_others_stay(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    record = max(recorded_network.records, key=lambda entry: entry.metadata.frame_count)
    assert record.metadata.sensor == "depth"
    assert record.metadata.frame_count > PLACE
    name, count = record.record_id.hex(), record.metadata.frame_count
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await watch(page, name)
        await seek(page, PLACE)
        await expect(page.locator(".where")).to_contain_text(f"Picture {PLACE + 1} of {count}")
        erase = page.get_by_role("button", name="Erase this picture…")
        await erase.click()
        main = page.locator("#main")
        await expect(main).to_contain_text("Picture of ", timeout=SETTLED_MS)
        await expect(main).to_contain_text("1 depth picture: its keys are destroyed at every keeper first")
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await page.get_by_role("link", name="Keep it").click()
        await expect(page.locator("h1")).to_contain_text("Recording of", timeout=SETTLED_MS)

        await watch(page, name)
        await seek(page, PLACE)
        await erase.click()
        await page.get_by_role("button", name="Erase for good").click()
        await expect(page.locator("dialog")).to_contain_text("1 depth picture will be gone.")
        await confirm_with(page, recorded_network.passphrase)
        await expect(page.get_by_role("heading", name="Erased everywhere")).to_be_visible(timeout=SETTLED_MS)
        custodians = recorded_network.genesis.custodians
        await expect(page.locator(".receipts li.good", has_text="1 key destroyed")).to_have_count(len(custodians))
        await go(page, "erasing")
        await expect(main).to_contain_text("1 picture of a recording", timeout=SETTLED_MS)
        await expect(main).to_contain_text("check numbers, which prove the other pictures and show nothing")

        await watch(page, name)
        await expect(page.locator(".seal")).to_contain_text("1 picture is erased, as was asked.")
        for place in range(count):
            await seek(page, place)
            words = page.locator(".stage-words")
            await (expect(words).to_have_text(ERASED) if place == PLACE else expect(words).to_be_hidden())
            await expect(erase).to_be_enabled(enabled=place != PLACE)
        await seek(page, PLACE)
        assert await find_accessibility_faults(page, by_keyboard=False) == []
    async with recorded_network.wallet() as ann:
        states = {entry.record_id: entry.state for report in await ann.records() for entry in report.records}
    erased = {record_id: state.erased_frames for record_id, state in states.items() if state.erased_frames}
    assert erased == {record.record_id: [PLACE]}


async def run(command: str, folder: Path, *more: str) -> tuple[int, dict[str, Any]]:
    """Run a command as it stands on the page, in the folder of the file; return its exit code and what it says."""
    program, *arguments = shlex.split(command)
    assert program == "blockrobot"
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "network.cli.main", *arguments, *more, "--json",
        cwd=folder, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "HOME": str(folder)},
    )  # fmt: skip
    told, refused = await process.communicate()
    assert process.returncode is not None
    return process.returncode, json.loads(told or refused)


async def test_she_takes_everything_along_in_one_file_that_anybody_can_verify_as_the_page_says(
    recorded_network: RecordedNetwork, page: Page, tmp_path: Path
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await go(page, "export")
        await page.get_by_role("button", name="See what goes along").click()
        await page.get_by_role("button", name="Make the file").click()
        await confirm_with(page, recorded_network.passphrase)
        await expect(page.get_by_role("heading", name="The file is ready")).to_be_visible(timeout=4 * SETTLED_MS)
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        has = await page.locator("#main p", has_text="proved up to block").inner_text()
        said = [int(number.replace(",", "")) for number in re.findall(r"[\d,]*\d", has)]
        async with page.expect_download() as download:
            await page.get_by_role("button", name="Save blockrobot-").click()
        saved = await download.value
        file = tmp_path / saved.suggested_filename
        await saved.save_as(file)
        command = await page.locator("main pre code").inner_text()
    assert shlex.split(command) == [
        "blockrobot", "verify", file.name, "--genesis", str(recorded_network.genesis_file)
    ]  # fmt: skip
    code, told = await run(command, tmp_path)
    assert (code, told["ok"]) == (0, True), told
    assert (told["is_anchored"], told["is_complete"]) == (True, True)
    assert told["records"] == len(recorded_network.records)
    assert said == [told["pictures"], told["records"], told["proved_until_height"]], "as the page said"

    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    code, told = await run(command, tmp_path)
    assert code != 0
    assert not told["ok"]

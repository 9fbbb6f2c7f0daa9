"""A new person's page: she registers with the code on her card, says yes, and sees the first recording come in."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
from PIL import Image
from playwright.async_api import Page, expect

from clients.registrar.card_sheet import qr_text
from clients.sdk.network_client import NetworkClient
from clients.sdk.terminal.qr_codes import qr_svg
from consensus.chain.genesis import genesis_from_json
from consensus.primitives.keys import PrivateKey
from network.notices.notice_publishing import DEMO_ORGANISATION, demo_notice, publish_notice
from tests.ui.accessible import find_accessibility_faults
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.wallet_page import SETTLED_MS, confirm_with, go, serve_wallet
from tests.ui.watched_page import NARROW, WIDE, ZOOMED, Watch
from tests.unit.clients.sdk.test_qr_codes import drawn, packed
from tests.walking_alone import UID


async def publish_another_notice(network: RecordedNetwork) -> None:
    """Let the organisation publish its next version, while she reads the one before."""
    folder = network.network.folder
    key = PrivateKey((folder / "organisations" / DEMO_ORGANISATION / "admin.key").read_bytes())
    genesis = genesis_from_json((folder / "genesis.json").read_text(encoding="utf-8"))
    notice = msgspec.structs.replace(demo_notice(), automated_decisions="None, in other words.")
    async with NetworkClient(genesis) as client:
        await publish_notice(client, key, DEMO_ORGANISATION, notice)


def named_block(words: str) -> int:
    """Return the height of the block that words name first."""
    found = re.search(r"[Bb]lock (\d+)", words)
    assert found is not None, words
    return int(found[1])


async def read_from_pictures(page: Page, code: str, folder: Path) -> None:
    """A file that is no picture, one without a code, and a photograph of the card."""
    choose, letters = page.get_by_label("Read it from a picture"), page.get_by_label("Code on your card")
    await letters.fill("")
    (folder / "letter.png").write_bytes(b"no picture")
    (folder / "wall.png").write_bytes(packed(Image.new("L", (300, 300), 200)))
    (folder / "card.jpg").write_bytes(packed(drawn(qr_svg(qr_text(code)), 9), "JPEG"))
    await choose.set_input_files(folder / "letter.png")
    await expect(page.locator("#main [role=alert]")).to_have_text(
        "This file is no picture. Choose a photograph of the card."
    )
    await choose.set_input_files(folder / "wall.png")
    await expect(page.locator("#main [role=alert]")).to_contain_text("no QR code in the picture")
    await expect(letters).to_have_value("")
    await choose.set_input_files(folder / "card.jpg")
    await expect(letters).to_have_value(qr_text(code))
    await expect(page.locator(".notice-words")).to_contain_text("Demonstration Hospital")


async def read_by_camera(page: Page, code: str) -> None:
    """Hold the card before a camera, whose pictures a canvas gives; it is off once the code is read."""
    await page.evaluate(_CAMERA, list(packed(drawn(qr_svg(qr_text(code)), 6))))
    await page.get_by_role("button", name="Read it with the camera").click()
    await expect(page.get_by_label("Code on your card")).to_have_value(qr_text(code), timeout=SETTLED_MS)
    await expect(page.locator(".notice-words")).to_contain_text("Demonstration Hospital")
    assert await page.evaluate("() => window.cameraTracks.every((track) => track.readyState === 'ended')")
    assert await page.locator("video").count() == 0


async def leave_before_the_camera_is_allowed(page: Page) -> None:
    """Press twice while the browser asks, go elsewhere, and only then allow it: no camera stays on."""
    await page.evaluate(_SLOW_CAMERA)
    button = page.get_by_role("button", name="Read it with the camera")
    await button.dispatch_event("click")
    await button.dispatch_event("click")
    assert await page.evaluate("() => window.cameraAsked.length") == 1
    left = await button.element_handle()
    await page.evaluate("() => { location.hash = '#/consent'; }")
    await page.wait_for_function("(left) => !left.isConnected", arg=left)
    assert await page.evaluate("() => window.allowCamera()") == ["ended"]
    await page.evaluate("() => { location.hash = '#/'; }")


_SLOW_CAMERA = """() => {
  window.cameraAsked = [];
  navigator.mediaDevices.getUserMedia = () => new Promise((allow) => window.cameraAsked.push(allow));
  window.allowCamera = async () => {
    const streams = window.cameraAsked.map(() => document.createElement('canvas').captureStream(10));
    window.cameraAsked.forEach((allow, index) => allow(streams[index]));
    await new Promise((done) => { setTimeout(done, 0); });
    return streams.flatMap((stream) => stream.getTracks()).map((track) => track.readyState);
  };
}"""
_CAMERA = """async (bytes) => {
  const picture = await createImageBitmap(new Blob([new Uint8Array(bytes)]));
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [picture.width, picture.height];
  const paint = () => canvas.getContext('2d').drawImage(picture, 0, 0);
  setInterval(paint, 100);
  navigator.mediaDevices.getUserMedia = async ({ video }) => {
    paint();
    const stream = canvas.captureStream(10);
    window.cameraTracks = stream.getTracks();
    return video ? stream : null;
  };
}"""


async def test_she_registers_is_told_first_says_yes_and_watches_the_first_recording_come_in(
    page: Page, watch: Watch, tmp_path: Path
) -> None:
    watch.expect("status of 40[03]")
    network = RecordedNetwork(tmp_path / "new")
    try:
        await network.start_unregistered()
        code = network.issue_card(UID, "subject")
        async with serve_wallet(network) as served:
            served.pages.append(page)
            await page.goto(served.file.as_uri())
            await expect(page.locator("h1")).to_have_text("You are not registered yet", timeout=SETTLED_MS)
            await expect(page.locator("#footer")).not_to_contain_text("refused", timeout=SETTLED_MS)
            register = page.get_by_role("button", name="Register", exact=True)
            await page.get_by_label("Code on your card").fill("BR1-DAMAGED")
            await page.get_by_role("button", name="See what you are told").click()
            await expect(page.locator("#main .notice.bad")).to_be_visible()
            assert await register.count() == 0, "nobody registers before she was told"
            await page.get_by_label("Code on your card").fill(f" {code.lower()} ")
            await page.keyboard.press("Enter")
            await expect(page.locator(".notice-words")).to_contain_text("Demonstration Hospital")
            for scheme in ("dark", "light"):
                await page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
                for width, height in (ZOOMED, NARROW, WIDE):
                    await page.set_viewport_size({"width": width, "height": height})
                    assert await find_accessibility_faults(page, by_keyboard=scheme == "light") == []
            await page.get_by_label("Code on your card").fill("BR1-ANOTHER")
            assert await register.count() == 0, "what she was told is of another code"
            assert await page.locator(".notice-words").count() == 0
            await leave_before_the_camera_is_allowed(page)
            await read_by_camera(page, code)
            await read_from_pictures(page, code, tmp_path)
            await publish_another_notice(network)
            await register.click()
            await confirm_with(page, network.passphrase)
            why = page.locator("#main [role=alert]")
            await expect(why).to_contain_text("was not shown to you in the version", timeout=SETTLED_MS)
            await expect(page.locator(".notice-words")).to_contain_text("None, in other words.")
            await expect(why).to_be_visible()
            await register.click()
            await confirm_with(page, "coffee")
            await expect(page.locator("dialog [role=alert]")).to_contain_text("not the passphrase")
            await confirm_with(page, network.passphrase)
            await expect(page.get_by_role("heading", name="You are registered")).to_be_focused(timeout=SETTLED_MS)
            await expect(page.locator("h1")).to_have_text("You are registered")
            await expect(page.locator("#footer")).not_to_contain_text("node-")
            await expect(page.locator("#main")).to_contain_text("no robot records you")
            await page.get_by_role("link", name="To your consent").click()
            yes = page.get_by_role("button", name="Yes: Depth camera (distances, no colours), A demonstration")
            await yes.click()
            await expect(page.locator("#main")).to_contain_text("You said yes. It holds from block", timeout=SETTLED_MS)
            await expect(page.locator("#footer")).not_to_contain_text("node-")
            await page.get_by_text("Receipts of what you said").click()
            receipt = page.locator("#main details li").filter(has_text="You said yes.")
            await expect(receipt).to_contain_text("For: A demonstration. By: Depth camera", timeout=SETTLED_MS)
            await expect(receipt).to_contain_text("and by you")
            assert named_block(await page.inner_text("#footer")) >= named_block(await receipt.inner_text())
            await go(page, "")
            await expect(page.locator("#main")).to_contain_text("Nothing was recorded of you.")
            await network.prepare_robot()
            await network.record()
            await expect(page.locator("#news")).to_contain_text("came in", timeout=SETTLED_MS)
            await expect(page.locator("table.calendar .day.has")).to_be_visible(timeout=SETTLED_MS)
            await expect(page.locator("table.calendar .day.has")).to_have_attribute("tabindex", "0")
    finally:
        await network.close()

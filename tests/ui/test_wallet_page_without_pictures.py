"""Records without pictures in the page: sounds, estimates and notes are played, told and sealed in words of their own."""

from __future__ import annotations

import json
import wave
from collections.abc import AsyncIterator, Sequence
from io import BytesIO
from pathlib import Path

import pytest
import pytest_asyncio
from playwright.async_api import Locator, Page, expect

from clients.robot.recording.sealing import VisitChain
from consensus.records.metadata import NOTICE_SENSOR
from consensus.records.renditions import ENCODING_LABEL, ENCODING_WAV, RENDITION_VERSION, Rendition
from tests.ui.accessible import find_accessibility_faults
from tests.ui.shown_page import SOON_MS, Shown, show_ward
from tests.world.sharing import SharedWard

NO_PICTURES = "This recording has no pictures."
RATE_HZ, SOUNDS_S = 8_000, (0.5, 0.25)
ESTIMATES: tuple[dict[str, str | float], ...] = ({"label": "calm", "confidence": 0.87}, {"label": "in pain"})


def sound(seconds: float) -> bytes:
    """Return a sound file of silence."""
    packed = BytesIO()
    with wave.open(packed, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        file.writeframes(bytes(2 * int(seconds * RATE_HZ)))
    return packed.getvalue()


def record(
    ward: SharedWard,
    sensor: str,
    encoding: str,
    contents: Sequence[bytes],
    withheld: tuple[tuple[str, int], ...] = (),
) -> tuple[VisitChain, bytes]:
    """Have the robot record something that has no picture, one a second; return the visit, and the record's id."""
    now_ms, visit = ward.chain.time_ms, ward.open_visit()
    renditions = [
        Rendition(RENDITION_VERSION, now_ms + 1_000 * place, place, 1, 1, 0, 0, 0, 0, bytes(32), encoding, content)
        for place, content in enumerate(contents)
    ]
    record_id = ward.record(visit, renditions=renditions, sensor=sensor, withheld=withheld)
    ward.close_visit(visit)
    return visit, record_id


def record_sounds(ward: SharedWard) -> tuple[VisitChain, bytes]:
    return record(ward, "audio", ENCODING_WAV, [sound(seconds) for seconds in SOUNDS_S])


def record_estimates(ward: SharedWard) -> tuple[VisitChain, bytes]:
    return record(ward, "emotion", ENCODING_LABEL, [json.dumps(each).encode() for each in ESTIMATES])


@pytest.fixture
def ward(tmp_path: Path) -> SharedWard:
    """Her ward, where she was recorded once in pictures too, at another time."""
    ward = SharedWard(tmp_path)
    ward.record_visit()
    return ward


@pytest_asyncio.fixture(loop_scope="session")
async def shown(ward: SharedWard, page: Page) -> AsyncIterator[Shown]:
    async with show_ward(ward, page) as shown:
        yield shown


async def show(shown: Shown, record_id: bytes) -> Locator:
    """Have a new record shown in the page, and return its player."""
    await shown.read()
    await shown.watch(record_id)
    return shown.page.locator(".player")


async def expect_no_picture(player: Locator) -> None:
    """Nothing looks as if there were a picture, or had been one."""
    await expect(player).to_contain_text(NO_PICTURES)
    await expect(player.locator("canvas.stage, svg.colour-legend")).to_have_count(0)
    await expect(player.get_by_role("button", name="Save this picture")).to_have_count(0)
    await expect(player.get_by_role("button", name="Erase this one…")).to_be_visible()


async def test_sounds_are_played_one_after_the_other_under_a_green_seal(shown: Shown) -> None:
    player = await show(shown, record_sounds(shown.ward)[1])
    await expect_no_picture(player)
    seal = shown.page.locator(".seal[data-seal=good]")
    await expect(seal).to_contain_text("2 pictures or sounds were checked on this computer.")
    heard = player.locator("audio")
    await expect(heard).to_be_visible(timeout=SOON_MS)
    await expect(player.locator(".where")).to_contain_text("1 of 2, ")
    await expect(player.locator(".where")).not_to_contain_text("Picture")
    for number, seconds in enumerate(SOUNDS_S):
        await expect(player).to_have_attribute("data-place", str(number))
        await shown.page.wait_for_function(f"() => document.querySelector('audio').duration === {seconds}")
        assert await find_accessibility_faults(shown.page) == []
        await player.get_by_role("button", name="One picture on").click()
    await player.get_by_role("slider").fill("0")
    await player.get_by_role("button", name="Play").click()
    await shown.page.wait_for_function("() => document.querySelector('audio').currentTime > 0")
    await expect(player).to_have_attribute("data-place", "1")


async def test_estimates_are_told_with_how_sure_they_are_and_no_sound_is_offered(shown: Shown) -> None:
    player = await show(shown, record_estimates(shown.ward)[1])
    await expect_no_picture(player)
    told = player.locator(".label-stream")
    await expect(told).to_have_text("calm · 87% sure", timeout=SOON_MS)
    await expect(player.locator("audio")).to_be_hidden()
    assert await find_accessibility_faults(shown.page) == []
    await player.get_by_role("button", name="One picture on").click()
    await expect(told).to_have_text("in pain")
    await expect(shown.page.locator(".seal")).to_have_attribute("data-seal", "good")


async def test_a_note_alone_is_sealed_as_a_note_and_says_that_nothing_was_kept(shown: Shown) -> None:
    _, note = record(shown.ward, NOTICE_SENSOR, ENCODING_LABEL, [b""], withheld=(("not-alone", 3),))
    player = await show(shown, note)
    seal = shown.page.locator(".seal[data-seal=good]")
    await expect(seal).to_contain_text("There is no picture to check.")
    await expect(seal).not_to_contain_text("0 pictures")
    await expect_no_picture(player)
    await expect(player).to_contain_text("Nothing was kept here, to protect you or others.")
    await expect(player.locator("audio, .label-stream").first).to_be_hidden()
    await expect(player.get_by_role("button", name="Erase this one…")).to_be_disabled()
    await expect(shown.page.locator("#main")).to_contain_text("you were not alone")
    assert await find_accessibility_faults(shown.page) == []


async def test_a_changed_sound_is_not_played_and_the_one_before_it_neither(shown: Shown) -> None:
    _, record_id = record_sounds(shown.ward)
    shown.ward.spoil(record_id, 1)
    player = await show(shown, record_id)
    await expect(shown.page.locator(".seal")).to_have_attribute("data-seal", "bad")
    await expect(player.locator("audio")).to_be_visible(timeout=SOON_MS)
    await player.get_by_role("slider").fill("1")
    await expect(player.locator(".notice")).to_have_text(
        "This did not pass every check. It is neither shown nor played."
    )
    await expect(player.locator("audio")).to_be_hidden()
    assert await find_accessibility_faults(shown.page) == []
    await player.get_by_role("slider").fill("0")
    await expect(player.locator("audio")).to_be_visible()
    await expect(player.locator(".notice")).to_be_hidden()


async def test_an_estimate_that_was_erased_is_told_to_be_and_the_one_before_it_stands_there_no_more(
    shown: Shown,
) -> None:
    visit, record_id = record_estimates(shown.ward)
    await shown.ward.erase(visit, [record_id], [1])
    shown.ward.drop(record_id, 1)
    player = await show(shown, record_id)
    told = player.locator(".label-stream")
    await expect(told).to_be_visible(timeout=SOON_MS)
    await player.get_by_role("slider").fill("1")
    await expect(player.locator(".notice")).to_have_text("This is erased.")
    await expect(told).to_be_hidden()
    await expect(player.get_by_role("button", name="Erase this one…")).to_be_disabled()

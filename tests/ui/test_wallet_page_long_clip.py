"""A clip of 5,000 frames as the page has it: real records, opened by its API, played by windows in a real browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from playwright.async_api import CDPSession, Page, expect

from clients.sdk.pictures.rendition_picture import encode_depth_png
from clients.wallet.page.open_clips import CLIP_MAX_BYTES, RECORDS_MAX_COUNT
from consensus.limits import CLIP_FRAMES_MAX_COUNT
from consensus.primitives.hashing import sha256
from consensus.records.renditions import ENCODING_PNG16, RENDITION_VERSION, Rendition
from tests.ui.shown_page import show_ward
from tests.world.sharing import SharedWard

FRAMES_COUNT = 5_000
RECORDS_COUNT = -(-FRAMES_COUNT // CLIP_FRAMES_MAX_COUNT)
WIDTH, HEIGHT = 320, 240
FRAME_BYTES = WIDTH * HEIGHT * 2
GAP_MS = 33
HELD_MAX_COUNT = 48
SEEKS_COUNT = 16
OPENED_MS = 60_000
OTHER_MAX_BYTES = 8 << 20
"""What the page may hold beside its window of frames: answers that are on their way, and what V8 has not collected."""


def record_long_visit(ward: SharedWard) -> None:
    """Record a visit of 5,000 small pictures, as many in a record as there may be."""
    room = encode_depth_png(np.full((HEIGHT, WIDTH), 5_000, dtype=np.uint16))
    ward.custody.rooms[sha256(room)] = room
    box = encode_depth_png(np.full((4, 3), 1_500, dtype=np.uint16))
    start_ms, visit = ward.chain.time_ms, ward.open_visit()
    frames = [
        Rendition(
            RENDITION_VERSION, start_ms + GAP_MS * number, number, WIDTH, HEIGHT, number % (WIDTH - 3), 5, 3, 4,
            sha256(room), ENCODING_PNG16, box,
        )
        for number in range(FRAMES_COUNT)
    ]  # fmt: skip
    for first in range(0, FRAMES_COUNT, CLIP_FRAMES_MAX_COUNT):
        ward.record(visit, renditions=frames[first : first + CLIP_FRAMES_MAX_COUNT])
    ward.close_visit(visit)


async def held_bytes(devtools: CDPSession) -> float:
    """Return what the page's scripts hold, pictures included, once what nobody needs is collected."""
    await devtools.send("HeapProfiler.collectGarbage")
    usage = await devtools.send("Runtime.getHeapUsage")
    return float(usage["usedSize"] + usage["backingStorageSize"])


async def test_a_clip_of_5000_frames_is_sought_through_and_played_in_bounded_memory(page: Page, tmp_path: Path) -> None:
    assert RECORDS_COUNT <= RECORDS_MAX_COUNT, "they go into one clip"
    ward = SharedWard(tmp_path)
    record_long_visit(ward)
    async with show_ward(ward, page) as shown:
        await page.locator(".latest a").click()
        await page.locator(".visit-row a.button").click()
        player, place = page.locator(".player"), page.get_by_role("slider")
        await expect(player).to_have_attribute("data-place", "0", timeout=OPENED_MS)
        await expect(page.locator(".where")).to_contain_text("Picture 1 of 5,000")
        await expect(page.locator("#main")).not_to_contain_text("Part 1 of")
        await expect(page.locator(".seal-words > p").first).to_contain_text("5,000 pictures or sounds were checked")
        (clip,) = shown.session.clips._clips.values()
        assert (len(clip.frames), len(clip.views)) == (FRAMES_COUNT, RECORDS_COUNT)
        assert clip.size < CLIP_MAX_BYTES

        devtools = await page.context.new_cdp_session(page)
        before = await held_bytes(devtools)
        last = FRAMES_COUNT - 1
        seeks = [number * last // SEEKS_COUNT for number in range(1, SEEKS_COUNT + 1)]
        assert FRAMES_COUNT // 2 - 1 in seeks
        assert seeks[-1] == last
        for number in [*seeks, FRAMES_COUNT // 2]:
            await place.fill(str(number))
            await expect(player).to_have_attribute("data-place", str(number), timeout=OPENED_MS)
            await expect(page.locator(".where")).to_contain_text(f"Picture {number + 1:,} of 5,000")
            assert 0 < int(await player.get_attribute("data-held") or 0) <= HELD_MAX_COUNT
        middle = FRAMES_COUNT // 2
        shown_at = await page.evaluate(
            """() => { const stage = document.querySelector('canvas.stage');
            const row = stage.getContext('2d').getImageData(0, 6, stage.width, 1).data;
            const pixels = [...new Uint32Array(row.buffer)];
            return pixels.findIndex((pixel) => pixel !== pixels.at(-1)); }"""
        )
        assert shown_at == middle % (WIDTH - 3), "the very picture of that place is on the stage"
        await player.get_by_role("button", name="Play").click()
        await page.wait_for_function(f"() => Number(document.querySelector('.player').dataset.place) > {middle + 20}")
        await player.get_by_role("button", name="Pause").click()
        await expect(player).to_have_attribute("data-held", str(HELD_MAX_COUNT))
        grown = await held_bytes(devtools) - before
        assert grown <= HELD_MAX_COUNT * FRAME_BYTES + OTHER_MAX_BYTES
        assert SEEKS_COUNT * 16 * FRAME_BYTES > 2 * (HELD_MAX_COUNT * FRAME_BYTES + OTHER_MAX_BYTES), (
            "what was looked at does not fit into what may be held"
        )

"""An exported run on paper: what happened is read there with its times, over the whole width."""

from __future__ import annotations

from pathlib import Path

from playwright.async_api import Page, expect

from network.cluster import Cluster
from network.console.live import LiveConsole
from network.provisioning.network_layout import create_network
from tests.unit.network.console.polls import polls

PAPER_PX = (718, 1047)
"""A4 at 96 to the inch, within margins of a centimetre."""
ROWS = r"""() => [...document.querySelectorAll('.events li')].map((row) => {
  const [time, badge, what] = [...row.children].map((part) => part.getBoundingClientRect());
  const font = parseFloat(getComputedStyle(row.querySelector('.time')).fontSize);
  return { time: row.querySelector('.time').checkVisibility() && time.width > 3 * font,
    isOneLine: Math.abs(time.top - what.top) < 8, isInOrder: time.right <= badge.left + 1 && badge.right <= what.left + 1,
    share: what.width / row.getBoundingClientRect().width };
})"""


async def test_what_happened_is_printed_with_its_times_and_over_the_whole_width(page: Page, tmp_path: Path) -> None:
    folder = tmp_path / "network"
    create_network(folder, nodes=4, organisations=2, base_port=20_000, store="sqlite", faults=True)
    console = LiveConsole(Cluster(folder))
    console._update(polls())
    file = tmp_path / "run.html"
    file.write_text(console.export(), encoding="utf-8")
    await page.goto(file.as_uri())
    await expect(page.locator(".events li").first).to_be_visible()
    await page.emulate_media(media="print")
    await page.set_viewport_size({"width": PAPER_PX[0], "height": PAPER_PX[1]})
    rows = await page.evaluate(ROWS)
    assert rows
    for row in rows:
        assert row["time"], "an event has its time on paper"
        assert row["isOneLine"], row
        assert row["isInOrder"], row
        assert row["share"] > 0.6, "the sentence has the width of the page"

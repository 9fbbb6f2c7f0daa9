"""The console of a network of seven: everything is to be told apart, what flows is seen, and it prints."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from tests.cluster.network_under_test import running
from tests.ui.accessible import find_accessibility_faults
from tests.ui.console_under_test import ConsoleUnderTest
from tests.ui.watched_page import NARROW, WIDE

NODES_COUNT = 7
A4_PX = (690, 1000)
"""A4 without its margins, in CSS pixels."""
LONG_MS = 60_000
_HIDDEN = """() => {
  const box = (element) => element.getBoundingClientRect();
  const meet = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const frame = box(document.querySelector('svg.topology'));
  const nodes = [...document.querySelectorAll('.topology .node')];
  const told = [];
  for (const node of nodes) {
    const name = node.querySelector('.name-text');
    const place = box(name);
    const isIn = place.left >= frame.left && place.right <= frame.right && place.bottom <= frame.bottom;
    if (!isIn) told.push(`${name.textContent} is cut`);
    for (const other of nodes) {
      if (other === node) continue;
      for (const part of ['.body', '.name-text']) {
        if (meet(place, box(other.querySelector(part)))) told.push(`${name.textContent} lies on another ${part}`);
      }
    }
  }
  return told;
}"""
_CUT = """() => [...document.querySelectorAll('table, svg, dl, ul')].filter((one) =>
  one.getBoundingClientRect().right > innerWidth + 1).map((one) => one.outerHTML.slice(0, 60))"""


@pytest.mark.timeout(240)
async def test_seven_nodes_are_told_apart_seen_at_work_and_printed(page: Page, tmp_path: Path) -> None:
    async with running(ConsoleUnderTest(tmp_path, NODES_COUNT)) as console:
        await console.open(page)
        await expect(page.get_by_text("All is well")).to_be_visible(timeout=LONG_MS)
        await expect(page.locator(".topology .node")).to_have_count(NODES_COUNT)
        links = page.locator(".topology .link")
        await expect(links).to_have_count(NODES_COUNT * (NODES_COUNT - 1) // 2)
        await expect(page.locator(".topology .flow[class*=pace]").first).to_be_attached(timeout=LONG_MS)
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        for width, height in (NARROW, WIDE):
            await page.set_viewport_size({"width": width, "height": height})
            assert await page.evaluate(_HIDDEN) == []
        await page.emulate_media(media="print")
        await page.set_viewport_size({"width": A4_PX[0], "height": A4_PX[1]})
        assert await page.evaluate(_CUT) == []
        await expect(page.locator("table.nodes th[scope=row]").first).to_contain_text("node-1")
        assert await page.locator("table.nodes th[scope=row] button").first.is_visible(), (
            "names are buttons, and printed"
        )
        assert await page.locator(".break").is_hidden(), "nothing is broken on paper"
        await page.goto("about:blank")

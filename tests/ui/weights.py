"""What a page of ours weighs, and how soon something of it is seen; without pictures and answers about data."""

from __future__ import annotations

from playwright.async_api import Page

PAGE_MAX_BYTES = 150 * 1024
_WEIGH = """() => {
  const parts = performance.getEntries().filter((one) => one.decodedBodySize &&
    (one.initiatorType !== 'fetch' || one.name.includes('/api/texts')) && one.initiatorType !== 'img');
  const sum = (name) => parts.reduce((all, one) => all + one[name], 0);
  const [paint] = performance.getEntriesByName('first-contentful-paint');
  return { plain_bytes: sum('decodedBodySize'), sent_bytes: sum('encodedBodySize'),
    first_paint_ms: Math.round(paint.startTime) };
}"""


async def weigh(page: Page) -> dict[str, float]:
    """Return what an open page weighs in bytes, and its first contentful paint in milliseconds after it was asked for.

    `sent_bytes` is what came over the wire, packed; `plain_bytes` the same unpacked. The texts of a page in one language
    count; pictures and answers about data do not.
    """
    figures: dict[str, float] = await page.evaluate(_WEIGH)
    return figures

"""Looks for what somebody who cannot see well, hear of a picture or use a mouse would stumble over on a page.

axe-core judges first, with its rules for WCAG 2.2, levels A and AA, and its best practices; `accessible.js` beside this
file adds what axe does not find. It is run by the browser's debugger: the pages' policy stays as strict as it is served.
No finding here does not say that there is none: no program finds everything.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from axe_playwright_python.base import AXE_SCRIPT
from playwright.async_api import Page

AXE_TAGS = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice")
_AXE_RUN = """(tags) => axe.run(document, {
  runOnly: {type: 'tag', values: tags}, rules: {'target-size': {enabled: true}},
  resultTypes: ['violations'], preload: false,
}).then((found) => found.violations.map(({id, impact, help, nodes}) => ({
  id, impact, help, where: nodes.slice(0, 5).map((node) => `${node.target.join(' ')} (${node.html.slice(0, 120)})`),
})))"""
_SCRIPT = (Path(__file__).parent / "accessible.js").read_text(encoding="utf-8")
STOPS_MAX_COUNT = 150
"""More stops than these are not walked through by Tab: a list of 2,000 records is the same row many times."""

_WHERE = """() => {
  const active = document.activeElement;
  if (!active || active === document.body) return null;
  const style = getComputedStyle(active);
  const label = active.labels && active.labels[0] ? getComputedStyle(active.labels[0]) : style;
  const rings = [style, label].some((one) =>
    (one.outlineStyle !== 'none' && parseFloat(one.outlineWidth) > 0) || one.boxShadow !== 'none');
  return {stop: active.dataset.tabStop ?? null, rings, name: active.localName + (active.id ? '#' + active.id : '')};
}"""

_STILL_THERE = "() => [...document.querySelectorAll('[data-tab-stop]')].map((element) => element.dataset.tabStop)"

_CLEAR = """() => {
  document.querySelectorAll('[data-tab-stop]').forEach((element) => delete element.dataset.tabStop);
  if (document.activeElement && !document.activeElement.closest('dialog[open]')) document.activeElement.blur();
}"""


async def find_accessibility_faults(page: Page, *, by_keyboard: bool = True) -> list[str]:
    """Return what is wrong on the page as it stands, each with the element; nothing if nothing was found.

    What axe finds begins with `axe`, the impact and the rule. Beside it: labels, references, drawings, targets' sizes,
    sideways scrolling, and (`by_keyboard`) that Tab reaches every control and shows where it is. The focus is moved by it.
    Take the page in each of its states: a dialogue that is open is judged alone.
    """
    faults = await ask_axe(page)
    found: dict[str, Any] = await page.evaluate(_SCRIPT)
    faults += found["faults"]
    stops: list[str] = found["stops"]
    if by_keyboard and len(stops) <= STOPS_MAX_COUNT:
        faults += await _walk(page, stops)
    await page.evaluate(_CLEAR)
    return faults


async def ask_axe(page: Page) -> list[str]:
    """Return what axe finds, of any impact, each as its impact, its rule and where."""
    if not await page.evaluate("() => Boolean(window.axe)"):
        await page.evaluate(AXE_SCRIPT)
    found: list[dict[str, Any]] = await page.evaluate(_AXE_RUN, list(AXE_TAGS))
    return [f"axe: {one['impact']} {one['id']}: {one['help']}: {'; '.join(one['where'])}" for one in found]


async def _walk(page: Page, stops: list[str]) -> list[str]:
    """Press Tab until every stop was met or more presses than stops were of no use."""
    faults: list[str] = []
    missing = {str(number) for number in range(len(stops))}
    await page.evaluate("() => document.activeElement && document.activeElement.blur()")
    for _ in range(2 * len(stops) + 5):
        if not missing:
            break
        await page.keyboard.press("Tab")
        where = await page.evaluate(_WHERE)
        if where is None or where["stop"] not in missing:
            continue
        missing.discard(where["stop"])
        if not where["rings"]:
            faults.append(f"focus: nothing shows that it is on {stops[int(where['stop'])]}")
    if missing:  # a page that follows a live network may have drawn some anew meanwhile
        missing &= set(await page.evaluate(_STILL_THERE))
    faults += [f"keyboard: Tab does not reach {stops[int(number)]}" for number in sorted(missing, key=int)]
    return faults

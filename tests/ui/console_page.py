"""The console's page as somebody reads it who looks at it: rows of the table of nodes, what happened, marks of leaders.

Only reads, and chooses a node; what is pressed stands in the stories.
"""

from __future__ import annotations

import re
from typing import Any

from playwright.async_api import Locator, Page, expect

from network.faults.actions import Heal
from network.faults.control import FaultControl
from tests.ui.console_under_test import ConsoleUnderTest

LONG_MS = 30_000
_LEADERS = """() => {
  const figure = (name) => [...document.querySelectorAll('.figures div')].find((one) =>
    one.querySelector('dt').textContent === name).querySelector('dd').textContent;
  const column = [...document.querySelectorAll('table.nodes thead th')].findIndex((one) => one.textContent === 'leads');
  return {
    crowned: [...document.querySelectorAll('.topology .node')].filter((node) =>
      getComputedStyle(node.querySelector('.crown')).visibility === 'visible').map((node) => node.querySelector('.name-text').textContent),
    said: [...document.querySelectorAll('.topology .node')].filter((node) =>
      node.getAttribute('aria-label').includes(', leads,')).map((node) => node.querySelector('.name-text').textContent),
    listed: [...document.querySelectorAll('table.nodes tbody tr')].filter((row) =>
      row.cells[column].textContent === 'yes').map((row) => row.cells[0].textContent),
    unsaid: [...document.querySelectorAll('table.nodes tbody tr')].filter((row) =>
      row.cells[column].textContent === '-').map((row) => row.cells[0].textContent),
    figure: figure('leads'),
    epoch: Number(figure('epoch')),
    round: Number(figure('round').replaceAll(',', '')),
  };
}"""  # noqa: E501
_ROUNDS = """() => {
  const [head, ...rows] = document.querySelector('table.rounds').rows;
  const places = [...head.cells].slice(1).map((cell) => cell.title);
  return places.map((place, index) => [place, Object.fromEntries(rows.map((row) => {
    const cell = row.cells[index + 1];
    return [row.cells[0].textContent, {words: cell.querySelector('.visually-hidden').textContent, marks: [...cell.classList]}];
  }))]);
}"""  # noqa: E501
_PLACE = re.compile(r"Round (\d+) of epoch (\d+)")

Cells = dict[str, dict[str, Any]]
"""By the row's name: `words`, which are read aloud, and `marks`, the classes that give a cell its colour and frame."""


async def open_healed(console: ConsoleUnderTest, page: Page) -> None:
    """Open the console of a network on which nothing is wrong (any more)."""
    cluster = console.network.cluster
    await FaultControl(cluster).carry_out(Heal())
    for name in cluster.names:
        if not cluster.is_running(name):
            cluster.start(name)
    await console.open(page)
    await expect(page.get_by_text("All is well")).to_be_visible(timeout=LONG_MS)


async def choose(page: Page, name: str) -> None:
    """Choose whom the buttons for a node are about."""
    await page.get_by_role("tab", name="A node").click()
    await page.get_by_label("Node", exact=True).select_option(name)


def row_of(page: Page, name: str) -> Locator:
    """Return a node's row of the table of nodes."""
    return page.locator("table.nodes tbody tr").filter(has=page.get_by_role("rowheader", name=name, exact=True))


async def cell_of(page: Page, name: str, column: str) -> Locator:
    """Return a node's cell of a column of the table of nodes."""
    columns = await page.locator("table.nodes thead th").all_inner_texts()
    return row_of(page, name).locator("th, td").nth(columns.index(column))


async def expect_cell(page: Page, name: str, column: str, text: str | re.Pattern[str]) -> None:
    """Expect that a node's cell comes to have this text."""
    await expect(await cell_of(page, name, column)).to_have_text(text, timeout=LONG_MS)


async def expect_state(page: Page, name: str, state: str) -> None:
    """Expect that a node's badge comes to begin with this word."""
    badge = (await cell_of(page, name, "state")).locator(".badge")
    await expect(badge).to_have_text(re.compile(rf"^{state}\b"), timeout=LONG_MS)


async def expect_told(page: Page, text: str) -> None:
    """Expect that what happened comes to hold a sentence with this text."""
    await expect(page.locator(".events li .what").filter(has_text=text).first).to_be_visible(timeout=LONG_MS)


async def expect_done(page: Page, words: str) -> None:
    """Expect that the panel and what happened say that this was done."""
    await expect(page.locator(".break .notice.good")).to_have_text(f"Done: {words}.", timeout=LONG_MS)
    await expect_told(page, f"Done: {words}.")


async def read_leader(page: Page) -> dict[str, Any]:
    """Return who leads which round by the crown, by its words, in the table and in the figures, all of one moment.

    `unsaid`: whose rows say nothing of it, since they missed a look.
    """
    seen: dict[str, Any] = await page.evaluate(_LEADERS)
    return seen


async def read_rounds(page: Page) -> dict[tuple[int, int], Cells]:
    """Return the table of the last rounds as it stands: (epoch, round) -> cells."""
    read: dict[tuple[int, int], Cells] = {}
    for title, cells in await page.evaluate(_ROUNDS):
        found = _PLACE.fullmatch(title)
        assert found is not None
        read[int(found[2]), int(found[1])] = cells
    return read

"""What the console's page keeps where it stands while nodes join and leave: rows, what has the focus, what is chosen."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.async_api import Locator, Page, expect

from network.console.live import CONSOLE_ASSETS
from tests.ui.page_scripts import open_scripts

NAMES = ["node-1", "node-2", "node-3", "node-4"]
NEWCOMER = "node-0"
"""Stands before all the others: what is kept is not only appended to."""
_OPEN = """async (names) => {
  const [{ createStage }, { createFaults }] = [await import('./stage.js'), await import('./faults.js')];
  window.network_of = (names) => ({name: 'ward', quorum: 3, nodes: names.map((name) => ({
    name, organisation: 'ward', producer: true, custodian: true, breakable: true}))});
  window.moment_of = (names, at_ms) => ({at_ms, final: 3, final_since_ms: at_ms, stuck_since_ms: null, links: [],
    nodes: names.map((name) => ({name, state: 'signing', final: 3, round: 4, epoch: 0, leader: names[1]}))});
  window.rounds_of = (names, first) => [0, 1, 2].map((step) => ({epoch: 0, round: first + step, leader: names[0],
    voted: names.slice(0, 1 + step), gave_up: [], outcome: 'open'}));
  const network = network_of(names);
  window.chosen = null;
  window.faults = createFaults({network, choices: {disks: ['journal'], profiles: [], behaviours: []},
    onSelect(name) { window.chosen = name; }, onGroups() {}});
  window.stage = createStage({network, onNode() {}, onLink() {}, beside: faults.element});
  document.body.append(...stage.element);
  stage.update(moment_of(names, 1000), rounds_of(names, 7), network);
}"""
_CHANGE = """(names) => {
  window.held = document.activeElement;
  faults.setNetwork(network_of(names));
  stage.update(moment_of(names, 2000), rounds_of(names, 8), network_of(names));
}"""
_KEEPS = "() => document.activeElement === window.held && document.activeElement !== document.body"


async def open_stage(page: Page) -> None:
    await open_scripts(page, CONSOLE_ASSETS)
    await page.evaluate(_OPEN, NAMES)


def row_button(page: Page, name: str) -> Locator:
    return page.locator("table.nodes").get_by_role("button", name=name, exact=True)


def drawn(page: Page, name: str) -> Locator:
    return page.locator(f'.topology [role="button"][aria-label^="{name} of "]')


def letter(page: Page, name: str, index: int) -> Locator:
    return page.locator(f'.groups input[name="group-{name}"]').nth(index)


async def change(page: Page, names: list[str]) -> None:
    await page.evaluate(_CHANGE, names)


@pytest.mark.parametrize("place", ["row", "drawing", "group"])
async def test_who_stands_on_a_node_stays_there_when_others_join_and_leave(page: Page, place: str) -> None:
    await open_stage(page)
    if place == "group":
        await page.get_by_role("tab", name="Partition").click()
        await letter(page, "node-3", 1).check()
    finders: dict[str, Any] = {"row": row_button, "drawing": drawn, "group": lambda *one: letter(*one, 1)}
    own: Locator = finders[place](page, "node-3")
    await own.focus()
    for names in ([*NAMES, "node-5"], [NEWCOMER, *NAMES], NAMES[1:3]):
        await change(page, names)
        assert await page.evaluate(_KEEPS), f"the focus was taken away with {names}"
        await expect(own).to_be_focused()
    if place == "group":
        await expect(own).to_be_checked()


@pytest.mark.parametrize(("gone", "heir"), [("node-2", "node-3"), ("node-4", "node-3")], ids=["within", "last"])
@pytest.mark.parametrize("find", [row_button, drawn], ids=["row", "drawing"])
async def test_the_focus_of_a_node_that_leaves_goes_to_its_neighbour(
    page: Page, find: Any, gone: str, heir: str
) -> None:
    await open_stage(page)
    await find(page, gone).focus()
    await change(page, [name for name in NAMES if name != gone])
    await expect(find(page, heir)).to_be_focused()
    await expect(find(page, gone)).to_have_count(0)


async def test_the_focus_of_a_group_whose_node_leaves_goes_to_its_neighbours_choice(page: Page) -> None:
    await open_stage(page)
    await page.get_by_role("tab", name="Partition").click()
    await letter(page, "node-3", 1).check()
    await letter(page, "node-2", 0).focus()
    await change(page, [name for name in NAMES if name != "node-2"])
    await expect(letter(page, "node-3", 1)).to_be_focused()
    await expect(letter(page, "node-3", 1)).to_be_checked()


async def test_a_node_keeps_the_focus_when_the_page_is_zoomed_and_drawn_narrow(page: Page) -> None:
    await open_stage(page)
    await drawn(page, "node-2").focus()
    before = await page.locator("svg.topology").get_attribute("viewBox")
    await page.set_viewport_size({"width": 320, "height": 640})
    await expect(page.locator("svg.topology")).not_to_have_attribute("viewBox", before or "")
    await expect(drawn(page, "node-2")).to_be_focused()


async def test_rows_and_cells_that_say_the_same_are_not_drawn_anew(page: Page) -> None:
    await open_stage(page)
    await page.evaluate(
        """() => {
          const line = document.querySelector('table.rounds tbody').rows[1];
          window.kept = [line, line.cells[2], ...document.querySelectorAll('tbody tr')];
        }"""
    )
    await change(page, [*NAMES, "node-5"])
    assert await page.evaluate("() => window.kept.every((part) => part.isConnected)")
    line = page.locator("table.rounds tbody tr").nth(1)
    assert await line.locator("th, td").all_text_contents() == ["node-2", "·said nothing", "●voted", "●voted"]
    heads = await page.locator("table.rounds thead th").all_inner_texts()
    assert heads == ["round", "8", "9", "10"]
    assert await page.locator("details tbody tr").count() == 5 * 4


async def test_a_node_that_was_chosen_and_left_is_not_silently_another(page: Page) -> None:
    await open_stage(page)
    await page.get_by_label("Node", exact=True).select_option("node-4")
    await change(page, NAMES[:3])
    await expect(page.get_by_label("Node", exact=True)).to_have_value("node-1")
    assert await page.evaluate("() => window.chosen") == "node-1"
    said = page.get_by_role("status").filter(has_text="node-4 is not in the network any more; node-1 is chosen now.")
    await expect(said).to_be_attached()


async def test_what_is_said_aloud_is_not_lost_by_what_is_said_a_moment_later_and_can_be_taken_back(page: Page) -> None:
    await open_stage(page)
    await page.evaluate(
        """async () => {
          const { announce } = await import('./shared/dom.js');
          window.announce = announce;
          announce('node-2 is stopped already.');
          announce('node-3 does not answer.');
        }"""
    )
    aloud = page.locator("[role=status][aria-live=polite]")
    await expect(aloud.locator("div")).to_have_text(["node-2 is stopped already.", "node-3 does not answer."])
    await page.evaluate("() => { announce('Not to be heard.'); announce(''); }")
    await expect(aloud).to_have_text("")
    await page.evaluate("() => announce('node-2 is signing.')")
    await expect(aloud.locator("div")).to_have_text(["node-2 is signing."])

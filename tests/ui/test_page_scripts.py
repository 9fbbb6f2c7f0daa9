"""What scripts of the console and the explorer decide by themselves: what is offered, what is taken, when to ask again."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.async_api import Page, Route, expect

from network.console.live import CONSOLE_ASSETS
from node.explorer.page import EXPLORER_ASSETS
from tests.ui.page_scripts import ORIGIN, open_scripts
from tests.ui.watched_page import Watch

pytestmark = pytest.mark.smoke

_REFUSALS = """async (node) => (await import('./offers.js')).refusals(
  node.name, {breakable: true}, {nodes: [node], links: []})"""
_OPEN_FAULTS = """async () => {
  const { createFaults } = await import('./faults.js');
  const nodes = ['node-1', 'node-2'].map((name) => ({name, breakable: true}));
  const moment = {nodes: nodes.map(({name}) => ({name, state: 'signing'})), links: []};
  window.groups = null;
  window.faults = createFaults({network: {nodes}, choices: {disks: ['journal'], profiles: [], behaviours: []},
    onSelect() {}, onGroups(groups) { window.groups = groups; }});
  document.body.append(window.faults.element);
  window.faults.update(moment);
}"""
_FOLLOW = """async () => {
  const [{ feed }, { entry }] = [await import('./feed.js'), await import('./api.js')];
  entry.kind = 'member';
  window.feed = feed;
  feed.run();
}"""
_HIDE = """(isHidden) => Object.defineProperty(document, 'hidden', {value: isHidden, configurable: true})"""
PAUSE_MS = 400
"""Long enough for a try to be seen that came too soon; the page's own clock stands still meanwhile."""


async def refused(page: Page, **facts: Any) -> dict[str, str]:
    """What is not offered for a node like this, and why."""
    found: dict[str, str] = await page.evaluate(_REFUSALS, {"name": "node-2", **facts})
    return found


@pytest.mark.parametrize(
    "facts",
    [
        {"state": "waiting"},
        {"state": "paused"},
        {"state": "stopped"},
        {"state": "no answer"},
        {"state": "fault: no space"},
        {"state": "silent: older journal"},
        {"state": "signing", "behaviour": "garbage"},
        {"state": "suspended", "behaviour": "equivocate"},
    ],
    ids=lambda facts: " ".join(facts.values()),
)
async def test_a_node_that_a_restart_may_mend_is_offered_one(page: Page, facts: dict[str, str]) -> None:
    await open_scripts(page, CONSOLE_ASSETS)
    assert "restart" not in await refused(page, **facts)


@pytest.mark.parametrize("state", ["signing", "suspended"])
async def test_a_node_that_takes_part_and_does_not_lie_is_offered_no_restart(page: Page, state: str) -> None:
    await open_scripts(page, CONSOLE_ASSETS)
    assert (await refused(page, state=state))["restart"].startswith("node-2 runs and takes part")


async def test_a_node_of_the_past_changes_nothing_in_what_breaks_the_network_of_today(page: Page) -> None:
    await open_scripts(page, CONSOLE_ASSETS)
    await page.evaluate(_OPEN_FAULTS)
    node = page.get_by_label("Node", exact=True)
    await node.select_option("node-2")
    assert await page.evaluate("() => window.faults.isOfToday('node-1', 'node-2')")
    assert not await page.evaluate("() => window.faults.isOfToday('node-5')")
    said = page.get_by_role("status").filter(has_text="node-5 is not in the network now: nothing of it can be chosen.")
    await expect(said).to_be_attached()
    await page.evaluate("() => window.faults.select('node-5')")
    await expect(node).to_have_value("node-2")
    await page.evaluate("() => window.faults.selectLink('node-5', 'node-1')")
    await expect(page.get_by_role("tab", name="A node")).to_have_attribute("aria-selected", "true")
    await expect(page.locator("#link-from")).to_have_value("node-1")
    await expect(page.locator("#link-to")).to_have_value("node-2")
    await page.get_by_role("tab", name="Partition").click()
    await page.evaluate("() => window.faults.toggleGroup('node-5')")
    assert await page.evaluate("() => [...window.groups]") == [["node-1", 0], ["node-2", 0]]


@pytest.mark.parametrize(
    ("is_away", "is_hidden", "asks_at_once"),
    [(True, False, True), (True, True, False), (False, False, False)],
    ids=["away and looked at", "away and hidden", "busy"],
)
async def test_only_a_page_that_is_looked_at_asks_a_node_at_once_that_is_away_never_one_that_is_busy(
    page: Page, watch: Watch, is_away: bool, is_hidden: bool, asks_at_once: bool
) -> None:
    watch.expect("ERR_FAILED|status of 429")
    asked: list[str] = []

    async def refuse(route: Route) -> None:
        asked.append(route.request.url)
        if is_away:
            await route.abort()
        else:
            await route.fulfill(status=429, json={"code": "RATE_LIMITED", "detail": "Too many requests."})

    await open_scripts(page, EXPLORER_ASSETS)
    await page.route(f"{ORIGIN}/page/api/v1/**", refuse)
    await page.clock.install(time=0)
    await page.clock.pause_at(1_000)
    await page.evaluate(_FOLLOW)
    await page.wait_for_function("() => window.feed.retryMs > 0")
    before = len(asked)
    await page.evaluate(_HIDE, is_hidden)
    if asks_at_once:
        async with page.expect_request(f"{ORIGIN}/page/api/v1/**"):
            await page.evaluate("() => window.feed.tryNow()")
    else:
        await page.evaluate("() => window.feed.tryNow()")
        await page.wait_for_timeout(PAUSE_MS)
        assert len(asked) == before


async def test_the_nodes_clock_goes_on_in_the_page_while_the_machine_sleeps_and_is_not_set_back(page: Page) -> None:
    """One of the browser's clocks stands still then, the other goes back when somebody sets it: the larger one counts."""

    async def answer(route: Route) -> None:
        await route.fulfill(json={"now_ms": 5_000, "head": 0})

    await open_scripts(page, EXPLORER_ASSETS)
    await page.route(f"{ORIGIN}/page/api/v1/**", answer)
    passed_ms = await page.evaluate(
        """async () => {
          const { feed } = await import('./feed.js');
          let [steadyMs, wallMs] = [1_000, 9_000_000];
          performance.now = () => steadyMs;
          Date.now = () => wallMs;
          await feed.ask();
          const passed = () => feed.nodeNowMs - feed.status.now_ms;
          wallMs += 600_000;
          const asleep = passed();
          steadyMs += 700_000;
          wallMs -= 8_000_000;
          return [asleep, passed()];
        }"""
    )
    assert passed_ms == [600_000, 700_000]

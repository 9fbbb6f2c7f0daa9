"""A node that lies, and nodes that are away, as a person sees them: told by name, passed over, and back when they are."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator

import pytest
import pytest_asyncio
from playwright.async_api import Page, expect

from tests.ui.accessible import find_accessibility_faults
from tests.ui.node_in_between import Lie, NodeInBetween, change_proof, change_record, stand_before
from tests.ui.recorded_network import RecordedNetwork
from tests.ui.typed import CONTROL, at_terminal
from tests.ui.wallet_page import SETTLED_MS, go, open_page, serve_wallet, watch_first_meeting

LIES = pytest.mark.parametrize("lie", [change_proof, change_record])
BACK_MS = 90_000
"""Nodes that were killed read what they stored and find each other again, on a machine that does other things too."""


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def watched_node(recorded_network: RecordedNetwork) -> AsyncIterator[NodeInBetween]:
    """What stands between the wallets and the node that they ask first."""
    async with stand_before(recorded_network.network, recorded_network.network.names[0]) as between:
        yield between


@pytest.fixture
def liar(watched_node: NodeInBetween) -> Iterator[NodeInBetween]:
    """The node that wallets ask first, which a test lets lie: `liar.lie`. Afterwards it is honest, and did lie."""
    watched_node.lies_count = 0
    yield watched_node
    watched_node.lie = None
    assert watched_node.lies_count > 0


async def list_records(network: RecordedNetwork) -> str:
    """Type `records` at a terminal, and return what it says: one line, without colours."""

    def run() -> str:
        typed = at_terminal(network.folder, *network.wallet_arguments[1:], "records")
        typed.expect("(?i)pass[^:]*: ")
        typed.sendline(network.passphrase)
        assert typed.ended() == 0, typed.rest()
        return " ".join(CONTROL.sub("", typed.rest()).split())

    return await asyncio.to_thread(run)


@LIES
async def test_at_the_terminal_a_node_that_lies_is_named_and_another_one_asked(
    recorded_network: RecordedNetwork, liar: NodeInBetween, lie: Lie
) -> None:
    name, *others = recorded_network.network.names
    assert "does not bear out" not in await list_records(recorded_network), "it says what it should"
    liar.lie = lie
    said = await list_records(recorded_network)
    assert f"{name} gave an answer that its proof does not bear out" in said
    assert "Another node was asked." in said
    assert not [other for other in others if f"{other} gave an answer" in said]
    assert all(entry.record_id.hex() in said for entry in recorded_network.records)


@LIES
async def test_the_foot_of_the_page_names_a_node_that_lies_and_the_page_goes_on_by_another(
    recorded_network: RecordedNetwork, page: Page, liar: NodeInBetween, lie: Lie
) -> None:
    name, *others = recorded_network.network.names
    liar.lie = lie
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        told = page.locator("#footer li")
        await expect(told).to_have_count(1, timeout=SETTLED_MS)
        await expect(told).to_contain_text(f"{name} gave an answer that does not fit the ledger.")
        await expect(told).to_have_class("bad-words")
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await watch_first_meeting(page)
        await expect(page.locator(".seal")).to_have_attribute("data-seal", "good")
        for other in others:
            await expect(page.locator("#footer")).not_to_contain_text(other)


async def test_a_node_that_begins_to_lie_while_the_page_is_open_is_named_though_nothing_else_is_new(
    recorded_network: RecordedNetwork, page: Page, liar: NodeInBetween
) -> None:
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        await expect(page.locator("#footer")).to_contain_text("Checked on this computer against block")
        await expect(page.locator("#footer li")).to_have_count(0)
        liar.lie = change_proof
        name = recorded_network.network.names[0]
        await expect(page.locator("#footer li")).to_contain_text(f"{name} gave an answer", timeout=SETTLED_MS)


async def test_while_no_node_answers_what_was_read_stays_and_when_they_are_back_the_page_goes_on(
    recorded_network: RecordedNetwork, page: Page
) -> None:
    cluster, first = recorded_network.network.cluster, recorded_network.network.names[0]
    async with serve_wallet(recorded_network) as served:
        await open_page(page, served)
        count = page.locator("table.calendar .day[aria-current=date] .count")
        before = await count.inner_text()
        await asyncio.to_thread(cluster.kill, first)
        await expect(page.locator("#footer li")).to_contain_text(f"{first} does not answer.", timeout=SETTLED_MS)
        away = page.locator("#warnings", has_text="The network does not answer at this moment.")
        await expect(away).to_have_count(0)

        for name in cluster.names[1:]:
            await asyncio.to_thread(cluster.kill, name)
        await expect(away).to_be_visible(timeout=SETTLED_MS)
        await expect(count).to_have_text(before)
        assert await find_accessibility_faults(page, by_keyboard=False) == []
        await go(page, "story")
        await expect(page.locator(".story").first).to_contain_text("A robot met you and began to record")
        await expect(away).to_be_visible()
        await go(page, f"record/{recorded_network.records[0].record_id.hex()}")
        await page.get_by_role("button", name="Watch").click()
        await expect(page.locator(".screen .notice.bad")).to_be_visible(timeout=SETTLED_MS)
        await expect(page.locator("#main")).to_contain_text(recorded_network.records[0].record_id.hex())
        await page.get_by_role("button", name="Try now").click()
        await expect(away).to_be_visible()

        cluster.start_all()
        await cluster.wait_ready()
        await expect(away).to_have_count(0, timeout=BACK_MS)
        await page.locator(".screen").get_by_role("button", name="Try again").click()
        await expect(page.locator(".seal")).to_have_attribute("data-seal", "good", timeout=SETTLED_MS)
        await recorded_network.record()
        await expect(page.locator("#news")).to_contain_text("came in", timeout=BACK_MS)
        await go(page, "")
        await expect(count).not_to_have_text(before)

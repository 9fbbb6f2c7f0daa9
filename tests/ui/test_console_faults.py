"""Every fault is pressed on the console, done by the real network, shown, and ended again by a press."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from click.testing import CliRunner
from playwright.async_api import Page, Request, expect

from network.cli.main import main
from network.console.node_polling import parse_counts
from network.faults.control import FaultControl
from network.faults.plan import STEP_FIELDS
from node.config import OPERATOR_HOST, reading_headers
from tests.cluster.network_under_test import running
from tests.cluster.test_membership import until
from tests.ui.console_page import LONG_MS, choose, expect_cell, expect_done, expect_state, expect_told, open_healed
from tests.ui.console_under_test import ConsoleUnderTest
from tests.ui.watched_page import Watch

CLOCK_SLACK_MS = 10_000
"""What an answer may take on its way on a busy machine."""
IN_FLIGHT_S = 2.0
"""Between two looks at what arrives: a node that is not cut off says more than one thing in it."""
POLL_S = 0.1
PLAN = """seed = 5

[[step]]
at = "0s"
do = "skew"
node = "node-2"
offset = "+2h"

[[step]]
at = "1h"
do = "kill"
node = "node-1"
"""


async def switched(console: ConsoleUnderTest, name: str) -> dict[str, Any]:
    """What a node's own switch says is on."""
    states = await FaultControl(console.network.cluster).state()
    found = next(state.switched for state in states if state.name == name)
    assert found is not None
    return dict(found)


async def clock_off_ms(console: ConsoleUnderTest, name: str) -> int:
    """How far a node's clock is from this machine's, by the node's own words."""
    status = await console.network.status(name)
    return int(status["now_ms"]) - time.time_ns() // 1_000_000


async def arrived(console: ConsoleUnderTest, name: str, peer: str) -> int:
    """How many frames a node has had from a peer, by its own count."""
    config = console.network.cluster.config(name)
    url = f"http://{OPERATOR_HOST}:{config.operator_port}/metrics"
    async with aiohttp.ClientSession(headers=reading_headers(config)) as session, session.get(url) as response:
        counts = parse_counts(await response.text())
    return sum(frames for (sender, way, _), (frames, _) in counts.items() if (sender, way) == (peer, "received"))


async def expect_more_arrives(console: ConsoleUnderTest, name: str, peer: str) -> None:
    """Wait until a node hears of a peer."""
    before = await arrived(console, name, peer)

    async def has_more() -> bool:
        return await arrived(console, name, peer) > before

    await until_true(has_more)


async def arrived_at_last(console: ConsoleUnderTest, name: str, peer: str) -> int:
    """Wait until a node's count of a peer's frames stands still for two looks; return it."""
    seen = [await arrived(console, name, peer)]

    async def stands_still() -> bool:
        await asyncio.sleep(IN_FLIGHT_S)
        seen.append(await arrived(console, name, peer))
        return seen[-1] == seen[-2]

    await until_true(stands_still)
    return seen[-1]


async def expect_losses(console: ConsoleUnderTest, name: str) -> None:
    """Wait until a node loses a frame more on its way out."""
    before = (await switched(console, name))["frames_lost"]

    async def has_lost_more() -> bool:
        return int((await switched(console, name))["frames_lost"]) > before

    await until_true(has_lost_more)


async def until_true(is_so: Callable[[], Awaitable[bool]]) -> None:
    """Ask again and again until it is so."""
    async with asyncio.timeout(LONG_MS / 1000):
        while True:
            if await is_so():
                return
            await asyncio.sleep(POLL_S)


def newest_vote(status: dict[str, Any]) -> tuple[int, int]:
    """The newest round that a node voted in; one that has just started has voted in none."""
    voted = ((said["epoch"], said["round"]) for said in status["rounds"] if "voted" in said["messages"])
    return max(voted, default=(-1, -1))


async def expect_votes_after(console: ConsoleUnderTest, name: str, place: tuple[int, int]) -> None:
    """Wait until a node has voted in a newer round."""
    await until(console.network, name, lambda status: newest_vote(status) > place)


async def press(
    page: Page, button: str, dialog: str = "", confirm: str = "", fields: dict[str, str] | None = None
) -> None:
    """Press a button; if it asks, fill in the dialogue's fields and confirm."""
    await page.locator(".break").get_by_role("button", name=button, exact=True).click()
    if not dialog:
        return
    asked = page.get_by_role("dialog", name=dialog, exact=True)
    for label, value in (fields or {}).items():
        field = asked.get_by_label(label, exact=True)
        if await field.evaluate("field => field.localName") == "select":
            await field.select_option(value)
        else:
            await field.fill(value)
    await asked.get_by_role("button", name=confirm, exact=True).click()
    await expect(asked).to_have_count(0)


async def set_clock(page: Page, name: str, offset: str) -> None:
    await choose(page, name)
    await press(page, "Wrong clock…", f"Set the clock of {name} wrong?", "Set it", {"By how much": offset})


async def fill_disk(page: Page, name: str, disk: str) -> None:
    await choose(page, name)
    await press(page, "Fill a disk…", f"Fill a disk of {name}?", "Fill it", {"The disk under its": disk})


async def free_disk(page: Page, name: str, disk: str) -> None:
    await choose(page, name)
    await press(page, "Free a disk…", f"Free a disk of {name}", "Free it", {"The disk under its": disk})


async def let_lie(page: Page, name: str, behaviours: list[str], seed: int) -> None:
    await choose(page, name)
    await press(page, "Let it lie…")
    dialog = page.get_by_role("dialog", name=f"Let {name} lie?", exact=True)
    for behaviour in behaviours:
        await dialog.get_by_label(behaviour, exact=True).check()
    await dialog.get_by_label("Seed", exact=True).fill(str(seed))
    await dialog.get_by_role("button", name="Let it lie", exact=True).click()


async def choose_link(page: Page, source: str, target: str, *, both: bool) -> None:
    await page.get_by_role("tab", name="A link").click()
    await page.get_by_label("From", exact=True).select_option(source)
    await page.get_by_label("To", exact=True).select_option(target)
    await page.get_by_label("both directions").set_checked(both)


async def test_a_clock_that_is_set_wrong_is_off_until_it_is_set_right(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await set_clock(page, "node-4", "-2h")
    await expect_done(page, "skew node-4 by -2h")
    assert abs(await clock_off_ms(console, "node-4") + 7_200_000) < CLOCK_SLACK_MS
    await expect_cell(page, "node-4", "clock", re.compile("-(2 h 0|1 h 59) min"))
    await expect_cell(page, "node-4", "faults", "clock -2h")
    await expect_told(page, "On at node-4: clock -2h.")
    await choose(page, "node-4")
    await press(page, "Right clock")
    await expect_done(page, "skew node-4 by 0")
    assert abs(await clock_off_ms(console, "node-4")) < CLOCK_SLACK_MS
    await expect_cell(page, "node-4", "clock", "right")
    await expect_told(page, "Off at node-4: clock -2h.")


async def test_an_offset_that_is_none_is_refused_with_its_next_step_and_changes_nothing(
    console: ConsoleUnderTest, open_page: Page, watch: Watch
) -> None:
    page = open_page
    watch.expect("status of 400")
    await set_clock(page, "node-4", "soon")
    await expect(page.locator(".break .notice.bad")).to_contain_text("'soon' is no duration; write 250ms, 2s")
    await expect(page.locator(".break .notice.bad")).to_contain_text("FAULT_INVALID.")
    assert (await switched(console, "node-4"))["clock_offset_ms"] == 0


async def test_a_node_with_full_disks_signs_nothing_until_the_last_is_freed(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page, network = open_page, console.network
    await fill_disk(page, "node-3", "journal")
    await expect_done(page, "disk of node-3 under its journal: full")
    await expect_cell(page, "node-3", "disks", "journal full")
    await expect_state(page, "node-3", "fault")
    await expect_told(page, "On at node-3: journal disk full.")
    await expect_told(page, "node-3 has a fault")
    await expect(page.get_by_text("It goes on")).to_be_visible(timeout=LONG_MS)
    silent = await until(network, "node-3", lambda status: bool(status["fault"]))
    await network.wait_height("node-1", (await network.status("node-1"))["finalized_height"] + 5)
    assert newest_vote(await network.status("node-3")) == newest_vote(silent)
    await fill_disk(page, "node-3", "ledger")
    await expect_cell(page, "node-3", "disks", "journal, ledger full")
    await free_disk(page, "node-3", "journal")
    await expect_done(page, "disk of node-3 under its journal: free again")
    await expect_cell(page, "node-3", "disks", "ledger full")
    assert (await switched(console, "node-3"))["disk"] == ["ledger"]
    await free_disk(page, "node-3", "ledger")
    await expect_cell(page, "node-3", "disks", "free")
    await expect_state(page, "node-3", "signing")
    await expect_told(page, "Off at node-3: ledger disk full.")
    await expect_votes_after(console, "node-3", newest_vote(silent))


async def test_the_disk_of_the_custody_store_is_filled_alone_and_the_chain_does_not_notice(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await fill_disk(page, "node-2", "custody")
    await expect_cell(page, "node-2", "disks", "custody full")
    assert (await switched(console, "node-2"))["disk"] == ["custody"]
    await expect_votes_after(console, "node-2", newest_vote(await console.network.status("node-2")))
    await expect_state(page, "node-2", "signing")
    await choose(page, "node-2")
    await press(page, "Heal it")
    await expect_done(page, "heal node-2")
    await expect_cell(page, "node-2", "disks", "free")
    assert (await switched(console, "node-2"))["disk"] == []


async def test_a_node_that_was_let_lie_lies_until_it_is_healed(
    console: ConsoleUnderTest, open_page: Page, watch: Watch
) -> None:
    page, cluster = open_page, console.network.cluster
    watch.expect("status of 400")
    await let_lie(page, "node-4", [], 0)
    await expect(page.locator(".break .notice.bad")).to_contain_text("There is no behaviour ''")
    assert cluster.behaviour("node-4") == ""
    await let_lie(page, "node-4", ["garbage", "withhold-blocks"], 11)
    await expect_done(page, "byzantine node-4: withhold-blocks+garbage (seed 11)")
    assert cluster.behaviour("node-4") == "withhold-blocks+garbage"
    await expect_state(page, "node-4", "lying")
    await expect_cell(page, "node-4", "faults", "byzantine: withhold-blocks+garbage")
    await expect_told(page, "On at node-4: byzantine: withhold-blocks+garbage.")
    await expect_told(page, "(leader node-4) was given up by")
    lost = page.locator("table.rounds td.lost").first
    await expect(lost).to_be_visible(timeout=LONG_MS)
    lying = await until(console.network, "node-4", lambda status: bool(own_rounds(status, "node-4")))
    assert not any("proposed" in said for said in own_rounds(lying, "node-4")), "its blocks do not leave it"
    await choose(page, "node-4")
    await press(page, "Heal it")
    await expect_done(page, "heal node-4")
    assert cluster.behaviour("node-4") == ""
    await expect_state(page, "node-4", "signing")
    await expect_told(page, "Off at node-4: byzantine: withhold-blocks+garbage.")
    await until(
        console.network,
        "node-4",
        lambda status: any("proposed" in said for said in own_rounds(status, "node-4")),
    )


def own_rounds(status: dict[str, Any], name: str) -> list[dict[str, int]]:
    """What a node said in the rounds that it led."""
    return [said["messages"] for said in status["rounds"] if said["leader"] == name]


async def test_a_links_profile_delays_and_loses_both_ways_until_it_is_made_sound(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await choose_link(page, "node-1", "node-2", both=True)
    await page.get_by_label("Profile", exact=True).select_option("lossy")
    await press(page, "Spoil it")
    await expect_done(page, "link node-1 <-> node-2: 20-80 ms, 10.0% lost, 625 kB/s")
    await expect_told(page, "On at node-1: -> node-2: 20-80 ms, 10.0% lost, 625 kB/s.")
    await expect_told(page, "On at node-2: -> node-1: 20-80 ms, 10.0% lost, 625 kB/s.")
    await expect_cell(page, "node-1", "faults", "to node-2: 20-80 ms, 10.0% lost, 625 kB/s")
    await expect(page.locator(".topology .link.lossy")).to_have_count(2)
    for name, peer in (("node-1", "node-2"), ("node-2", "node-1")):
        fault = (await switched(console, name))["links"][peer]
        assert (fault["delay_ms"], fault["jitter_ms"], fault["loss"]) == (20, 60, 0.1)
        await expect_losses(console, name)
    await press(page, "Make it sound")
    await expect_done(page, "link node-1 <-> node-2: sound")
    await expect_told(page, "Off at node-1: -> node-2: 20-80 ms, 10.0% lost, 625 kB/s.")
    await expect(page.locator(".topology .link.lossy")).to_have_count(0)
    for name in ("node-1", "node-2"):
        assert (await switched(console, name))["links"] == {}


async def test_one_direction_of_a_link_is_cut_and_the_other_goes_on(
    console: ConsoleUnderTest, open_page: Page, watch: Watch
) -> None:
    page = open_page
    await choose_link(page, "node-3", "node-1", both=False)
    await page.get_by_label("cut: nothing goes through").check()
    await page.get_by_label("Share lost, 0 to 1").fill("0.5")
    watch.expect("status of 400")
    await press(page, "Spoil it")
    await expect(page.locator(".break .notice.bad")).to_contain_text("A link that is cut lets nothing through")
    await page.get_by_label("Share lost, 0 to 1").fill("")
    await press(page, "Spoil it")
    await expect_done(page, "link node-3 -> node-1: cut")
    await expect_told(page, "On at node-3: -> node-1: cut.")
    await expect_cell(page, "node-3", "faults", "to node-1: cut")
    await expect_cell(page, "node-1", "faults", "-")
    await expect(page.locator(".topology .link.cut")).to_have_count(1)
    before = await arrived_at_last(console, "node-1", "node-3")
    await expect_more_arrives(console, "node-3", "node-1")
    assert await arrived(console, "node-1", "node-3") == before
    await press(page, "Make it sound")
    await expect_done(page, "link node-3 -> node-1: sound")
    await expect(page.locator(".topology .link.cut")).to_have_count(0)
    await expect_more_arrives(console, "node-1", "node-3")


async def test_what_a_link_loses_by_a_figure_and_a_seed_ends_by_healing_either_end(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await choose_link(page, "node-2", "node-4", both=True)
    await page.get_by_label("Share lost, 0 to 1").fill("0.25")
    await page.get_by_label("Bandwidth, kB/s").fill("500")
    await page.get_by_role("tabpanel", name="A link").get_by_label("Seed").fill("9")
    await press(page, "Spoil it")
    await expect_done(page, "link node-2 <-> node-4: 25.0% lost, 500 kB/s")
    await expect_told(page, "On at node-4: -> node-2: 25.0% lost, 500 kB/s.")
    state = await switched(console, "node-4")
    assert (state["seed"], state["links"]["node-2"]["loss"]) == (9, 0.25)
    await expect_losses(console, "node-4")
    await choose(page, "node-2")
    await press(page, "Heal it")
    await expect_done(page, "heal node-2")
    await expect_told(page, "Off at node-4: -> node-2: 25.0% lost, 500 kB/s.")
    for name in ("node-2", "node-4"):
        await expect_cell(page, name, "faults", "-")
        assert (await switched(console, name))["links"] == {}


async def test_a_plan_that_is_stopped_does_no_further_step_and_what_it_switched_on_stays_on(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await page.get_by_role("tab", name="A plan").click()
    stop = page.get_by_role("button", name="Stop it", exact=True)
    await expect(stop).to_be_hidden()
    await page.get_by_label("Plan", exact=True).fill(PLAN)
    await press(page, "Carry it out", "Carry the plan out?", "Carry it out")
    await expect(page.locator("table.steps caption")).to_have_text("Seed 5, 2 steps: running", timeout=LONG_MS)
    await expect_told(page, "s: skew node-2 by +2h.")
    await stop.click()
    await expect(page.locator("table.steps caption")).to_have_text("Seed 5, 2 steps: stopped", timeout=LONG_MS)
    came = page.locator("table.steps tbody tr td:last-child")
    await expect(came.first).to_have_text("done")
    await expect(came.nth(1)).not_to_have_text("done")
    await expect_told(page, "The plan is stopped; what it switched on is still on.")
    await expect(stop).to_be_hidden()
    assert abs(await clock_off_ms(console, "node-2") - 7_200_000) < CLOCK_SLACK_MS
    assert console.network.cluster.is_running("node-1")
    await expect_cell(page, "node-2", "faults", "clock +2h")
    await press(page, "Heal everything")
    await expect_done(page, "heal everything")
    await expect_told(page, "Off at node-2: clock +2h.")
    assert abs(await clock_off_ms(console, "node-2")) < CLOCK_SLACK_MS


async def test_a_partition_ends_with_every_other_fault_by_the_button_beside_it(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page = open_page
    await fill_disk(page, "node-1", "custody")
    await page.get_by_role("tab", name="Partition").click()
    await page.get_by_role("group", name="node-4", exact=True).get_by_label("B").check()
    await press(page, "Cut it")
    await expect_done(page, "partition node-1, node-2, node-3 | node-4")
    await expect_told(page, "On at node-4: -> node-1: cut; -> node-2: cut; -> node-3: cut.")
    await expect_cell(page, "node-1", "faults", re.compile("to node-4: cut.*custody disk full"))
    before = await arrived_at_last(console, "node-4", "node-1")
    await expect_more_arrives(console, "node-2", "node-1")
    assert await arrived(console, "node-4", "node-1") == before
    await press(page, "Heal every fault")
    await expect_done(page, "heal everything")
    await expect_told(page, "Off at node-4: -> node-1: cut; -> node-2: cut; -> node-3: cut.")
    await expect_told(page, "Off at node-1: -> node-4: cut; custody disk full.")
    await expect_more_arrives(console, "node-4", "node-1")


async def test_every_fault_of_the_command_line_is_behind_a_button_that_carries_it_out(
    console: ConsoleUnderTest, open_page: Page
) -> None:
    page, cluster = open_page, console.network.cluster
    asked: list[str] = []
    page.on("request", lambda request: asked.extend(_fault_in(request)))
    await set_clock(page, "node-2", "+1m")
    await expect_done(page, "skew node-2 by +1m")
    await fill_disk(page, "node-2", "custody")
    await expect_done(page, "disk of node-2 under its custody: full")
    await press(page, "Pause")
    await expect_done(page, "pause node-2")
    assert cluster.is_paused("node-2")
    await press(page, "Resume")
    await expect_done(page, "resume node-2")
    assert not cluster.is_paused("node-2")
    await let_lie(page, "node-2", ["withhold-votes"], 1)
    await expect_done(page, "byzantine node-2: withhold-votes (seed 1)")
    await choose_link(page, "node-1", "node-4", both=True)
    await page.get_by_label("Delay, ms").fill("5")
    await press(page, "Spoil it")
    await expect_done(page, "link node-1 <-> node-4: 5 ms")
    await page.get_by_role("tab", name="Partition").click()
    await page.get_by_role("group", name="node-1", exact=True).get_by_label("C").check()
    await press(page, "Cut it")
    await expect_done(page, "partition node-2, node-3, node-4 | node-1")
    assert len([state for state in await FaultControl(cluster).state() if state.describe()]) == 4
    await press(page, "Heal everything")
    await expect_done(page, "heal everything")
    assert [state.describe() for state in await FaultControl(cluster).state()] == [[], [], [], []]
    await choose(page, "node-3")
    await press(page, "Kill", "Kill node-3?", "Kill it")
    await expect_done(page, "kill node-3")
    await expect_state(page, "node-3", "stopped")  # an earlier test may have told of a kill, too
    assert not cluster.is_running("node-3")
    await press(page, "Restart")
    await expect_done(page, "restart node-3")
    assert cluster.is_running("node-3")
    assert set(asked) == set(STEP_FIELDS)


def _fault_in(request: Request) -> list[str]:
    """Return the kind of fault that a page's request asks for."""
    return [request.post_data_json["do"]] if request.url.endswith("/api/faults") else []


@pytest.mark.timeout(200)
async def test_a_liar_who_contradicts_itself_is_seen_suspended_and_stays_so_when_it_is_healed(
    page: Page, tmp_path: Path
) -> None:
    """On a network of its own: a suspension is no fault, and no healing ends it."""
    async with running(ConsoleUnderTest(tmp_path)) as console:
        await open_healed(console, page)
        await let_lie(page, "node-4", ["equivocate"], 7)
        await expect_told(page, "On at node-4: byzantine: equivocate.")
        await expect(page.get_by_text("A node lies")).to_be_visible()
        await expect_told(page, "node-4 is suspended since height")
        await expect_told(page, "node-4 contradicted itself, say ")
        await expect_state(page, "node-4", "suspended")
        said = (
            await asyncio.to_thread(CliRunner().invoke, main, ["status", "--dir", str(console.network.folder)])
        ).output
        assert re.search(r"node-4 \W+suspended", said)
        assert "node-4 was told to lie (equivocate)." in said
        assert "Broken on purpose: node-4." in said
        assert (said.count("blockrobot fault heal"), "fault restart" in said) == (1, False)
        assert re.search(r"node-1.* say that\s+node-4\s+contradicted\s+itself", said)
        assert await page.get_by_text("All is well").count() == 0
        status = await console.network.status("node-1")
        told = await until(console.network, "node-4", lambda status: status["suspended_height"] is not None)
        assert 0 < told["suspended_height"] <= status["finalized_height"]
        await press(page, "Heal it")
        await expect_told(page, "Off at node-4: byzantine: equivocate.")
        await expect_cell(page, "node-4", "faults", "-")
        await expect_state(page, "node-4", "suspended")
        await expect(page.get_by_text("A node is suspended")).to_be_visible()
        await page.goto("about:blank")
        where = ["--dir", str(console.network.folder)]
        for typed in (["byzantine", "node-3", "garbage"], ["heal"]):
            blockrobot = [sys.executable, "-m", "network.cli.main", "fault", *typed, *where]
            said = await asyncio.to_thread(subprocess.check_output, blockrobot, text=True)
        assert "Restarted, for only so does a liar become honest: node-3." in said
